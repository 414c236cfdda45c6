"""How often a change of skill ends in a fall, measured trial by trial.

    python -m downbeat.sim.transition_survey --out docs/transitions_measured.md --write

Every trial draws its own noise, its model (nominal, mass +5 % / friction .57, -5 % / .63, 2 ms
physics), its tempo (100 to 140 BPM) and, where phases are free, its phases; the robot must be on
its feet 4 s later.
Blends are control's own. With `--write`, the exits without a fall go into the manifests.
"""

from __future__ import annotations

import argparse
import tomllib
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from downbeat.control.transitions import (
    FOOTWORK_BLEND_TICKS,
    PLANTED_BLEND_TICKS,
    STAND_HOLD_TICKS,
    WALK_BLEND_TICKS,
)
from downbeat.policies.generator.build import CHOREOGRAPHIES
from downbeat.policies.manifest import BUNDLED_SKILLS, SkillManifest, load_manifest, load_skills
from downbeat.policies.toml_text import write_toml
from downbeat.sim.stage import (
    FINE,
    HEAVY,
    LIGHT,
    NOMINAL,
    TICK_S,
    Act,
    Stage,
    StageSkill,
)
from downbeat.sim.transition_report import Outcome, Trial, report

MODELS = (NOMINAL, HEAVY, LIGHT, FINE)
STAND_TICKS = 25
WATCH_TICKS = 200
TEMPO_BPM = (100.0, 140.0)
HALF_FOOTWORK = FOOTWORK_BLEND_TICKS // 2


@cache
def _skills(folder: Path) -> dict[str, StageSkill]:
    return {name: StageSkill(manifest) for name, manifest in load_skills(folder).items()}


def run_trial(folder: Path, trial: Trial) -> Outcome:
    """Run one trial."""
    skills = _skills(folder)
    rng = np.random.default_rng([trial.seed, *trial.kind.encode(), *trial.target.encode()])
    stage = Stage(skills["stand"], MODELS[int(rng.integers(len(MODELS)))], int(rng.integers(2**31)))
    stage.run(STAND_TICKS + int(rng.integers(20)))
    source, target = skills[trial.source], skills[trial.target]
    _lead_in(stage, source, trial, rng)
    early = stage.is_fallen
    _change(stage, trial, target, skills["stand"], rng)
    stage.run(WATCH_TICKS)
    return Outcome(trial, stage.is_fallen, early)


def _rate(skill: StageSkill, rng: np.random.Generator) -> float:
    bpm = skill.manifest.bpm
    return float(rng.uniform(*TEMPO_BPM)) / bpm if bpm > 0.0 else 1.0


def _phase(skill: StageSkill, rng: np.random.Generator) -> float:
    return float(rng.uniform(0.0, skill.manifest.duration_s))


