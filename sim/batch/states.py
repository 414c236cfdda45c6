"""Where robots are when a skill is left: the states that transitions are simulated from.

A block of robots plays a skill once; each is caught shortly before every exit slot. A transition
then starts from where this robot, with its mass, gains, delay and noise, really was.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from downbeat.catalog.robot import load_g1
from downbeat.control.phase import TICK_S
from downbeat.control.slots import Slots, enters_at_zero, exit_slots
from downbeat.policies.manifest import SkillManifest
from downbeat.sim.batch.engine import Engine, Start, batch_model, join_starts
from downbeat.sim.batch.perturb import Draws
from downbeat.sim.batch.script import Switch, rate_for, script_of
from downbeat.sim.gantry import settle

F64 = NDArray[np.float64]

LEAD_TICKS = 15
"""Robots are caught this long before the onset: half of the longest blend."""
STAND_TICKS = 30
IN_TICKS = 30
WARM_UP_TICKS = 75
"""Played before the first catch: what the change into the skill shook up has calmed down."""
MARCH = (0.0, 0.0, 0.0)


@dataclass
class Visits:
    """Robots caught in a skill.

    Attributes:
        skill: Name.
        slots: Exit slots of the skill.
        phase_s: (slots, N) skill time of the onset that the catch looks ahead to [s].
        rate: (N,) skill seconds per second.
        valid: (slots, N) whether the robot stood.
        starts: Per slot, all N rows; rows that are not valid hold another robot.
    """

    skill: str
    slots: Slots
    phase_s: F64
    rate: F64
    valid: NDArray[np.bool_]
    starts: list[Start] = field(default_factory=list)


@cache
def standing_qpos() -> F64:
    """Return the robot on its feet in the default pose, (36,)."""
    model = batch_model()
    data = mujoco.MjData(model)
    settle(model, data, load_g1().default_joint_pos)
    return np.array(data.qpos)


def standing_start(count: int) -> Start:
    """Return robots at rest in the default pose."""
    qpos = standing_qpos()
    return Start(
        np.tile(qpos, (count, 1)),
        np.zeros((count, 35)),
        np.zeros((count, 35)),
        np.tile(qpos[7:], (count, 1)).astype(np.float32),
    )


def onset_phases(slots: Slots, rng: np.random.Generator, count: int) -> F64:
    """Return the phases (slots, N) at which each robot leaves [s].

    Exact slots get the 10 ms that a tick rounds; of the others half are met in the middle, as
    announced changes do, half anywhere, as surprises do.
    """
    middle = np.arange(slots.count)[:, None] * slots.width_s + np.zeros(count)
    if slots.is_exact:
        return middle + rng.uniform(-0.01, 0.01, middle.shape)
    anywhere = rng.uniform(-0.5, 0.5, middle.shape) * max(slots.width_s, TICK_S)
    return middle + np.where(rng.uniform(size=count) < 0.5, 0.0, anywhere)


def visit(engine: Engine, skill: SkillManifest, draws: Draws, seed: tuple[int, ...]) -> Visits:
    """Let every robot play a skill and catch it before each exit slot."""
    slots, count = exit_slots(skill), draws.count
    rng = np.random.default_rng([*seed, 0x7157])
    rate = rate_for(skill, draws.tempo_bpm[:, 0])
    stand = engine.manifests["stand"]
    phase = onset_phases(slots, rng, count)
    if skill.name == "stand":
        warm = STAND_TICKS + WARM_UP_TICKS
        script = script_of(stand, np.zeros(1), np.ones(1), (), warm + LEAD_TICKS)
        ticks = np.full((1, count), warm - LEAD_TICKS)
    else:
        is_zero = enters_at_zero(skill)
        blend = 15 if is_zero or skill.policy is not None else IN_TICKS
        first = STAND_TICKS + (blend // 2 if is_zero else 0)
        # The first time after the warm-up at which each slot is LEAD_TICKS ahead.
        lead_s = LEAD_TICKS * TICK_S * rate
        ahead = phase - lead_s
        earliest = WARM_UP_TICKS * TICK_S * rate
        if skill.loop:
            ahead = earliest + np.mod(ahead - earliest, skill.duration_s)
        ticks = first + np.round(ahead / (rate * TICK_S)).astype(np.int64)
        phase = (ticks - first + LEAD_TICKS) * TICK_S * rate
        entry = Switch(skill, STAND_TICKS, blend, "full", np.zeros(1), rate, hold=is_zero)
        script = script_of(stand, np.zeros(1), np.ones(1), (entry,), int(ticks.max()) + 1)
    visits = Visits(skill.name, slots, phase, rate, np.zeros((slots.count, count), bool))
    caught: list[list[tuple[NDArray[np.int64], Start]]] = [[] for _ in range(slots.count)]
    due = {int(tick) for tick in np.unique(ticks)}

    def watch(tick: int, ids: NDArray[np.int64], here: object) -> None:
        if tick not in due:
            return
        now: Start = here()  # type: ignore[operator]
        for slot in range(slots.count):
            rows = np.flatnonzero(ticks[slot, ids] == tick)
            if len(rows):
                caught[slot].append((ids[rows], now.take(rows)))

    run_seed = (*seed, 0x1EAD)
    engine.run(standing_start(count), script, draws, run_seed, watch, int(ticks.max()) + 1)
    for slot, parts in enumerate(caught):
        visits.starts.append(_rows(parts, count, visits.valid[slot], skill))
    return visits


def _rows(
    parts: list[tuple[NDArray[np.int64], Start]],
    count: int,
    valid: NDArray[np.bool_],
    skill: SkillManifest,
) -> Start:
    """Return the caught robots in their rows; marks them in `valid`."""
    if not parts:
        return standing_start(count)
    joined = join_starts([start for _, start in parts])
    ids = np.concatenate([rows for rows, _ in parts])
    valid[ids] = True
    source = np.zeros(count, np.int64)
    source[ids] = np.arange(len(ids))
    start = joined.take(source)
    keep = {skill.name}
    start.memories = {n: m for n, m in start.memories.items() if n in keep}
    start.steering = {n: m for n, m in start.steering.items() if n in keep}
    return start
