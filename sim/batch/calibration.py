"""Does the proof keep its word? Fresh random changes, each once, in the plant of the show.

    python -m downbeat.sim.batch.calibration --trials 2000 --out docs/calibration

Every trial draws two skills, tempos, moments, whether the change is announced, a robot and a
night, asks control for both skills, and lets the planner and the checker decide. The plant takes
2 ms steps with noise, delay and torque limits; nothing of it was in the sweep. What the planner
sends through stand is played once more straight away, to see what caution costs.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from downbeat.control.atlas import BUNDLED_ATLAS, Atlas
from downbeat.control.core import ControlCore, CoreConfig
from downbeat.control.node import ControlNode
from downbeat.control.policy import SkillLibrary
from downbeat.control.prover import ProofConfig
from downbeat.lcm_types import skill_request_t, skill_status_t
from downbeat.policies.manifest import SkillManifest, load_skills
from downbeat.runtime.bus import MemqHub
from downbeat.runtime.clock import SIM_EPOCH_UTIME, SimClock
from downbeat.sim.batch.perturb import load_profile
from downbeat.sim.batch.proof import fixed_upper_bound
from downbeat.sim.batch.script import rate_for
from downbeat.sim.batch.sweep import die_with_parent
from downbeat.sim.checker import Checker, CheckerNode
from downbeat.sim.lockstep import Lockstep
from downbeat.sim.node import SimNode
from downbeat.sim.plant import PlantConfig

SEED = 0xCA11
FALLEN_M = 0.5
WATCH_S = 5.0
STAND_S = 1.2
ANNOUNCED_AHEAD_S = 6.0
EVERYTHING = ProofConfig(checked=2.0, unchecked=2.0)
"""Accepts whatever it can do at once: what would have happened."""


@dataclass(frozen=True, slots=True)
class Change:
    """One trial.

    Attributes:
        number: Seeds everything that follows.
        source: First skill.
        target: Second skill.
        tempo_bpm: Of the music of both.
        change_s: When the second is wanted, after the first was asked for.
        entry_beats: Where the second skill's phase line is then.
        announced: It is asked for ahead of time, not when it is wanted.
        mass_scale: Of the torso.
        friction: Of the soles.
        delay_us: Of commands.
    """

    number: int
    source: str
    target: str
    tempo_bpm: tuple[float, float]
    change_s: float
    entry_beats: float
    announced: bool
    mass_scale: float
    friction: float
    delay_us: int


@dataclass(frozen=True, slots=True)
class Result:
    """What became of a trial.

    Attributes:
        change: The trial.
        plan: "direct" for a change that was proven and made, "via_stand" otherwise.
        mode: Blend of a direct change.
        bound: Of the atlas, for a direct change.
        fell: Within 5 s of the wanted moment.
        early: It fell before the change began: not the change's fault.
        onset_error_s: Against the wanted moment; None: never.
        vetoed: A check refused a plan.
    """

    change: Change
    plan: str
    mode: str
    bound: float
    fell: bool
    early: bool
    onset_error_s: float | None
    vetoed: bool


def draw_changes(count: int, first: int = 0) -> list[Change]:
    """Return random changes between the bundled skills."""
    skills = load_skills()
    names = sorted(n for n, m in skills.items() if m.kind != "locomotion" and m.loop)
    profile = load_profile()
    changes = []
    for number in range(first, first + count):
        rng = np.random.default_rng([SEED, number])
        source, target = (str(n) for n in rng.choice(names, 2, replace=False))
        tempo = rng.uniform(*profile.tempo_bpm, 2)
        if rng.uniform() < 0.5:
            tempo[1] = tempo[0]
        changes.append(
            Change(
                number,
                source,
                target,
                (_danced(skills[source], tempo[0]), _danced(skills[target], tempo[1])),
                float(rng.uniform(3.0, 8.0)),
                float(rng.integers(16)),
                bool(rng.uniform() < 0.5),
                float(rng.uniform(*profile.mass_scale)),
                float(rng.uniform(*profile.friction)),
                round(float(rng.uniform(*profile.command_s)) * 1e3) * 1000,
            )
        )
    return changes


@cache
def _world(atlas: str) -> tuple[SkillLibrary, Atlas, Checker]:
    manifests = load_skills()
    opened = Atlas.load(Path(atlas), manifests)
    proof = ProofConfig(use_checker=True)
    return SkillLibrary.load(), opened, Checker(manifests, opened, proof, threads=1)


def run_change(atlas: str, change: Change, proof: ProofConfig) -> Result:
    """Play one change through control on the plant."""
    library, opened, checker = _world(atlas)
    clock = SimClock(SIM_EPOCH_UTIME)
    hub = MemqHub(change.number)
    plant = PlantConfig(
        mass_scale=change.mass_scale,
        friction=change.friction,
        seed=change.number,
        command_delay_us=change.delay_us,
    )
    sim = SimNode(hub.endpoint("sim", clock), plant)
    operator = hub.endpoint("operator", clock)
    operator.subscribe("SKILL_STATUS")
    core = ControlCore(library, CoreConfig(proof=proof), opened)
    control = ControlNode(hub.endpoint("control", clock), core)
    nodes: list[Any] = [sim, control]
    if proof.use_checker:
        nodes.append(CheckerNode(hub.endpoint("checker", clock), checker, True))
    scheduler = Lockstep(clock, nodes)
    begin = clock.utime() + round(STAND_S * 50) * 20_000
    wanted = begin + round(change.change_s * 1e6)
    ask = begin if change.announced and change.change_s < ANNOUNCED_AHEAD_S else wanted
    if change.announced and change.change_s >= ANNOUNCED_AHEAD_S:
        ask = wanted - round(ANNOUNCED_AHEAD_S * 1e6)
    scheduler.run_until(begin)
    operator.publish("OPERATOR_SKILL_REQUEST", _request(library, change, 0, begin))
    scheduler.run_until(max(ask - ask % 20_000, begin + 20_000))
    operator.publish("OPERATOR_SKILL_REQUEST", _request(library, change, 1, wanted))
    return _watch(change, scheduler, clock, sim, operator, core, wanted)


def _danced(skill: SkillManifest, tempo_bpm: float) -> float:
    """Return the tempo of music that a skill is given, as the sweep draws it."""
    if skill.bpm <= 0.0:
        return tempo_bpm
    return float(rate_for(skill, np.array([tempo_bpm]))[0] * skill.bpm)


def _request(library: SkillLibrary, change: Change, which: int, utime: int) -> Any:
    skill = (change.source, change.target)[which]
    built = library[skill].manifest.bpm
    msg = skill_request_t()
    msg.header.utime = utime
    msg.request_id, msg.skill, msg.start_utime = which + 1, skill, utime
    msg.source = skill_request_t.SOURCE_OPERATOR
    msg.phase_rate = change.tempo_bpm[which] / built if built > 0 else 1.0
    if which == 1 and built > 0:
        msg.start_phase_s = change.entry_beats * 60.0 / built
    return msg


def _watch(
    change: Change,
    scheduler: Lockstep,
    clock: SimClock,
    sim: SimNode,
    operator: Any,
    core: ControlCore,
    wanted: int,
) -> Result:
    plan, mode, bound, onset, vetoed, begun = "via_stand", "", 1.0, None, False, False
    fell = early = False
    end = wanted + round(WATCH_S * 1e6)
    while clock.utime() < end and not fell:
        chosen = core.director.prover.state.chosen
        scheduler.run_until(clock.utime() + 20_000)
        operator.pump()
        for received in operator.take("SKILL_STATUS"):
            msg = received.msg
            if msg.request_id != 2:
                continue
            vetoed |= "rollouts from here fell" in msg.reason
            if msg.state == skill_status_t.PRIMING:
                begun = True
            if msg.state == skill_status_t.BLENDING:
                if not begun and chosen is not None:
                    plan, mode, bound = "direct", chosen.plan.mode, chosen.plan.bound
                begun = True
            if msg.state == skill_status_t.RUNNING and onset is None:
                onset = (clock.utime() - wanted) * 1e-6
        fell = not sim.plant.data.qpos[2] > FALLEN_M
        early = fell and not begun
    return Result(change, plan, mode, bound, fell, early, onset, vetoed)


def run_trial(atlas: str, change: Change) -> list[Result]:
    """Play a change as the planner wants it, and, if that was not straight away, straight away."""
    first = run_change(atlas, change, ProofConfig(use_checker=True))
    if first.plan == "direct":
        return [first]
    return [first, replace(run_change(atlas, change, EVERYTHING), plan="refused")]


def run_trials(atlas: Path, changes: Sequence[Change], workers: int) -> list[Result]:
    """Run trials in processes, in order."""
    context = get_context("spawn")
    with ProcessPoolExecutor(workers, context, initializer=die_with_parent) as pool:
        names = [str(atlas)] * len(changes)
        return [r for found in pool.map(run_trial, names, changes, chunksize=10) for r in found]


@dataclass(frozen=True)
class Calibration:
    """What the trials say.

    Attributes:
        trials: Changes that were reached on the feet.
        accepted: Made directly.
        accepted_fallen: Of these.
        safe: Changes that would have been safe straight away.
        safe_accepted: Of these, made directly.
        via_stand_fallen: Falls on the way through stand.
        vetoed: Trials in which a check refused a plan.
    """

    trials: int
    accepted: int
    accepted_fallen: int
    safe: int
    safe_accepted: int
    via_stand_fallen: int
    vetoed: int

    def lines(self) -> list[str]:
        """Return the table for people."""
        upper = fixed_upper_bound(self.accepted_fallen, self.accepted)
        return [
            f"changes tried                     {self.trials}",
            f"accepted, fell                    {self.accepted_fallen} of {self.accepted} "
            f"({self.accepted_fallen / max(self.accepted, 1):.2%}, at most {upper:.2%})",
            f"would have been safe, accepted    {self.safe_accepted} of {self.safe} "
            f"({self.safe_accepted / max(self.safe, 1):.1%})",
            f"sent through stand, fell          {self.via_stand_fallen} of "
            f"{self.trials - self.accepted}",
            f"plans that a check refused        {self.vetoed}",
        ]


def judge(results: Sequence[Result]) -> Calibration:
    """Summarise."""
    planned = [r for r in results if r.plan != "refused" and not r.early]
    direct = [r for r in planned if r.plan == "direct"]
    refused = [r for r in results if r.plan == "refused" and not r.early]
    good = sum(not r.fell for r in direct)
    return Calibration(
        trials=len(planned),
        accepted=len(direct),
        accepted_fallen=sum(r.fell for r in direct),
        safe=good + sum(not r.fell for r in refused),
        safe_accepted=good,
        via_stand_fallen=sum(r.fell for r in planned if r.plan == "via_stand"),
        vetoed=sum(r.vetoed for r in planned),
    )


def main() -> int:
    """Calibrate from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--atlas", type=Path, default=BUNDLED_ATLAS)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("runs/calibration"))
    args = parser.parse_args()
    results = run_trials(args.atlas, draw_changes(args.trials, args.first), args.workers)
    args.out.mkdir(parents=True, exist_ok=True)
    rows = [asdict(result) for result in results]
    (args.out / "trials.json").write_text(json.dumps(rows), encoding="utf-8")
    found = judge(results)
    print("\n".join(found.lines()))
    for r in results:
        if r.fell:
            print(
                f"fell: {r.change.number} {r.change.source} -> {r.change.target} {r.plan} {r.mode}"
            )
    return 0 if found.accepted_fallen <= 0.005 * found.accepted else 1


if __name__ == "__main__":
    raise SystemExit(main())