def _lead_in(stage: Stage, source: StageSkill, trial: Trial, rng: np.random.Generator) -> None:
    """Bring the source skill to the moment of the change."""
    kind = source.manifest.kind
    if source.manifest.name == "stand":
        return
    rate = _rate(source, rng)
    if kind == "planted":
        stage.switch(Act(source, _phase(source, rng), rate), PLANTED_BLEND_TICKS)
        stage.run(60 + int(rng.integers(60)))
        return
    blend = WALK_BLEND_TICKS if kind == "locomotion" else FOOTWORK_BLEND_TICKS
    stage.switch(Act(source, 0.0, rate), blend, hold_ticks=blend // 2)
    before = HALF_FOOTWORK * TICK_S * rate if trial.kind == "loop" else 0.0
    stage.run(5)
    _run_to_phase(stage, (trial.exit_s - before) % source.manifest.duration_s)


def _run_to_phase(stage: Stage, phase_s: float) -> None:
    """Play on until the tick that stands nearest to a phase."""
    duration = stage.act.skill.manifest.duration_s
    left = (phase_s - stage.act.phase_s) % duration
    stage.run(round(left / (stage.act.rate * TICK_S)))


def _change(
    stage: Stage, trial: Trial, target: StageSkill, stand: StageSkill, rng: np.random.Generator
) -> None:
    rate = _rate(target, rng)
    entry = Act(target, 0.0, rate)
    if trial.kind in ("planted", "planted_short", "exit_planted"):
        blend = FOOTWORK_BLEND_TICKS if trial.kind == "planted_short" else PLANTED_BLEND_TICKS
        stage.switch(Act(target, _phase(target, rng), rate), blend)
    elif trial.kind in ("walk_start", "walk_stop"):
        hold = WALK_BLEND_TICKS // 2 if trial.kind == "walk_start" else 0
        stage.switch(entry, WALK_BLEND_TICKS, hold_ticks=hold)
    elif trial.kind == "loop":
        stage.switch(entry, FOOTWORK_BLEND_TICKS, "legs_hard", hold_ticks=HALF_FOOTWORK)
    elif trial.kind == "via_stand":
        stage.switch(Act(stand, 0.0), FOOTWORK_BLEND_TICKS)
        stage.run(STAND_HOLD_TICKS)
        stage.switch(entry, FOOTWORK_BLEND_TICKS, hold_ticks=HALF_FOOTWORK)
    else:
        hold = 0 if trial.kind == "exit" else HALF_FOOTWORK
        stage.switch(entry, FOOTWORK_BLEND_TICKS, hold_ticks=hold)


def home_beats(name: str) -> list[float]:
    """Return the beats at which a footwork dance has both feet at home, and middles of holds."""
    dance = CHOREOGRAPHIES[name]
    away = {"left": False, "right": False}
    beats: list[float] = []
    for beat, step in enumerate(dance.steps):
        if step.foot is not None:
            away[step.foot] = any((step.x, step.y, step.yaw))
        elif not any(away.values()):
            beats.append(beat + 0.5)
        if not any(away.values()):
            beats.append(float((beat + 1) % dance.beats))
    return sorted(beats)


def make_trials(skills: dict[str, SkillManifest], count: int) -> list[Trial]:
    """Return all trials; `count` per footwork skill, exit and direction."""
    planted = [n for n, m in skills.items() if m.kind == "planted" and n != "stand"]
    stepping = [n for n, m in skills.items() if m.kind == "stepping"]
    rng = np.random.default_rng(0)
    trials: list[Trial] = []

    def add(kind: str, source: str, target: str, number: int, exit_s: float = 0.0) -> None:
        start = len(trials)
        trials.extend(Trial(kind, source, target, start + k, exit_s) for k in range(number))

    everyone = ["stand", *planted]
    for source in everyone:
        for target in everyone:
            if source != target:
                add("planted", source, target, max(2, count // 25))
                add("planted_short", source, target, max(1, count // 50))
    for name in stepping:
        manifest = skills[name]
        add("entry", "stand", name, count)
        for source in planted:
            add("direct", source, name, max(2, count // len(planted)))
        exits = [beat * 60.0 / manifest.bpm for beat in home_beats(name)]
        for exit_s in exits:
            add("exit", name, "stand", count, round(exit_s, 4))
            for target in planted:
                add("exit_planted", name, target, max(1, count // 40), round(exit_s, 4))
        for target in stepping:
            if target != name:
                add("loop", name, target, max(2, count // 4))
                exit_s = float(rng.choice(exits))
                add("via_stand", name, target, max(2, count // 4), round(exit_s, 4))
    for name in (n for n, m in skills.items() if m.kind == "locomotion"):
        add("walk_start", "stand", name, count)
        add("walk_stop", name, "stand", count)
    return trials


def run_trials(folder: Path, trials: Sequence[Trial], workers: int) -> list[Outcome]:
    """Run trials in processes, in order."""
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        return list(pool.map(run_trial, [folder] * len(trials), trials, chunksize=50))


def safe_exits(outcomes: Sequence[Outcome]) -> dict[str, list[float]]:
    """Return the exit phases [s] without a fall per footwork skill; 0 is always among them."""
    fell: dict[str, dict[float, bool]] = {}
    for outcome in outcomes:
        trial = outcome.trial
        if trial.kind == "exit" and not outcome.early:
            exits = fell.setdefault(trial.source, {0.0: False})
            exits[trial.exit_s] = exits.get(trial.exit_s, False) or outcome.fell
    return {
        name: sorted(phase for phase, bad in exits.items() if phase == 0.0 or not bad)
        for name, exits in fell.items()
    }


def write_exits(folder: Path, exits: dict[str, list[float]]) -> None:
    """Write exit phases into the manifests."""
    for name, phases in exits.items():
        path = folder / name / "manifest.toml"
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        table["exit_phases_s"] = phases
        write_toml(path, table)
        load_manifest(path)


def main() -> int:
    """Survey from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--skills", type=Path, default=BUNDLED_SKILLS)
    parser.add_argument("--count", type=int, default=100, help="trials per footwork skill and exit")
    parser.add_argument("--out", type=Path, default=None)
    parser.add_argument("--write", action="store_true", help="write exits into the manifests")
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    trials = make_trials(load_skills(args.skills), args.count)
    outcomes = run_trials(args.skills, trials, args.workers)
    text = report(outcomes, args.count)
    print(text)
    if args.out is not None:
        args.out.write_text(text, encoding="utf-8")
    if args.write:
        write_exits(args.skills, safe_exits(outcomes))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
