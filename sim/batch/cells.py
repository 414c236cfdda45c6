"""One trial of the sweep: robots caught in a skill change to another one, in one mode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from downbeat.control.modes import Mode
from downbeat.control.phase import TICK_S
from downbeat.control.slots import enters_at_zero, entry_slots
from downbeat.policies.manifest import SkillManifest
from downbeat.sim.batch.engine import Engine, join_starts
from downbeat.sim.batch.outcome import Outcome
from downbeat.sim.batch.perturb import Draws
from downbeat.sim.batch.script import Script, Switch, rate_for, script_of
from downbeat.sim.batch.states import LEAD_TICKS, Visits

F64 = NDArray[np.float64]
Ids = NDArray[np.int64]

HORIZON_S = 5.0
SETTLE_S = 2.0
"""After the onset: how long robots are watched, and from when on only those that still wobble."""


@dataclass(frozen=True)
class Change:
    """N changes of skill, one per robot.

    Attributes:
        robots: (N,) rows of the visits and the draws.
        exit_slot: (N,).
        entry_slot: (N,).
        entry_s: (N,) phase of the incoming skill at the onset [s].
    """

    robots: Ids
    exit_slot: Ids
    entry_slot: Ids
    entry_s: F64


def entry_phases(target: SkillManifest, slot: Ids, rng: np.random.Generator) -> F64:
    """Return phases of the onset in the entry slots: half on the beat, half anywhere [s]."""
    slots = entry_slots(target)
    anywhere = rng.uniform(-0.5, 0.5, len(slot)) * slots.width_s
    off = np.where(rng.uniform(size=len(slot)) < 0.5, 0.0, anywhere)
    return slot * slots.width_s + off


def change_script(
    source: SkillManifest,
    target: SkillManifest,
    mode: Mode,
    exit_s: F64,
    exit_rate: F64,
    entry_s: F64,
    entry_rate: F64,
    horizon_s: float = HORIZON_S,
) -> Script:
    """Return the script of a change whose onset is at tick `LEAD_TICKS`.

    Args:
        source: What is left.
        target: What is entered.
        mode: How.
        exit_s: (N,) phase of the source at the onset [s].
        exit_rate: (N,).
        entry_s: (N,) phase of the target at the onset [s]; footwork begins at 0.
        entry_rate: (N,).
        horizon_s: Watched after the onset [s].
    """
    half = mode.blend_ticks // 2
    hold = enters_at_zero(target)
    entry = np.zeros_like(entry_s) if hold else entry_s - half * TICK_S * entry_rate
    switch = Switch(
        target, LEAD_TICKS - half, mode.blend_ticks, mode.style, entry, entry_rate, hold
    )
    ticks = LEAD_TICKS + round(horizon_s / TICK_S)
    return script_of(source, exit_s - LEAD_TICKS * TICK_S * exit_rate, exit_rate, (switch,), ticks)


def simulate(
    engine: Engine,
    visits: Visits,
    target: SkillManifest,
    source: SkillManifest,
    mode: Mode,
    change: Change,
    draws: Draws,
    seed: tuple[int, ...],
    horizon_s: float = HORIZON_S,
) -> Outcome:
    """Simulate changes; every robot must be valid in its slot."""
    parts = [visits.starts[s].take([r]) for r, s in zip(change.robots, change.exit_slot)]
    robots = draws.take(change.robots)
    script = change_script(
        source,
        target,
        mode,
        visits.phase_s[change.exit_slot, change.robots],
        visits.rate[change.robots],
        change.entry_s,
        rate_for(target, robots.tempo_bpm[:, 1]),
        horizon_s,
    )
    settle = LEAD_TICKS + round(SETTLE_S / TICK_S)
    return engine.run(join_starts(parts), script, robots, seed, settle_tick=settle)
