"""The certificate of a walk: driven like a joystick drives it, through control's own slew."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from downbeat.control.player import Velocity
from downbeat.control.policy import F32
from downbeat.control.transitions import WALK_BLEND_TICKS
from downbeat.policies.manifest import Certificate, CertificateCase, CommandLimits
from downbeat.sim.certify import (
    PUSH_DIRECTIONS,
    STAND_TICKS,
    largest_push,
)
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
from downbeat.sim.verdict import Verdict, versions

F64 = NDArray[np.float64]
SPEED_M_S = 0.2
DISTANCE_M = 4.0
TURN_RATE_RAD_S = 0.3
JOYSTICK_S = 60.0
STOP_LIMIT_S = 5.0
SETTLE_TICKS = 2 * TICKS_PER_S
METHOD = (
    "Start from the stand, command programs through control's slew and heading hold, stop and "
    "stand, in MuJoCo through ONNX Runtime with hardware-like noise unless stated"
)
MODELS = (NOMINAL, HEAVY, LIGHT)


@dataclass(frozen=True, slots=True)
class Drive:
    """One drive: did it stay up, and where did it end."""

    survived_s: float
    fell: bool
    rmse_rad: float
    x_m: float
    y_m: float
    yaw_rad: float
    stop_s: float


class Driver:
    """Turns wanted velocities into the command of every tick."""

    def __init__(self, limits: CommandLimits) -> None:
        self.velocity = Velocity(
            wanted=np.zeros(3, np.float32),
            current=np.zeros(3, np.float32),
            slew=np.array([limits.slew_linear, limits.slew_linear, limits.slew_yaw], np.float32),
            low=np.array([limits.vx[0], limits.vy[0], limits.yaw_rate[0]], np.float32),
            high=np.array([limits.vx[1], limits.vy[1], limits.yaw_rate[1]], np.float32),
            heading_gain=limits.heading_gain,
            heading_filter_s=limits.heading_filter_s,
        )

    def steer(self, heading: float) -> F32:
        """Return the command of this tick."""
        return np.asarray(self.velocity.update(heading), np.float32)

    def want(self, vx: float, yaw_rate: float) -> None:
        """Ask for a velocity."""
        self.velocity.wanted = np.array([vx, 0.0, yaw_rate], np.float32)


Program = Callable[[Driver, Stage], None]
"""Drives from the start of the walk to the wish to stop."""


def straight(driver: Driver, stage: Stage) -> None:
    """Walk 4 m ahead."""
    driver.want(SPEED_M_S, 0.0)
    stage.run(round(DISTANCE_M / SPEED_M_S * TICKS_PER_S))


def turn(direction: float) -> Program:
    """Return a program that turns by 90 degrees on the spot."""

    def program(driver: Driver, stage: Stage) -> None:
        driver.want(0.0, direction * TURN_RATE_RAD_S)
        stage.run(round(np.pi / 2.0 / TURN_RATE_RAD_S * TICKS_PER_S))

    return program


def joystick(seed: int, limits: CommandLimits) -> Program:
    """Return a program of random wishes within the limits, a new one every 2 to 5 s."""

    def program(driver: Driver, stage: Stage) -> None:
        rng = np.random.default_rng(1000 + seed)
        left = round(JOYSTICK_S * TICKS_PER_S)
        while left > 0 and not stage.is_fallen:
            still = rng.random() < 0.2
            wish = (rng.uniform(*limits.vx), rng.uniform(*limits.yaw_rate))
            driver.want(*((0.0, 0.0) if still else wish))
            ticks = min(left, int(rng.integers(100, 250)))
            stage.run(ticks)
            left -= ticks

    return program


def drive(
    skill: StageSkill, stand: StageSkill, variation: Variation, seed: int, program: Program
) -> Drive:
    """Stand, walk a program, stop at the gait's boundary, stand."""
    limits = skill.manifest.command
    if limits is None:
        raise ValueError(f"Skill '{skill.manifest.name}' takes no command.")
    stage = Stage(stand, variation, seed)
    stage.run(STAND_TICKS)
    driver = Driver(limits)
    half = WALK_BLEND_TICKS // 2
    stage.switch(Act(skill, 0.0, 1.0, driver.steer), WALK_BLEND_TICKS, hold_ticks=half)
    program(driver, stage)
    driver.want(0.0, 0.0)
    asked = stage.trace.ticks
    while not stage.is_fallen and not _may_stop(stage, driver):
        stage.run(1)
        if (stage.trace.ticks - asked) * TICK_S > STOP_LIMIT_S:
            break
    stop_s = (stage.trace.ticks - asked) * TICK_S
    rmse = stage.trace.rmse_rad
    stage.switch(Act(stand, 0.0), WALK_BLEND_TICKS)
    stage.run(SETTLE_TICKS)
    x, y = stage.data.qpos[:2]
    yaw = stage.heading()
    return Drive(stage.trace.ticks * TICK_S, stage.is_fallen, rmse, x, y, yaw, stop_s)


