"""Sweep units on a Ray cluster: nodes simulate, the driver keeps the rows.

A node needs nothing of the driver's disk: it is told the rows that are known and sends back every
pair as it is done. Rows are addressed by everything they depend on, so a node with another version
of a skill or of the robot is noticed before it simulates anything.
"""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from downbeat.sim.batch.pair import Rows
from downbeat.sim.batch.perturb import load_profile
from downbeat.sim.batch.store import Store
from downbeat.sim.batch.sweep import SweepConfig, Unit, Worker, sweep_skills
from downbeat.sim.errors import SimError

Known = Mapping[str, tuple[str, Rows]]
"""Target -> name of the pair's file, and its rows so far."""
Spread = Callable[[SweepConfig, Sequence[Unit]], Iterator[tuple[Unit, int]]]


def pairs_on_node(config: SweepConfig, unit: Unit, known: Known) -> Iterator[tuple[str, Rows, int]]:
    """Work through a unit on a node; yield target, all rows of the pair, rollouts of this run.

    Raises:
        SimError: This node has another version of a skill, of the robot or of the profile.
    """
    worker = _node_worker(config)
    source, targets = unit
    for target in targets:
        a, b = worker.skills[source], worker.skills[target]
        name, rows = known[target]
        here = worker.store.path(a, b)
        if here.name != name:
            raise SimError(
                f"Node {os.uname().nodename} would keep '{source}' to '{target}' as {here.name}, "
                f"the driver as {name}: their skills, robot or profile differ; install the same "
                "version of downbeat on every node."
            )
        here.unlink(missing_ok=True)
        if len(rows):
            worker.store.save(a, b, rows)
        count = worker.run_pair(source, target)
        yield target, worker.store.load(a, b), count


@lru_cache(maxsize=1)
def _node_worker(config: SweepConfig) -> Worker:
    folder = Path(tempfile.mkdtemp(prefix="downbeat-sweep-"))
    atexit.register(shutil.rmtree, folder, True)
    return Worker(replace(config, out=folder))


def spread_ray(address: str = "") -> Spread:
    """Return what spreads units over a cluster; see `sweep.run_sweep`.

    Args:
        address: Of a running cluster, as Ray writes it; empty: one on this machine, with
            `workers` processes, that ends with the sweep.

    Raises:
        SimError: Ray is not installed.
    """
    if find_spec("ray") is None:
        raise SimError("--ray needs ray; install it with pip install 'downbeat[sweep]'.")

    def spread(config: SweepConfig, units: Sequence[Unit]) -> Iterator[tuple[Unit, int]]:
        ray = _open(address, config.workers)
        try:
            yield from _spread(ray, config, units)
        finally:
            ray.shutdown()

    return spread


def _open(address: str, workers: int) -> Any:
    # Ray reads this once, before it starts: a sweep tells nobody that it runs.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    import ray

    here = {} if address else {"num_cpus": max(workers, 1), "include_dashboard": False}
    try:
        ray.init(address or "local", log_to_driver=False, logging_level="error", **here)
    except (ConnectionError, ValueError, RuntimeError, OSError) as error:
        raise SimError(
            f"The Ray cluster '{address or 'local'}' cannot be reached: {error}; start the sweep "
            "on a machine of the cluster and give the HOST:PORT that `ray start --head` printed."
        ) from error
    return ray


def _spread(ray: Any, config: SweepConfig, units: Sequence[Unit]) -> Iterator[tuple[Unit, int]]:
    """Hand all units out; keep every pair as it comes; yield units as they end."""
    skills = sweep_skills(config)
    store = Store(config.out, load_profile(config.profile), config.seed)
    # Nodes keep one worker for all their units: only what its rows depend on goes along.
    away = replace(config, out=Path(), skills=(), shard=(0, 1), workers=1)
    remote = ray.remote(num_returns="streaming", max_retries=3)(pairs_on_node)
    under_way: dict[Any, list[Any]] = {}
    for unit in units:
        known = {
            target: (
                store.path(skills[unit[0]], skills[target]).name,
                store.load(skills[unit[0]], skills[target]),
            )
            for target in unit[1]
        }
        under_way[remote.remote(away, unit, known)] = [unit, 0]
    while under_way:
        (stream,), _ = ray.wait(list(under_way), num_returns=1, fetch_local=False)
        unit, _ = under_way[stream]
        try:
            target, rows, count = ray.get(next(stream))
        except StopIteration:
            yield tuple(under_way.pop(stream))  # type: ignore[misc]
        except ray.exceptions.RayError as error:
            raise _as_sim_error(error) from error
        else:
            store.save(skills[unit[0]], skills[target], rows)
            under_way[stream][1] += count


def _as_sim_error(error: Any) -> SimError:
    cause = getattr(error, "cause", None)
    if isinstance(cause, SimError):
        return cause
    return SimError(
        f"The cluster gave up: {str(error).strip().splitlines()[-1]}; what was done is kept, the "
        "same command goes on from there."
    )
