"""`downbeat bench batch`: physics steps per second of the closed loop, policies included."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import batch as mujoco_batch

from downbeat.policies.manifest import load_skills
from downbeat.sim.batch.engine import SUBSTEPS, Engine, Start, batch_model, open_engine
from downbeat.sim.batch.perturb import BLOCK, Draws, draw_block, join_draws, load_profile
from downbeat.sim.batch.script import Script, Switch, rate_for, script_of
from downbeat.sim.batch.states import standing_start

SEED = 99
TICKS = 50
NATIVE_BATCH = 256
CPU_BATCHES = (16, 64)
GPU_BATCHES = (256, 1024, 4096, 16384)
PAIR = ("kpop", "disco")


@dataclass(frozen=True)
class Throughput:
    """One engine at one batch size.

    Attributes:
        engine: Name and what it runs on.
        batch: Rollouts at once.
        steps_per_s: Physics steps of 5 ms per second, the whole loop.
        not_physics: Share of the loop that is observations, policies and measures; NaN: unknown.
        compile_s: Before the first result [s].
        memory_mib: Peak on the device; NaN: unknown.
    """

    engine: str
    batch: int
    steps_per_s: float
    not_physics: float
    compile_s: float
    memory_mib: float

    def line(self) -> str:
        """Return a row for people."""
        rest = "-" if np.isnan(self.not_physics) else f"{self.not_physics:.0%}"
        memory = "-" if np.isnan(self.memory_mib) else f"{self.memory_mib:.0f}"
        return (
            f"{self.engine:28s} {self.batch:7d} {self.steps_per_s:12,.0f} {rest:>12s} "
            f"{self.compile_s:10.1f} {memory:>9s}"
        )


HEADER = (
    f"{'engine':28s} {'batch':>7s} {'steps/s':>12s} {'not physics':>12s} {'compile s':>10s} "
    f"{'MiB':>9s}"
)


def loop_of(batch: int) -> tuple[Start, Script, Draws]:
    """Return a change of skill for a batch of robots; nobody falls in it."""
    skills = load_skills()
    blocks = [draw_block(load_profile(), SEED, k) for k in range(-(-batch // BLOCK))]
    draws = join_draws(blocks).take(np.arange(batch))
    a, b = (skills[name] for name in PAIR)
    stand = skills["stand"]
    rate = rate_for(b, draws.tempo_bpm[:, 1])
    switches = (
        Switch(a, 2, 15, "full", np.zeros(1), np.ones(1)),
        Switch(b, 20, 15, "full", np.zeros(1), rate),
    )
    script = script_of(stand, np.zeros(1), np.ones(1), switches, TICKS)
    return standing_start(batch), script, draws


def bare_steps_per_s(batch: int, threads: int) -> float:
    """Return the physics alone: standing robots of the same batch."""
    robots = mujoco_batch.Batch(batch_model(), batch, nthread=threads)
    start = standing_start(batch)
    robots.reset(stage=mujoco.mjtStage.mjSTAGE_NONE)
    robots.bind("qpos")[:], robots.bind("ctrl")[:] = start.qpos, start.target
    began = time.perf_counter()
    for _ in range(TICKS):
        robots.step(nstep=SUBSTEPS)
    return batch * TICKS * SUBSTEPS / (time.perf_counter() - began)


def measure(engine: Engine, batch: int, repeats: int = 3) -> tuple[float, float]:
    """Return steps per second (best of the repeats) and the time to the first result [s]."""
    start, script, draws = loop_of(batch)
    began = time.perf_counter()
    engine.run(start, script, draws, (SEED,))
    first_s = time.perf_counter() - began
    best_s = float("inf")
    for _ in range(repeats):
        began = time.perf_counter()
        engine.run(start, script, draws, (SEED,))
        best_s = min(best_s, time.perf_counter() - began)
    return batch * TICKS * SUBSTEPS / best_s, max(first_s - best_s, 0.0)


def measure_all(batches: tuple[int, ...] = ()) -> Iterator[Throughput]:
    """Yield what this machine does: native threads, MJX on what JAX finds."""
    skills = load_skills()
    for threads in sorted({1, min(2, len(os.sched_getaffinity(0)))}):
        steps, wait_s = measure(open_engine("native", skills, threads), NATIVE_BATCH)
        bare = bare_steps_per_s(NATIVE_BATCH, threads)
        rest = max(1.0 - steps / bare, 0.0)
        name = f"native, {threads} thread{'s' if threads > 1 else ''}"
        yield Throughput(name, NATIVE_BATCH, steps, rest, wait_s, float("nan"))
    try:
        import jax

        from downbeat.sim.batch.mjx import device_memory_mib
    except ImportError:
        return
    device = jax.devices()[0]
    sizes = batches or (GPU_BATCHES if device.platform == "gpu" else CPU_BATCHES)
    engine = open_engine("mjx", skills)
    for batch in sizes:
        steps, wait_s = measure(engine, batch, 1 if device.platform == "cpu" else 3)
        memory = device_memory_mib()
        yield Throughput(
            f"mjx, {device.device_kind}",
            batch,
            steps,
            float("nan"),
            wait_s,
            float("nan") if memory is None else memory,
        )


def machine() -> str:
    """Return what this was measured on."""
    cores = len(os.sched_getaffinity(0))
    return f"{platform.machine()}, {cores} cores, Python {platform.python_version()}"
