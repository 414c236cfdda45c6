"""Which balance policy catches a robot out of a skill: the measurement behind `fallback`.

    python -m downbeat.sim.catch_table --imported policies_imported

Two questions, the same trials for every candidate. Handover: the skill plays, at a random moment
the candidate takes over as control's FALLBACK does; who stands 5 s later? Push: the torso is pushed
while the skill plays; control predicts the fall and hands over by itself; who stands then? The
column "none" is control without a fallback. Bundled skills and imported ones are counted apart.
"""

from __future__ import annotations

import argparse
import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from downbeat.control.balance import FallPredictor, PredictorConfig
from downbeat.control.core import ControlCore, CoreConfig, robot_state
from downbeat.control.policy import SkillLibrary
from downbeat.policies.manifest import load_skills
from downbeat.sim.motion_trials import MotionTrial, Push, play

NONE = "none"
WATCHED_S = 5.0
FALLEN_M = 0.4
FALLEN_RAD = 0.8
EARLIEST_S = 2.5
"""By now the skill plays alone."""
IMPULSES_N_S = (8.0, 12.0, 16.0, 20.0, 25.0)
NEVER = PredictorConfig(raise_after_ticks=10**9)


@dataclass(frozen=True, slots=True)
class CatchTrial:
    """One trial of one candidate.

    Attributes:
        skill: What plays.
        fallback: Who catches; "none": nobody.
        at_s: When it happens, after the request.
        impulse_n_s: Of the push; 0: a handover without a push.
        direction_rad: Of the push.
        seed: Of the noise.
    """

    skill: str
    fallback: str
    at_s: float
    impulse_n_s: float
    direction_rad: float
    seed: int


def trials(
    skills: Sequence[str], fallbacks: Sequence[str], handovers: int, pushes: int, seed: int
) -> list[CatchTrial]:
    """Return the same trials for every candidate."""
    found = []
    for skill in skills:
        rng = np.random.default_rng([seed, *skill.encode()])
        cases = [(0.0, 0.0)] * handovers
        cases += [
            (float(rng.choice(IMPULSES_N_S)), float(rng.uniform(-math.pi, math.pi)))
            for _ in range(pushes)
        ]
        for number, (impulse, direction) in enumerate(cases):
            at_s = round(EARLIEST_S + float(rng.uniform(0.0, 6.0)), 2)
            for fallback in (*fallbacks, *((NONE,) if impulse else ())):
                found.append(CatchTrial(skill, fallback, at_s, impulse, direction, number))
    return found


@cache
def _library(imported: Path | None) -> SkillLibrary:
    return SkillLibrary.load(imported=imported)


def stands(trial: CatchTrial, imported: Path | None = None) -> bool:
    """Run one trial; whether the robot is on its feet at the end."""
    library = _library(imported)
    fallback = "" if trial.fallback == NONE else trial.fallback
    core = ControlCore(library, CoreConfig(fallback=fallback))
    if trial.fallback == NONE:
        core.predictor = FallPredictor(NEVER)
    push = None
    if trial.impulse_n_s:
        push = Push(trial.impulse_n_s, trial.direction_rad, trial.at_s)
    motion = MotionTrial(trial.skill, trial.at_s + WATCHED_S, seed=trial.seed, push=push)
    for sample in play(library, motion, core):
        if push is None and abs(sample.time_s - trial.at_s) < 1e-6:
            now = sample.status.header.utime
            core.director.fall_back("catch table", robot_state(sample.state), now, trial.fallback)
        w, x, y, _z = sample.qpos[3:7]
        lean = math.acos(max(-1.0, min(1.0, 1.0 - 2.0 * (x * x + y * y))))
        if sample.qpos[2] < FALLEN_M or lean > FALLEN_RAD or not math.isfinite(w):
            return False
    return True


def run(
    todo: Sequence[CatchTrial],
    imported: Path | None,
    jobs: int,
    report: Callable[[int, int], None] | None = None,
) -> dict[CatchTrial, bool]:
    """Run trials; the outcome of each."""
    results = {}
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        outcomes = pool.map(stands, todo, [imported] * len(todo), chunksize=8)
        for count, (trial, outcome) in enumerate(zip(todo, outcomes, strict=True), 1):
            results[trial] = outcome
            if report is not None and count % 50 == 0:
                report(count, len(todo))
    return results


def table(results: dict[CatchTrial, bool], imported: frozenset[str]) -> str:
    """Return the counts as text: caught of tried, per candidate."""
    counts: dict[tuple[str, str, str], list[int]] = defaultdict(lambda: [0, 0])
    fallbacks = list(dict.fromkeys(trial.fallback for trial in results))
    for trial, stood in results.items():
        group = "imported" if trial.skill in imported else "bundled"
        what = f"push {trial.impulse_n_s:g} N s" if trial.impulse_n_s else "handover"
        for row in (f"{group}, {what}", f"{group}, {trial.skill}, {what.split()[0]}"):
            counts[row, trial.fallback, ""][0] += stood
            counts[row, trial.fallback, ""][1] += 1
    rows = sorted({key[0] for key in counts}, key=_row_order)
    width = max(len(row) for row in rows)
    lines = [" " * width + "".join(f"{name:>16}" for name in fallbacks)]
    for row in rows:
        cells = []
        for name in fallbacks:
            good, total = counts.get((row, name, ""), (0, 0))
            cells.append(f"{good:>10}/{total:<5}" if total else f"{'-':>16}")
        lines.append(f"{row:<{width}}" + "".join(cells))
    return "\n".join(lines)


def _row_order(row: str) -> tuple[int, str, str, float]:
    parts = row.split(", ")
    number = float(parts[-1].split()[1]) if parts[-1].startswith("push ") else 0.0
    return (len(parts), parts[0], parts[1] if len(parts) == 3 else "", number)


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--imported", type=Path, default=None, help="folder of imported skills")
    parser.add_argument("--skills", nargs="*", default=[], help="default: all")
    parser.add_argument("--fallbacks", nargs="*", default=["stand"])
    parser.add_argument("--handovers", type=int, default=6)
    parser.add_argument("--pushes", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    foreign = frozenset(load_skills(args.imported)) if args.imported else frozenset()
    skills = args.skills or sorted({*load_skills(), *foreign} - set(args.fallbacks))
    todo = trials(skills, args.fallbacks, args.handovers, args.pushes, args.seed)
    results = run(
        todo, args.imported, args.jobs, lambda n, total: print(f"{n}/{total}", flush=True)
    )
    print(table(results, foreign))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
