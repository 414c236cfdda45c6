"""How early a fall is predicted, and how often for nothing.

    python -m downbeat.sim.fall_prediction --jobs 2

First every skill dances undisturbed, on robots that are 10 % heavier, lighter, or on other floors,
faster and slower, and into other skills: an alarm there would be false. Then every skill is pushed,
5 to 60 N s on the torso within 0.1 s, from anywhere, at any moment. A fall is a pelvis below 0.4 m
or tilted by more than 0.8 rad within 4 s of the push. The plant is the show's: 2 ms steps, sensor
noise, 4 ms command delay; the estimate sees what control sees. Control itself does not react to its
prediction here, so that it shows who would have stayed on his feet.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from downbeat.control.allowed import allowed_fall_limits
from downbeat.control.balance import FallPredictor, PredictorConfig, tilt_and_rate
from downbeat.control.core import ControlCore
from downbeat.control.estimate import Estimate, StateEstimator
from downbeat.control.policy import SkillLibrary
from downbeat.control.vectors import rotation_of
from downbeat.policies.manifest import load_skills
from downbeat.sim.motion_trials import MotionTrial, Push, Sample, play

NEVER = PredictorConfig(raise_after_ticks=10**9)
FALLEN_M = 0.4
FALLEN_RAD = 0.8
SETTLED_S = -0.5
"""From here on the gantry has let go, and alarms count."""
CALM_S = 12.0
AFTER_PUSH_S = 4.0
IMPULSES_N_S = (5.0, 8.0, 11.0, 14.0, 17.0, 20.0, 25.0, 30.0, 40.0, 60.0)
ROBOTS = ((1.0, 0.6), (1.1, 0.6), (0.9, 0.6), (1.0, 0.54), (1.0, 0.66), (1.1, 0.54), (0.9, 0.66))
"""Mass of the torso, friction of the soles."""
RATES = (0.85, 1.15)
WALKS = ((0.25, 0.0, 0.0), (0.15, 0.0, 0.3), (-0.1, 0.0, -0.3))
CHANGES_PER_SKILL = 7


@dataclass(frozen=True, slots=True)
class Outcome:
    """One run.

    Attributes:
        trial: What was done.
        kind: Of the skill in play when it was pushed, or at the end.
        alarm_s: When a fall was predicted first; None: never.
        cause: Of that prediction.
        fell_s: When the robot had fallen; None: it did not.
        support_margins: (ticks,) [m] as estimated, until the fall.
        step_margins: (ticks,) [m].
        tilt_rad: Largest measured.
    """

    trial: MotionTrial
    kind: str
    alarm_s: float | None
    cause: str
    fell_s: float | None
    support_margins: tuple[float, ...]
    step_margins: tuple[float, ...]
    tilt_rad: float


def watch(library: SkillLibrary, trial: MotionTrial) -> Outcome:
    """Play a trial with an estimator and a predictor looking on."""
    estimator, predictor = StateEstimator(), FallPredictor()
    core = ControlCore(library)
    core.predictor = FallPredictor(NEVER)
    alarm_s: float | None = None
    fell_s: float | None = None
    kind = cause = ""
    margins: list[tuple[float, float]] = []
    largest_tilt = 0.0
    pushed_s = trial.seconds if trial.push is None else trial.push.start_s
    for sample in play(library, trial, core):
        if _has_fallen(sample):
            fell_s = sample.time_s
            break
        estimate, tilt, tilt_rate = look(estimator, sample)
        limits = allowed_fall_limits(core.director.playing)
        if sample.time_s < SETTLED_S or limits is None:
            continue
        if sample.time_s <= pushed_s:
            kind = library[sample.status.skill].manifest.kind
        prediction = predictor.update(estimate, tilt, tilt_rate, limits)
        if prediction.is_falling and alarm_s is None:
            alarm_s, cause = sample.time_s, prediction.cause
        margins.append((estimate.support_margin, estimate.step_margin))
        largest_tilt = max(largest_tilt, tilt)
    support, step = zip(*margins)
    return Outcome(trial, kind, alarm_s, cause, fell_s, support, step, largest_tilt)


def look(estimator: StateEstimator, sample: Sample) -> tuple[Estimate, float, float]:
    """Return the estimate, the tilt [rad] and its rate [rad/s] from what control saw."""
    imu, state = sample.state.imu_pelvis, sample.state
    estimate = estimator.update(imu.quat, imu.gyro, imu.accel, state.joint_pos, state.joint_vel)
    return estimate, *tilt_and_rate(imu.quat.tolist(), imu.gyro.tolist())


def _has_fallen(sample: Sample) -> bool:
    up = rotation_of(sample.qpos[3:7].tolist())[2][2]
    return float(sample.qpos[2]) < FALLEN_M or up < math.cos(FALLEN_RAD)


# ---------------------------------------------------------------------- what is run


def calm_trials(names: Sequence[str], tempos: frozenset[str]) -> list[MotionTrial]:
    """Return undisturbed runs: every robot, every tempo, and changes between skills."""
    rng = np.random.default_rng(11)
    trials: list[MotionTrial] = []
    for name in names:
        settings = [(mass, friction, 1.0) for mass, friction in ROBOTS]
        settings += [(1.0, 0.6, rate) for rate in RATES if name in tempos]
        for seed, (mass, friction, rate) in enumerate(settings):
            walk = WALKS[seed % len(WALKS)]
            trials.append(MotionTrial(name, CALM_S, mass, friction, seed, walk, rate))
    for seed in range(CHANGES_PER_SKILL * len(names) if len(names) > 1 else 0):
        first, second = (str(name) for name in rng.choice(names, 2, replace=False))
        mass, friction = ROBOTS[seed % len(ROBOTS)]
        when = float(rng.uniform(3.0, 7.0))
        trials.append(
            MotionTrial(
                first, CALM_S, mass, friction, seed, WALKS[seed % 3], then=second, then_s=when
            )
        )
    return trials


def pushed_trials(names: Sequence[str], runs: int, seed: int) -> list[MotionTrial]:
    """Return pushed runs: `runs` of each impulse for each skill."""
    rng = np.random.default_rng(seed)
    trials: list[MotionTrial] = []
    for name in names:
        for impulse in IMPULSES_N_S:
            for _ in range(runs):
                start_s = round(float(rng.uniform(3.0, 6.0)) * 50) / 50
                push = Push(impulse, float(rng.uniform(-math.pi, math.pi)), start_s)
                noise_seed = int(rng.integers(1_000_000))
                seconds = start_s + AFTER_PUSH_S
                trials.append(
                    MotionTrial(name, seconds, seed=noise_seed, velocity=(0.2, 0.0, 0.0), push=push)
                )
    return trials


@cache
def _library(folder: Path | None) -> SkillLibrary:
    return SkillLibrary.load(folder)


def _watch(job: tuple[Path | None, MotionTrial]) -> Outcome:
    folder, trial = job
    return watch(_library(folder), trial)


# ---------------------------------------------------------------------- what is printed


def calm_lines(outcomes: Iterable[Outcome]) -> list[str]:
    """Return the table of undisturbed skills."""
    lines = [
        "undisturbed            kind        runs  falls  alarms  support margin   step margin [m]"
        "     tilt",
        "                                                       worst   median   worst  3 ticks"
        "  max [rad]",
    ]
    groups = _grouped(outcomes, lambda o: "(changes)" if o.trial.then else o.trial.skill)
    for name, group in groups.items():
        support = np.concatenate([o.support_margins for o in group])
        lines.append(
            f"{name:22s} {group[0].kind:10s} {len(group):5d} {_falls(group):6d}"
            f" {sum(o.alarm_s is not None for o in group):7d}"
            f" {np.nanmin(support):7.3f} {np.nanmedian(support):8.3f}"
            f" {min(min(o.step_margins) for o in group):7.3f}"
            f" {min(_sustained(o.step_margins, 3) for o in group):8.3f}"
            f" {max(o.tilt_rad for o in group):10.2f}"
        )
    return lines


def pushed_lines(outcomes: Iterable[Outcome]) -> list[str]:
    """Return the table of pushed skills: by kind and impulse, then by kind."""
    every = sorted(outcomes, key=lambda o: (o.kind, o.trial.push.impulse_n_s))
    lines = [
        "pushed      impulse  runs  fell  predicted   lead [s]           survived  false",
        "            [N s]                            least    5 %  50 %            alarms",
    ]
    by_impulse = _grouped(every, lambda o: (o.kind, f"{o.trial.push.impulse_n_s:.0f}"))
    for key, group in by_impulse.items():
        lines.append(_pushed_line(*key, group))
    for kind, group in _grouped(every, lambda o: o.kind).items():
        lines.append(_pushed_line(kind, "all", group))
    return lines


def _pushed_line(kind: str, impulse: str, group: Sequence[Outcome]) -> str:
    fell = [o for o in group if o.fell_s is not None]
    leads = [o.fell_s - o.alarm_s for o in fell if o.alarm_s is not None]
    false = sum(o.alarm_s is not None for o in group if o.fell_s is None)
    least, early, half = np.percentile(leads, (0, 5, 50)) if leads else (math.nan,) * 3
    return (
        f"{kind:11s} {impulse:>6s} {len(group):6d} {len(fell):5d} {len(leads):8d}"
        f"    {least:6.2f} {early:6.2f} {half:5.2f} {len(group) - len(fell):9d} {false:7d}"
    )


def _falls(group: Sequence[Outcome]) -> int:
    return sum(o.fell_s is not None for o in group)


def _sustained(margins: Sequence[float], ticks: int) -> float:
    """Return the lowest value that lasted for so many ticks in a row."""
    windows = np.lib.stride_tricks.sliding_window_view(np.asarray(margins), ticks)
    return float(windows.max(axis=1).min())


def _grouped(outcomes: Iterable[Outcome], key: Callable[[Outcome], object]) -> dict:
    groups: dict = {}
    for outcome in outcomes:
        groups.setdefault(key(outcome), []).append(outcome)
    return groups


def main() -> int:
    """Run from the command line; 1 if an undisturbed skill raised an alarm."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--skills", type=Path, default=None, help="folder; default: the bundled")
    parser.add_argument("--only", nargs="*", default=None, help="names of skills")
    parser.add_argument("--part", choices=("all", "calm", "pushed"), default="all")
    parser.add_argument("--runs", type=int, default=4, help="per skill and impulse")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    args = parser.parse_args()
    manifests = load_skills(args.skills)
    names = sorted(args.only or manifests)
    tempos = frozenset(n for n in names if manifests[n].bpm > 0)
    calm = [] if args.part == "pushed" else calm_trials(names, tempos)
    pushed = [] if args.part == "calm" else pushed_trials(names, args.runs, args.seed)
    jobs = [(args.skills, trial) for trial in calm + pushed]
    with ProcessPoolExecutor(args.jobs, mp_context=get_context("spawn")) as pool:
        outcomes = list(pool.map(_watch, jobs, chunksize=4))
    undisturbed = outcomes[: len(calm)]
    if calm:
        print("\n".join(calm_lines(undisturbed)), flush=True)
    if pushed:
        print("\n".join(pushed_lines(outcomes[len(calm) :])))
    return 1 if any(o.alarm_s is not None for o in undisturbed) else 0


if __name__ == "__main__":
    raise SystemExit(main())
