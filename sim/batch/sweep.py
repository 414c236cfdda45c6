"""The sweep: every ordered pair of skills is screened and proven, in processes, resumable."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from functools import lru_cache
from hashlib import blake2b
from multiprocessing import get_context, parent_process
from pathlib import Path

import numpy as np

from downbeat.control.modes import modes_between
from downbeat.control.slots import PARTS_PER_BEAT, entry_slots, exit_slots
from downbeat.policies.manifest import SkillManifest, load_skills
from downbeat.runtime import realtime
from downbeat.sim.batch.cells import Change, entry_phases, simulate
from downbeat.sim.batch.engine import Engine, EngineName, open_engine
from downbeat.sim.batch.native import NativeEngine
from downbeat.sim.batch.outcome import Outcome
from downbeat.sim.batch.pair import ROW, Depth, Pair, Rows, Task
from downbeat.sim.batch.perturb import BLOCK, draw_block, load_profile
from downbeat.sim.batch.states import Visits, visit
from downbeat.sim.batch.store import Store
from downbeat.sim.errors import SimError

TARGETS_PER_UNIT = 11
"""Pairs that one process works through before the next unit: they share the source's states."""


@dataclass(frozen=True)
class SweepConfig:
    """What a sweep depends on.

    Attributes:
        out: Folder of the rows.
        skills: Names; empty: all.
        imported: Folder of imported skills; None: only the bundled ones.
        profile: Name or path of the perturbations.
        seed: Of everything.
        depth: How far to go.
        shard: (i, n): this is part i of n; (0, 1): everything.
        workers: Processes.
        engine: What simulates the changes.
    """

    out: Path
    skills: tuple[str, ...] = ()
    imported: Path | None = None
    profile: str = "stage"
    seed: int = 0
    depth: Depth = Depth()
    shard: tuple[int, int] = (0, 1)
    workers: int = 1
    engine: EngineName = "native"


def sweep_skills(config: SweepConfig) -> dict[str, SkillManifest]:
    """Return the skills of a sweep.

    Raises:
        SimError: A name is unknown.
    """
    known = dict(load_skills())
    if config.imported is not None:
        known.update(load_skills(config.imported))
    unknown = [name for name in config.skills if name not in known]
    if unknown:
        raise SimError(
            f"Skill '{unknown[0]}' is unknown; skills are {', '.join(sorted(known))} (sweep)."
        )
    names = config.skills or tuple(sorted(known))
    return {name: known[name] for name in names}


def pairs_of(skills: Mapping[str, SkillManifest], shard: tuple[int, int]) -> list[tuple[str, str]]:
    """Return the ordered pairs of a shard; which shard a pair is in depends on its names only."""
    index, count = shard
    return [
        (a, b) for a in skills for b in skills if a != b and _number(f"{a}--{b}") % count == index
    ]


def _number(text: str) -> int:
    return int.from_bytes(blake2b(text.encode(), digest_size=8).digest(), "big")


Unit = tuple[str, tuple[str, ...]]


def units_of(pairs: Sequence[tuple[str, str]]) -> list[Unit]:
    """Return the pairs in units of one source and a few targets."""
    units: list[Unit] = []
    for source in dict.fromkeys(a for a, _ in pairs):
        targets = [b for a, b in pairs if a == source]
        for first in range(0, len(targets), TARGETS_PER_UNIT):
            units.append((source, tuple(targets[first : first + TARGETS_PER_UNIT])))
    return units


class Worker:
    """One process of a sweep."""

    def __init__(self, config: SweepConfig, threads: int = 1) -> None:
        known = dict(load_skills())
        if config.imported is not None:
            known.update(load_skills(config.imported))
        self.skills = known
        self.config = config
        self.profile = load_profile(config.profile)
        self.store = Store(config.out, self.profile, config.seed)
        self.engine = NativeEngine(known, threads)
        self.judge = open_judge(config.engine, self.engine)
        self._visits = lru_cache(maxsize=64)(self._visit)

    def _visit(self, source: str, block: int) -> Visits:
        draws = draw_block(self.profile, self.config.seed, block)
        seed = (self.config.seed, block, _number(source) % 2**32)
        return visit(self.engine, self.skills[source], draws, seed)

    def run_pair(self, source: str, target: str) -> int:
        """Take a pair as far as the depth asks; return how many rollouts that took."""
        a, b = self.skills[source], self.skills[target]
        pair = self.open_pair(a, b)
        done = 0
        while (task := pair.next_task(self.config.depth)) is not None:
            rows = self.run_task(a, b, pair, task)
            pair.add(rows)
            self.store.save(a, b, pair.all_rows())
            done += len(rows)
        return done

    def open_pair(self, a: SkillManifest, b: SkillManifest) -> Pair:
        """Return what is known about a pair."""
        parts = PARTS_PER_BEAT if a.kind == "stepping" else 1
        hints = self.store.hints().get(a.name)
        pair = Pair(modes_between(a, b), exit_slots(a).count, entry_slots(b).count, parts, hints)
        rows = self.store.load(a, b)
        if len(rows):
            pair.add(rows)
        return pair

    def run_task(self, a: SkillManifest, b: SkillManifest, pair: Pair, task: Task) -> Rows:
        """Simulate one block."""
        seed = (self.config.seed, task.block, _number(f"{a.name}--{b.name}") % 2**32, task.mode)
        rng = np.random.default_rng([*seed, 0x7A5C])
        visits = self._visits(a.name, task.block)
        exits = _spread(task.exits, rng)
        entries = _spread(task.entries, rng)
        robots = np.flatnonzero(visits.valid[exits, np.arange(BLOCK)])[: self.config.depth.robots]
        exits, entries = exits[robots], entries[robots]
        change = Change(robots, exits, entries, entry_phases(b, entries, rng))
        draws = draw_block(self.profile, self.config.seed, task.block)
        mode = pair.modes[task.mode]
        outcome = simulate(self.judge, visits, b, a, mode, change, draws, seed)
        return _rows(task, change, outcome)


