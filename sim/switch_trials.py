"""How far the motors' targets jump at a switch, against how far they jump within a skill.

    python -m downbeat.sim.switch_trials stand kpop discostep walk

Every ordered pair is played through the real control core on the plant, with noise and delay, and
the largest one-tick change of a position target during the change is compared with the 99th
percentile of the two skills' own (and of the stand's, where the way leads through it).
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from downbeat.control.core import ControlCore, CoreConfig
from downbeat.control.policy import SkillLibrary
from downbeat.sim.motion_trials import MotionTrial, play

OWN_SECONDS = 8.0
ASKED_S = 5.0
SECONDS = 13.0
WALK = (0.2, 0.0, 0.0)
FALLEN_M = 0.5


@dataclass(frozen=True, slots=True)
class Switch:
    """One change.

    Attributes:
        before: Skill that was left.
        after: Skill that was entered.
        jump_rad: Largest one-tick change of a target during the blends.
        own_rad: Larger of the p99 jumps of the skills that took part.
        onset_s: From the request to weight 0.5 of the asked skill; NaN: never.
        fell: Whether the robot fell.
    """

    before: str
    after: str
    jump_rad: float
    own_rad: float
    onset_s: float
    fell: bool

    @property
    def ratio(self) -> float:
        """Jump against the skills' own."""
        return self.jump_rad / self.own_rad


def own_jump(library: SkillLibrary, name: str, seed: int = 0) -> float:
    """Return the 99th percentile of a skill's own one-tick target changes [rad]."""
    velocity = WALK if library[name].manifest.kind == "locomotion" else (0.0, 0.0, 0.0)
    jumps = [
        sample.status.target_jump
        for sample in play(library, MotionTrial(name, OWN_SECONDS, seed=seed, velocity=velocity))
        if sample.status.skill == name and sample.status.blend_weight >= 1.0
    ]
    return float(np.percentile(jumps, 99)) if jumps else float("nan")


def switch(
    library: SkillLibrary,
    before: str,
    after: str,
    own: dict[str, float],
    fallback: str = "",
    seed: int = 1,
) -> Switch:
    """Play one change and measure it."""
    trial = MotionTrial(before, SECONDS, then=after, then_s=ASKED_S, seed=seed)
    core = ControlCore(library, CoreConfig(fallback=fallback))
    jump, limit, onset_s, fell = 0.0, max(own[before], own[after]), float("nan"), False
    for sample in play(library, trial, core):
        status = sample.status
        fell = bool(sample.qpos[2] < FALLEN_M)
        if sample.time_s < ASKED_S:
            continue
        if status.previous_skill:
            jump = max(jump, status.target_jump)
            for name in (status.skill, status.previous_skill):
                limit = max(limit, own.get(name, 0.0))
        if status.skill == after and status.blend_weight >= 0.5 and onset_s != onset_s:
            onset_s = sample.time_s - ASKED_S
    return Switch(before, after, jump, limit, onset_s, fell)


def survey(library: SkillLibrary, names: Sequence[str], fallback: str) -> list[Switch]:
    """Play every ordered pair."""
    own = {name: own_jump(library, name) for name in {*names, "stand"}}
    pairs = [pair for pair in itertools.permutations(names, 2) if pair[1] != "stand"]
    return [switch(library, a, b, own, fallback) for a, b in pairs]


def main() -> int:
    """Print the table; 0 if nothing fell and every jump is within twice the skills' own."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="+")
    parser.add_argument("--imported", type=Path, default=None)
    parser.add_argument("--fallback", default="")
    args = parser.parse_args()
    library = SkillLibrary.load(imported=args.imported)
    found = sorted(survey(library, args.names, args.fallback), key=lambda s: -s.ratio)
    for s in found:
        mark = "FELL" if s.fell else ""
        print(
            f"{s.before:>14} -> {s.after:<14} jump {s.jump_rad:.3f} rad, own p99 {s.own_rad:.3f},"
            f" ratio {s.ratio:.2f}, onset after {s.onset_s:.2f} s {mark}"
        )
    falls, above = sum(s.fell for s in found), sum(s.ratio > 2.0 for s in found)
    print(f"{len(found)} changes, {falls} falls, {above} jumps above twice the skills' own p99")
    return 1 if falls or above else 0


if __name__ == "__main__":
    raise SystemExit(main())
