"""Certificates of imported policies: through the real control core, on the show's plant.

Entered from our stand with control's own cross-fade, 2 ms physics, noisy sensors, delayed commands.
A motion is played to its end; a velocity policy stands, walks and turns. What is asked is survival;
what is reported besides is how closely it follows, and how near it comes to the motors' limits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from downbeat.catalog.robot import load_g1
from downbeat.control.motion import Motion
from downbeat.control.policy import OnnxSkill, SkillLibrary, open_skill
from downbeat.policies.manifest import BUNDLED_SKILLS, Certificate, CertificateCase, load_manifest
from downbeat.policies.manifest_types import SkillLimits, SkillManifest
from downbeat.sim.motion_trials import MotionTrial, Push, play
from downbeat.sim.noise import NoiseConfig
from downbeat.sim.verdict import Verdict, versions

METHOD = (
    "played to its end (velocity policies 15 s) through the control core on the 2 ms plant, "
    "entered from the stand as control enters it, hardware-like noise and 4 ms command delay "
    "unless stated; a fall is a pelvis below 0.4 m, a tilt above 1 rad, or an early fallback"
)
FALLEN_M, FALLEN_RAD = 0.4, 1.0
WALK_SECONDS = 15.0
ENTRY_S = 1.0
"""Until a skill plays alone, and what a one-shot spends in its way out."""
CASES: tuple[tuple[str, dict[str, float], int], ...] = (
    ("hardware noise", {}, 4),
    ("torso +5 %, friction .54", {"mass_scale": 1.05, "friction": 0.54}, 3),
    ("torso -5 %, friction .66", {"mass_scale": 0.95, "friction": 0.66}, 3),
    ("20 ms delay", {"command_delay_us": 20_000}, 3),
)
"""Name, what is different, runs."""
HALF_BEYONDMIMIC = NoiseConfig(0.025, 0.1, 0.005, 0.25, 0.4)
PUSHES_N_S = (4.0, 8.0, 12.0, 16.0, 20.0, 25.0)
PUSH_PHASES = 3
DIRECTIONS_RAD = (0.0, math.pi, math.pi / 2, -math.pi / 2)
"""Forward, back, left, right."""
TILT_ROOM_RAD = 0.35


@dataclass
class Run:
    """What one run showed.

    Attributes:
        survived_s: How long it stood [s].
        fell: Whether it fell.
        rmse_rad: Joint error against the motion; 0 for velocity policies.
        drift_m: Distance from where it should be; standing: from the start.
        tilt_rad: Largest tilt.
        saturated: Largest share of ticks that one joint spent at its torque limit.
        joint: That joint.
        speed_ratio: Largest joint speed against its limit.
        jumps_rad: One-tick changes of the targets.
    """

    survived_s: float = 0.0
    fell: bool = False
    rmse_rad: float = 0.0
    drift_m: float = 0.0
    tilt_rad: float = 0.0
    saturated: float = 0.0
    joint: str = ""
    speed_ratio: float = 0.0
    jumps_rad: list[float] = field(default_factory=list)


def watch(library: SkillLibrary, name: str, trial: MotionTrial, motion: Motion | None) -> Run:
    """Play one run and measure it while the skill is alone in play."""
    robot, run = load_g1(), Run()
    length_s = library[name].manifest.duration_s
    asked_s = length_s if library[name].manifest.kind == "tracking" else trial.seconds
    order = []
    spec = library[name].manifest.policy
    if spec is not None:
        order = [robot.joint_index(joint) for joint in spec.joint_names]
    torque_ticks = np.zeros(29)
    squared, ticks, start = 0.0, 0, None
    for sample in play(library, trial):
        status = sample.status
        x, y = sample.qpos[4:6]
        lean = math.acos(max(-1.0, min(1.0, 1.0 - 2.0 * float(x * x + y * y))))
        if sample.qpos[2] < FALLEN_M or lean > FALLEN_RAD or status.mode in (1, 7):
            run.fell = True
            break
        if status.skill != name or status.blend_weight < 1.0:
            if start is not None:
                break
            continue
        start = sample.qpos[:2].copy() if start is None else start
        ticks += 1
        run.tilt_rad = max(run.tilt_rad, lean)
        run.jumps_rad.append(status.target_jump)
        torque = np.abs(np.asarray(sample.state.joint_torque_est)) >= 0.98 * robot.effort_limit
        torque_ticks += torque
        speed = float((np.abs(sample.qvel[6:]) / robot.velocity_limit).max())
        run.speed_ratio = max(run.speed_ratio, speed)
        run.drift_m = float(np.hypot(*(sample.qpos[:2] - start)))
        if motion is not None:
            error = sample.qpos[7:][order] - motion.frame(status.phase_s).joint_pos
            squared += float(np.mean(error**2))
    run.survived_s = round(ticks * 0.02, 2)
    # Who hands over to the fallback early has not fallen, and has not held out either.
    run.fell = run.fell or run.survived_s < asked_s - ENTRY_S
    if ticks:
        run.saturated = float(torque_ticks.max()) / ticks
        run.joint = robot.joint_names[int(torque_ticks.argmax())]
        run.rmse_rad = math.sqrt(squared / ticks)
    return run


def trials_of(manifest: SkillManifest, runs: int, **changes: Any) -> list[MotionTrial]:
    """Return the runs of a case."""
    found = []
    for seed in range(runs):
        if manifest.kind == "tracking":
            seconds, velocity = manifest.duration_s + 2.0, (0.0, 0.0, 0.0)
        else:
            seconds, velocity = WALK_SECONDS, _velocity(manifest, seed)
        base = MotionTrial(manifest.name, seconds, seed=seed, velocity=velocity)
        found.append(_changed(base, changes))
    return found


def _changed(trial: MotionTrial, changes: dict[str, Any]) -> MotionTrial:
    return replace(trial, **changes)


def _velocity(manifest: SkillManifest, seed: int) -> tuple[float, float, float]:
    """Stand first, then half of what it may be asked for: forwards, sideways, turning."""
    limits = manifest.command
    if limits is None or seed == 0:
        return (0.0, 0.0, 0.0)
    return (
        (0.5 * limits.vx[1], 0.0, 0.0),
        (0.3 * limits.vx[1], 0.0, 0.5 * limits.yaw_rate[1]),
        (0.0, 0.5 * limits.vy[1], 0.0),
    )[(seed - 1) % 3]


def certify_learned(manifest: SkillManifest) -> Verdict:
    """Run all cases of an imported policy; the verdict's limits leave room above what was seen."""
    stand = OnnxSkill(load_manifest(BUNDLED_SKILLS / "stand" / "manifest.toml"))
    name = manifest.name
    library = SkillLibrary({"stand": stand, name: open_skill(manifest)})
    spec = manifest.policy
    motion = None
    if spec is not None and spec.motion is not None:
        motion = Motion(manifest.folder, spec.motion, spec.num_joints)
    cases, every = [], []
    for title, changes, count in CASES:
        trials = trials_of(manifest, count, **changes)
        runs = [watch(library, name, trial, motion) for trial in trials]
        cases.append(_case(title, trials[0].seconds, runs))
        every += runs
    noisy = [_changed(trial, {"noise": HALF_BEYONDMIMIC}) for trial in trials_of(manifest, 3)]
    cases.append(
        _case(
            "half BeyondMimic noise",
            noisy[0].seconds,
            [watch(library, name, t, motion) for t in noisy],
        )
    )
    passed = not any(case.falls for case in cases[: len(CASES)])
    pushes = tuple(largest_push(library, manifest, direction) for direction in DIRECTIONS_RAD)
    jumps = [jump for run in every for jump in run.jumps_rad]
    certificate = Certificate(
        METHOD,
        versions(),
        passed,
        pushes,
        tuple(cases),
        round(float(np.percentile(jumps, 99)), 4) if jumps else 0.0,
    )
    return Verdict(certificate, (0.0, 0.0), limits_from([r for r in every if not r.fell]))