def open_judge(name: EngineName, native: NativeEngine) -> Engine:
    """Return the engine that simulates the changes; the native one catches the robots before."""
    return native if name == "native" else open_engine(name, native.manifests, native.threads)


def _spread(slots: Sequence[int], rng: np.random.Generator) -> np.ndarray:
    """Return a slot for each robot of a block: all equally often, in random order."""
    repeats = -(-BLOCK // len(slots))
    order = np.concatenate([rng.permutation(slots) for _ in range(repeats)])
    return rng.permutation(order[:BLOCK]).astype(np.int64)


def _rows(task: Task, change: Change, outcome: Outcome) -> Rows:
    rows = np.zeros(outcome.count, ROW)
    rows["mode"], rows["stage"], rows["block"] = task.mode, task.stage, task.block
    rows["robot"] = change.robots
    rows["exit_slot"], rows["entry_slot"] = change.exit_slot, change.entry_slot
    rows["fell"], rows["fell_tick"] = outcome.fell, outcome.fell_tick
    for name in ("max_tilt", "max_torque_ratio", "min_margin", "end_error"):
        rows[name] = np.clip(getattr(outcome, name), -60_000.0, 60_000.0)
    return rows


@dataclass(frozen=True)
class Progress:
    """How far a sweep is.

    Attributes:
        pairs_done: Of `pairs`.
        pairs: In all.
        rollouts: Simulated in this run.
        seconds: Since it began.
    """

    pairs_done: int
    pairs: int
    rollouts: int
    seconds: float

    @property
    def left_s(self) -> float:
        """Estimated time left [s]."""
        if not self.pairs_done:
            return float("nan")
        return self.seconds / self.pairs_done * (self.pairs - self.pairs_done)


def run_unit(config: SweepConfig, unit: Unit) -> tuple[Unit, int]:
    """Work through a unit in this process; return it and its rollouts."""
    worker = _worker(config)
    source, targets = unit
    return unit, sum(worker.run_pair(source, target) for target in targets)


@lru_cache(maxsize=1)
def _worker(config: SweepConfig) -> Worker:
    return Worker(config)


def run_sweep(
    config: SweepConfig,
    say: Callable[[Progress], None] = lambda _: None,
    spread: Callable[[SweepConfig, Sequence[Unit]], Iterator[tuple[Unit, int]]] | None = None,
) -> Progress:
    """Run a sweep, or what is left of it.

    Args:
        config: What to do.
        say: Told after every unit.
        spread: Runs units elsewhere (a cluster) and yields them as they finish.

    Raises:
        SimError: A skill or a profile is unknown.
    """
    skills = sweep_skills(config)
    load_profile(config.profile)
    pairs = pairs_of(skills, config.shard)
    units = units_of(pairs)
    began, done, rollouts = time.monotonic(), 0, 0
    progress = Progress(0, len(pairs), 0, 0.0)
    for unit, count in (spread or spread_processes)(replace(config), units):
        done += len(unit[1])
        rollouts += count
        progress = Progress(done, len(pairs), rollouts, time.monotonic() - began)
        say(progress)
    return progress


def die_with_parent() -> None:
    """Have the kernel end this child with its parent: a killed sweep leaves nothing behind."""
    parent = parent_process()
    if parent is not None and parent.pid is not None:
        realtime.die_with_parent(parent.pid, signal.SIGKILL)


def refine_sweep(
    config: SweepConfig,
    say: Callable[[Progress], None] = lambda _: None,
    spread: Callable[[SweepConfig, Sequence[Unit]], Iterator[tuple[Unit, int]]] | None = None,
) -> Progress:
    """Try the pairs that were not proven once more, in the slots that proved good for others.

    Needs the rows of all pairs: after the shards of a sweep were put together.
    """
    skills = sweep_skills(config)
    store = Store(config.out, load_profile(config.profile), config.seed)
    if not store.hints():
        store.save_hints({n: good_exits(store, m, skills) for n, m in skills.items()})
    return run_sweep(config, say, spread)


GOOD_SHARE = 0.2
"""A slot is good when less than this times the target falls there, all targets together."""


def good_exits(
    store: Store, source: SkillManifest, skills: Mapping[str, SkillManifest]
) -> tuple[int, ...]:
    """Return the exit slots of a skill at which next to nobody falls, wherever it leads."""
    parts = [store.load(source, target) for target in skills.values() if target.name != source.name]
    rows = np.concatenate(parts) if parts else np.zeros(0, ROW)
    slots = exit_slots(source).count
    count = np.bincount(rows["exit_slot"], minlength=slots)
    fallen = np.bincount(rows["exit_slot"][rows["fell"]], minlength=slots)
    good = fallen <= GOOD_SHARE * Depth().target * count
    return tuple(int(slot) for slot in np.flatnonzero(good))


def spread_processes(config: SweepConfig, units: Sequence[Unit]) -> Iterator[tuple[Unit, int]]:
    """Run units in processes of this machine."""
    if config.workers <= 1:
        for unit in units:
            yield run_unit(config, unit)
        return
    context = get_context("spawn")
    with ProcessPoolExecutor(config.workers, context, initializer=die_with_parent) as pool:
        futures = [pool.submit(run_unit, config, unit) for unit in units]
        try:
            for future in as_completed(futures):
                yield future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
