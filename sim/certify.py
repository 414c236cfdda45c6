"""Certificates: every skill alone, in closed loop through ONNX Runtime, under what may go wrong.

    python -m downbeat.sim.certify --skills policies --write kpop zombie

A run starts in the stand, enters the skill as control does and dances 30 s. A skill is certified
when no run of a required case falls; the tempo range is what survives around the built tempo. One
process does one skill; what is written stays written, so an interrupted certification goes on where
it stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from downbeat.control.transitions import FOOTWORK_BLEND_TICKS, PLANTED_BLEND_TICKS
from downbeat.policies.manifest import (
    BUNDLED_SKILLS,
    Certificate,
    CertificateCase,
    SkillManifest,
    load_manifest,
    load_skills,
)
from downbeat.runtime.errors import one_of
from downbeat.sim.errors import SimError
from downbeat.sim.stage import (
    FINE,
    HEAVY,
    LATE,
    LIGHT,
    NOISY,
    NOMINAL,
    TICK_S,
    TICKS_PER_S,
    Act,
    Stage,
    StageSkill,
    Variation,
)
from downbeat.sim.verdict import Verdict, summary, versions, write_verdict

SECONDS = 30.0
STAND_TICKS = 25
METHOD = (
    "30 s per run in MuJoCo through ONNX Runtime, entered from the stand as control enters it, "
    "hardware-like noise unless stated; a fall is a pelvis below 0.5 m"
)
CASES: tuple[tuple[str, Variation, int], ...] = (
    ("hardware noise", NOMINAL, 4),
    ("mass +5 %, friction .57", HEAVY, 3),
    ("mass -5 %, friction .63", LIGHT, 3),
    ("20 ms delay", LATE, 3),
    ("half BeyondMimic noise", NOISY, 3),
    ("physics 2 ms", FINE, 2),
)
"""Name, variation, runs."""
TEMPOS_BPM = (80, 85, 90, 95, 100, 105, 110, 115, 120, 125, 130, 135, 140, 145, 150, 155, 160)
SLOWEST_CHANGED_BPM = {
    "boxstep": 100, "turnstep": 100, "salsastep": 95, "discostep": 95, "zombie": 90
}  # fmt: skip
"""Slower footwork goes on well alone, but 2 to 6 % fall when it is entered or left: the sweep over
80 to 160 BPM, 391,676 rollouts (docs/transitions.md)."""
TEMPO_RUNS: tuple[Variation, ...] = (NOMINAL, HEAVY, LIGHT, LATE, FINE)
"""One run each per tempo."""
PUSHES_N_S = (2.0, 4.0, 6.0, 8.0, 10.0, 12.0)
PUSH_TICKS = 5
PUSH_PHASES = 4
PUSH_DIRECTIONS = ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
"""Forward, back, left, right."""


@dataclass(frozen=True, slots=True)
class Solo:
    """One run of a skill alone."""

    survived_s: float
    rmse_rad: float
    drift_m: float
    fell: bool


def enter(stage: Stage, skill: StageSkill, rate: float, phase_s: float = 0.0) -> None:
    """Enter a skill from the stand as control does: footwork at phase 0, others anywhere."""
    if skill.manifest.kind == "planted":
        stage.switch(Act(skill, phase_s, rate), PLANTED_BLEND_TICKS)
        return
    half = FOOTWORK_BLEND_TICKS // 2
    stage.switch(Act(skill, 0.0, rate), FOOTWORK_BLEND_TICKS, hold_ticks=half)


def solo(
    skill: StageSkill,
    stand: StageSkill,
    variation: Variation,
    seed: int,
    rate: float = 1.0,
    seconds: float = SECONDS,
) -> Solo:
    """Dance one skill alone."""
    stage = Stage(stand, variation, seed)
    stage.run(STAND_TICKS)
    phase = float(np.random.default_rng(seed).uniform(0.0, skill.manifest.duration_s))
    enter(stage, skill, rate, phase)
    before = stage.feet_pos()
    start = stage.trace.ticks
    # Whole loops, so that stepping feet are compared at the same place of the dance.
    loop = skill.manifest.duration_s / rate
    loops = max(1, int(np.ceil(seconds / loop))) if loop > 0.5 else 1
    ticks = round(max(seconds, loops * loop if loop > 0.5 else seconds) / TICK_S)
    stage.run(ticks)
    moved = np.linalg.norm((stage.feet_pos() - before)[:, :2], axis=1).max()
    survived = (stage.trace.ticks - start) * TICK_S
    return Solo(survived, stage.trace.rmse_rad, float(moved), stage.is_fallen)


def run_case(
    name: str, skill: StageSkill, stand: StageSkill, runs: Iterable[tuple[Variation, float]]
) -> CertificateCase:
    """Run one case; each run is a variation and a phase rate."""
    results = [
        solo(skill, stand, variation, seed, rate) for seed, (variation, rate) in enumerate(runs)
    ]
    return CertificateCase(
        name=name,
        seconds=SECONDS,
        runs=len(results),
        falls=sum(result.fell for result in results),
        survived_s=round(min(result.survived_s for result in results), 2),
        rmse_rad=round(max(result.rmse_rad for result in results), 4),
        drift_m=round(max(result.drift_m for result in results), 3),
    )


def largest_push(skill: StageSkill, stand: StageSkill, direction: Sequence[float]) -> float:
    """Return the largest impulse [N s] on the torso that is survived at every tested phase."""
    survived = 0.0
    for impulse in PUSHES_N_S:
        for index in range(PUSH_PHASES):
            stage = Stage(stand, NOMINAL, index)
            stage.run(STAND_TICKS)
            enter(stage, skill, 1.0)
            stage.run(TICKS_PER_S + round(index / PUSH_PHASES * skill.manifest.ticks))
            stage.push_n = np.array(direction) * impulse / (PUSH_TICKS * TICK_S)
            stage.run(PUSH_TICKS)
            stage.push_n = None
            if not stage.run(4 * TICKS_PER_S):
                return survived
        survived = impulse
    return survived


def tempo_cases(skill: StageSkill, stand: StageSkill) -> list[tuple[float, CertificateCase]]:
    """Run the tempos outwards from the built one until the first fall on either side."""
    built = skill.manifest.bpm
    found: list[tuple[float, CertificateCase]] = []
    faster = [bpm for bpm in TEMPOS_BPM if bpm >= built]
    floor = SLOWEST_CHANGED_BPM.get(skill.manifest.name, 0)
    slower = [bpm for bpm in reversed(TEMPOS_BPM) if floor <= bpm < built]
    for tempos in (slower, faster):
        for bpm in tempos:
            runs = [(variation, bpm / built) for variation in TEMPO_RUNS]
            case = run_case(f"{bpm} BPM", skill, stand, runs)
            found.append((float(bpm), case))
            if case.falls:
                break
    return sorted(found, key=lambda entry: entry[0])


def certify_skill(skill: StageSkill, stand: StageSkill) -> Verdict:
    """Run all cases of a dance, a gesture or the stand."""
    manifest = skill.manifest
    cases = [
        run_case(name, skill, stand, [(variation, 1.0)] * runs) for name, variation, runs in CASES
    ]
    passed = not any(case.falls for case in cases)
    tempo_range = (0.0, 0.0)
    if manifest.bpm > 0.0:
        tempos = tempo_cases(skill, stand)
        cases += [case for _, case in tempos]
        good = [bpm for bpm, case in tempos if not case.falls]
        tempo_range = (min(good), max(good)) if good else (manifest.bpm, manifest.bpm)
        passed = passed and bool(good)
    pushes = tuple(largest_push(skill, stand, direction) for direction in PUSH_DIRECTIONS)
    certificate = Certificate(METHOD, versions(), passed, pushes, tuple(cases))
    return Verdict(certificate, tempo_range)


def stand_of(folder: Path) -> SkillManifest:
    """Return the folder's own stand, else the bundled one."""
    own = folder / "stand" / "manifest.toml"
    return load_manifest(own if own.exists() else BUNDLED_SKILLS / "stand" / "manifest.toml")


