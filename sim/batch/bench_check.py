"""`downbeat bench check`: what an online check costs, beside the bare physics of the same steps."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from mujoco import batch as mujoco_batch

from downbeat.control.atlas import BUNDLED_ATLAS, Atlas, Cell
from downbeat.control.core import ControlCore, CoreConfig
from downbeat.control.modes import modes_between
from downbeat.control.policy import SkillLibrary
from downbeat.control.prover import ProofConfig
from downbeat.control.slots import entry_slots, exit_slots
from downbeat.lcm_types import transition_query_t, transition_verdict_t
from downbeat.policies.manifest import load_skills
from downbeat.runtime.bus import MemqHub
from downbeat.runtime.clock import SIM_EPOCH_UTIME, SimClock
from downbeat.sim.batch.engine import SUBSTEPS, batch_model
from downbeat.sim.checker import Checker, CheckerNode
from downbeat.sim.motion_trials import MotionTrial, play

ROLLOUTS = 32
HORIZON_S = 2.0
REPEATS = 16
TURNS = 4
PAIR = ("kpop", "disco")


@dataclass(frozen=True)
class CheckBench:
    """What was measured.

    Attributes:
        rollouts: Per check.
        ticks: Per rollout.
        check_ms: (repeats,) of a check.
        stepping_ms: (repeats,) of the same physics steps without policies, alternating with it.
        late_ms: (repeats,) after the deadline that a hurried check answered; negative: before.
        hurried_rollouts: (repeats,) that were done by then.
    """

    rollouts: int
    ticks: int
    check_ms: list[float]
    stepping_ms: list[float]
    late_ms: list[float]
    hurried_rollouts: list[int]

    @property
    def ratio(self) -> float:
        """Median check over median bare stepping."""
        return float(np.median(self.check_ms) / np.median(self.stepping_ms))

    def lines(self) -> list[str]:
        """Return the table for people."""

        def row(name: str, values: list[float]) -> str:
            low, mid, high = min(values), float(np.median(values)), max(values)
            return f"{name:34s} {low:8.0f} {mid:8.0f} {high:8.0f} ms"

        return [
            f"{self.rollouts} rollouts of {self.ticks * 0.02:.2f} s      "
            "      best   median    worst",
            row("check", self.check_ms),
            row("the same steps, no policies", self.stepping_ms),
            f"{'ratio of the medians':34s} {self.ratio:17.2f}",
            row("answer after its deadline", self.late_ms),
            f"rollouts done within 150 ms         {min(self.hurried_rollouts)} to "
            f"{max(self.hurried_rollouts)}",
        ]


def capture_query() -> tuple[transition_query_t, Atlas]:
    """Return a question that control really asks, shortly before a change, and its atlas."""
    skills = load_skills()
    atlas = Atlas.load(BUNDLED_ATLAS, skills) if BUNDLED_ATLAS.exists() else _stand_in(skills)
    proof = ProofConfig(use_checker=True)
    core = ControlCore(SkillLibrary.load(), CoreConfig(proof=proof), atlas)
    found: list[transition_query_t] = []
    tick = core.tick

    def listen(inputs: Any) -> Any:
        output = tick(inputs)
        if output.query is not None:
            found.append(output.query)
        return output

    core.tick = listen  # type: ignore[method-assign]
    for _ in play(SkillLibrary.load(), MotionTrial(PAIR[0], then=PAIR[1], then_s=3.0), core):
        if found:
            return found[-1], atlas
    raise RuntimeError("control asked nothing")


def _stand_in(skills: Any) -> Atlas:
    """Return an atlas that proves one pair, for a machine without one."""
    pairs = [("stand", PAIR[0]), PAIR]
    cells = []
    for a, b in pairs:
        source, target = skills[a], skills[b]
        bound = np.full((exit_slots(source).count, entry_slots(target).count), 0.009, np.float32)
        cells.append(Cell(a, b, modes_between(source, target)[0].name, bound, 384, 0))
    return Atlas(cells)


def bench_check(repeats: int = REPEATS, threads: int = 0) -> CheckBench:
    """Measure on this machine."""
    query, atlas = capture_query()
    query.num_rollouts, query.horizon_s = ROLLOUTS, HORIZON_S
    checker = Checker(load_skills(), atlas, ProofConfig(use_checker=True), threads)
    ticks = _pin_length(checker, query)
    check_ms, stepping_ms, late_ms, done = [], [], [], []
    checker.check(query)
    # In turns of a few: the idle threads of one pool of simulations spin for a while and would
    # slow down the other one.
    for _ in range(TURNS):
        check_ms += [checker.check(query).compute_us * 1e-3 for _ in range(repeats // TURNS)]
        bare = _Bare(ROLLOUTS, checker.engine.threads)
        stepping_ms += [bare.run(ticks) for _ in range(repeats // TURNS)]
        del bare
    for _ in range(repeats):
        late, count = _hurry(checker, query)
        late_ms.append(late)
        done.append(count)
    return CheckBench(ROLLOUTS, ticks, check_ms, stepping_ms, late_ms, done)


def _pin_length(checker: Checker, query: transition_query_t) -> int:
    """Let every rollout last the whole horizon; return its ticks."""
    from downbeat.sim import checker as module
    from downbeat.sim.batch.rehearsal import rehearse

    module.SETTLE_S = 1e6
    lead = rehearse(query, checker.manifests, checker.atlas, checker.proof).onset_tick
    query.horizon_s = HORIZON_S - lead * 0.02
    plan = rehearse(query, checker.manifests, checker.atlas, checker.proof)
    return plan.script.ticks


class _Bare:
    """The physics alone: N robots in the default pose, held by their motors."""

    def __init__(self, count: int, threads: int) -> None:
        from downbeat.sim.batch.states import standing_qpos

        self._batch = mujoco_batch.Batch(batch_model(), count, nthread=threads)
        for name in ("sensordata", "actuator_force", "xpos", "xmat"):
            self._batch.bind(name)
        self._qpos = standing_qpos()

    def run(self, ticks: int) -> float:
        """Step for so many ticks; return the time [ms]."""
        batch = self._batch
        batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE)
        batch.bind("qpos")[:] = self._qpos
        batch.bind("ctrl")[:] = self._qpos[7:]
        began = time.perf_counter()
        for _ in range(ticks):
            batch.step(nstep=SUBSTEPS)
        return (time.perf_counter() - began) * 1e3


HURRY_US = 150_000


def _hurry(checker: Checker, query: transition_query_t) -> tuple[float, int]:
    """Ask with too little time, through the process's own node; return lateness [ms], rollouts."""
    clock = SimClock(SIM_EPOCH_UTIME)
    hub = MemqHub(0)
    asker = hub.endpoint("control", clock)
    asker.subscribe("TRANSITION_VERDICT")
    node = CheckerNode(hub.endpoint("checker", clock), checker)
    query.header.utime = clock.utime()
    query.deadline_utime = clock.utime() + HURRY_US
    asker.publish("TRANSITION_QUERY", query)
    began = time.perf_counter()
    node.step(clock.utime())
    late = (time.perf_counter() - began) * 1e3 - HURRY_US * 1e-3
    asker.pump()
    verdicts: list[transition_verdict_t] = [r.msg for r in asker.take("TRANSITION_VERDICT")]
    return late, int(verdicts[0].num_rollouts) if verdicts else 0