def _may_stop(stage: Stage, driver: Driver) -> bool:
    return driver.velocity.is_still and stage.act.phase_s < TICK_S / 2


def case(
    name: str,
    skill: StageSkill,
    stand: StageSkill,
    runs: Iterable[tuple[Variation, Program]],
    note: Callable[[list[Drive]], str],
) -> CertificateCase:
    """Drive a case's runs and sum them up."""
    drives = [
        drive(skill, stand, variation, seed, program)
        for seed, (variation, program) in enumerate(runs)
    ]
    upright = [d for d in drives if not d.fell]
    return CertificateCase(
        name=name,
        seconds=round(max(d.survived_s for d in drives), 1),
        runs=len(drives),
        falls=sum(d.fell for d in drives),
        survived_s=round(min(d.survived_s for d in drives), 2),
        rmse_rad=round(max(d.rmse_rad for d in drives), 4),
        drift_m=round(max((abs(d.y_m) for d in upright), default=0.0), 3),
        note=note(upright) if upright else "",
    )


def _straight_note(drives: list[Drive]) -> str:
    ends = [d.x_m for d in drives]
    yaw = max(abs(np.degrees(d.yaw_rad)) for d in drives)
    return f"ends at x {min(ends):.2f} to {max(ends):.2f} m, heading within {yaw:.1f} deg"


def _turn_note(direction: float) -> Callable[[list[Drive]], str]:
    def note(drives: list[Drive]) -> str:
        errors = [abs(np.degrees(d.yaw_rad) - 90.0 * direction) for d in drives]
        return f"heading within {max(errors):.1f} deg"

    return note


def _stop_note(drives: list[Drive]) -> str:
    return f"stands within {max(d.stop_s for d in drives):.2f} s of the wish"


def certify_walk(skill: StageSkill, stand: StageSkill) -> Verdict:
    """Run all cases of a walk."""
    limits = skill.manifest.command
    if limits is None:
        raise ValueError(f"Skill '{skill.manifest.name}' takes no command.")

    def joysticks(variations: Iterable[Variation]) -> list[tuple[Variation, Program]]:
        return [(v, joystick(seed, limits)) for seed, v in enumerate(variations)]

    cases = (
        case("straight 4 m", skill, stand, [(v, straight) for v in MODELS * 4], _straight_note),
        case("straight 4 m, 20 ms delay", skill, stand, [(LATE, straight)] * 4, _straight_note),
        case("straight 4 m, physics 2 ms", skill, stand, [(FINE, straight)] * 3, _straight_note),
        case("turn +90 deg", skill, stand, [(v, turn(1.0)) for v in MODELS * 2], _turn_note(1.0)),
        case("turn -90 deg", skill, stand, [(v, turn(-1.0)) for v in MODELS * 2], _turn_note(-1.0)),
        case("joystick 60 s", skill, stand, joysticks(MODELS * 4), _stop_note),
        case("joystick 60 s, 20 ms delay", skill, stand, joysticks([LATE] * 6), _stop_note),
        case(
            "joystick 60 s, half BeyondMimic noise",
            skill,
            stand,
            joysticks([NOISY] * 6),
            _stop_note,
        ),
        case("joystick 60 s, physics 2 ms", skill, stand, joysticks([FINE] * 3), _stop_note),
    )
    pushes = tuple(largest_push(skill, stand, direction) for direction in PUSH_DIRECTIONS)
    passed = not any(c.falls for c in cases)
    return Verdict(Certificate(METHOD, versions(), passed, pushes, cases), (0.0, 0.0))