def _certify_one(folder: Path, name: str) -> tuple[str, Verdict]:
    from downbeat.sim.certify_learned import certify_learned
    from downbeat.sim.certify_walk import certify_walk  # it imports this module

    manifest = load_skills(folder)[name]
    if manifest.policy is not None:
        return name, certify_learned(manifest)
    skill = StageSkill(manifest)
    stand = StageSkill(stand_of(folder))
    if skill.manifest.kind == "locomotion":
        return name, certify_walk(skill, stand)
    return name, certify_skill(skill, stand)


def certify(
    names: Sequence[str] = (),
    folder: Path | None = None,
    write: bool = False,
    workers: int = 2,
    report: Callable[[str, Verdict], None] | None = None,
) -> dict[str, Verdict]:
    """Certify skills.

    Args:
        names: Which; empty: all of the folder without a certificate.
        folder: Folder of skills; None: the bundled ones. Without a stand, the bundled one serves.
        write: Write each verdict into its manifest as soon as it is there.
        workers: Processes.
        report: Called after every skill.

    Raises:
        SimError: A name is unknown.
        PolicyError: A manifest is wrong.
    """
    root = folder or BUNDLED_SKILLS
    skills = load_skills(root)
    for name in names:
        if name not in skills:
            raise SimError(f"Skill '{name}' is not in {root}; skills are {one_of(skills)}.")
    asked = list(names) or [n for n, manifest in skills.items() if manifest.certificate is None]
    verdicts: dict[str, Verdict] = {}
    # Spawned, not forked: ONNX Runtime's threads do not survive a fork.
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        for name, verdict in pool.map(_certify_one, [root] * len(asked), asked):
            verdicts[name] = verdict
            if write:
                write_verdict(skills[name], verdict)
            if report is not None:
                report(name, verdict)
    return verdicts


def main() -> int:
    """Certify from the command line."""
    import argparse

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--skills", type=Path, default=None)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    verdicts = certify(
        args.names,
        args.skills,
        args.write,
        args.workers,
        lambda name, verdict: print(summary(name, verdict), flush=True),
    )
    return 0 if all(verdict.certificate.passed for verdict in verdicts.values()) else 1


if __name__ == "__main__":
    raise SystemExit(main())