def _case(title: str, seconds: float, runs: Sequence[Run]) -> CertificateCase:
    worst = max(runs, key=lambda run: run.saturated)
    return CertificateCase(
        name=title,
        seconds=round(seconds, 2),
        runs=len(runs),
        falls=sum(run.fell for run in runs),
        survived_s=min(run.survived_s for run in runs),
        rmse_rad=round(max(run.rmse_rad for run in runs), 4),
        drift_m=round(max(run.drift_m for run in runs), 3),
        note=(
            f"tilt {max(run.tilt_rad for run in runs):.2f} rad, {worst.joint or 'no joint'} at its "
            f"torque limit in {100 * worst.saturated:.1f} % of ticks, joint speed "
            f"{100 * max(run.speed_ratio for run in runs):.0f} % of its limit"
        ),
    )


def limits_from(runs: Sequence[Run]) -> SkillLimits:
    """Return what safety should allow: what was seen, and some room."""
    if not runs:
        return SkillLimits()
    tilt = max(run.tilt_rad for run in runs)
    speed = max(run.speed_ratio for run in runs)
    return SkillLimits(
        tilt_rad=round(max(0.8, tilt + TILT_ROOM_RAD), 2),
        joint_speed_ratio=round(max(1.2, 1.2 * speed), 2),
        fall_tilt_ahead_rad=round(max(0.6, tilt + TILT_ROOM_RAD), 2),
    )


def largest_push(library: SkillLibrary, manifest: SkillManifest, direction_rad: float) -> float:
    """Return the largest impulse [N s] on the torso that is survived at every tested phase."""
    survived = 0.0
    for impulse in PUSHES_N_S:
        for index in range(PUSH_PHASES):
            start_s = 2.0 + index * max(0.5, (min(manifest.duration_s, 12.0) - 4.0) / PUSH_PHASES)
            push = Push(impulse, direction_rad, start_s)
            trial = MotionTrial(manifest.name, start_s + 4.0, seed=index, push=push)
            if _falls(library, trial):
                return survived
        survived = impulse
    return survived


def _falls(library: SkillLibrary, trial: MotionTrial) -> bool:
    return any(
        sample.qpos[2] < FALLEN_M or sample.status.mode in (1, 7)
        for sample in play(library, trial)
        if sample.time_s > 0.0
    )
