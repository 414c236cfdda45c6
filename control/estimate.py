"""Where the robot is and how it moves, from its legs and its IMU: no ground truth, no force sensor.

A foot that rests on the floor does not move, so the joints and the gyro tell how the base does; the
accelerometer bridges their noise. A foot is taken to rest when it is low and when what it tells
agrees with what is known. The velocity that is filtered is that of the IMU, not of the base: it is
what the accelerometer integrates to, without a derivative of the gyro.

Frames: base (pelvis); world as the IMU has it, z up, x and y from where the estimator was reset,
z from the soles. Plain floats, no clock, no randomness.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from downbeat.catalog.robot import load_g1
from downbeat.control.errors import ControlError
from downbeat.control.kinematics import centre_of_mass_motion, feet
from downbeat.control.soles import Sole, SoleLimits, rest_confidence, see_sole
from downbeat.control.support import (
    GRAVITY_M_S2,
    Point,
    capture_point,
    convex_hull,
    signed_distance,
)
from downbeat.control.vectors import Vec3, cross, minus, plus, rotation_of, towards, turn, turn_back

Floats = Sequence[float] | NDArray[Any]

IMU_POS: Vec3 = load_g1().site("imu_in_pelvis").pos
LEAST_CONFIDENCE = 0.2
"""Below this in sum the lower foot is believed that much, however it moves: something must be."""
LARGEST_INPUT = 1000.0
"""No sensor of the robot reaches this in its unit; what does is broken."""
UNKNOWN: Vec3 = (math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class EstimatorConfig:
    """Settings of the filter; gains are shares per tick of 20 ms.

    Attributes:
        tick_s: Period of `update`.
        velocity_gain: Of the legs' velocity against the integrated accelerometer.
        height_gain: Of the legs' height against the integrated velocity.
        position_gain: Of resting feet against the integrated velocity.
        anchor_gain: With which the place of a resting foot follows.
        support_height_m: Corners lower than this above the floor are part of the support.
        support_confidence: A foot supports from here on.
        soles: When a sole rests.
    """

    tick_s: float = 0.02
    velocity_gain: float = 0.15
    height_gain: float = 0.3
    position_gain: float = 0.1
    anchor_gain: float = 0.05
    support_height_m: float = 0.02
    support_confidence: float = 0.4
    soles: SoleLimits = field(default_factory=SoleLimits)


@dataclass(frozen=True, slots=True)
class Estimate:
    """What is known after a tick; NaN where the inputs were not usable.

    Attributes:
        base_lin_vel: (3,) [m/s] base frame.
        base_pos: (3,) [m] world; x and y drift, z is above the soles.
        stance_confidence: Of the left and the right foot, 0 in the air, 1 at rest on the floor.
        com: (3,) [m] centre of mass, world, as `base_pos`.
        com_vel: (3,) [m/s] world.
        capture_point: (2,) [m] where a foot would have to stand to stop the motion, world.
        support_margin: [m] of the capture point inside the hull of the resting soles.
        step_margin: [m] of the capture point inside the hull of both soles, lifted ones included:
            who steps on purpose leaves the first hull with every step, but not this one.
    """

    base_lin_vel: Vec3
    base_pos: Vec3
    stance_confidence: tuple[float, float]
    com: Vec3
    com_vel: Vec3
    capture_point: Point
    support_margin: float
    step_margin: float

    @property
    def base_height(self) -> float:
        """Of the pelvis above the soles [m]."""
        return self.base_pos[2]


NO_ESTIMATE = Estimate(
    UNKNOWN, UNKNOWN, (0.0, 0.0), UNKNOWN, UNKNOWN, (math.nan, math.nan), math.nan, math.nan
)


@dataclass(slots=True)
class EstimatorState:
    """Everything an estimator remembers, world frame.

    Attributes:
        is_started: Whether a measurement was taken.
        imu_vel: (3,) [m/s] of the pelvis IMU.
        imu_accel: (3,) [m/s^2] of the pelvis IMU at the last tick, without gravity.
        base_pos: (3,) [m].
        anchors: Where the left and the right foot rest, x, y, x, y [m].
        confidence: That the left and the right foot rest, at the last tick.
    """

    is_started: bool = False
    imu_vel: Vec3 = (0.0, 0.0, 0.0)
    imu_accel: Vec3 = (0.0, 0.0, 0.0)
    base_pos: Vec3 = (0.0, 0.0, 0.0)
    anchors: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    confidence: tuple[float, float] = (0.0, 0.0)


class StateEstimator:
    """Leg odometry and IMU, one `update` per tick."""

    def __init__(self, config: EstimatorConfig | None = None) -> None:
        self.config = config or EstimatorConfig()
        self.state = EstimatorState()

    def reset(self) -> None:
        """Forget everything: at rest, at the origin."""
        self.state = EstimatorState()

    def update(
        self,
        base_quat_wxyz: Floats,
        gyro: Floats,
        accel: Floats,
        joint_pos: Floats,
        joint_vel: Floats,
    ) -> Estimate:
        """Take one measurement; if it is not usable the state stays and NO_ESTIMATE returns.

        Args:
            base_quat_wxyz: (4,) world <- base.
            gyro: (3,) [rad/s] base frame.
            accel: (3,) [m/s^2] specific force of the pelvis IMU, base frame.
            joint_pos: (29,) [rad] motor order.
            joint_vel: (29,) [rad/s].
        """
        quat, rates, force = _floats(base_quat_wxyz), _floats(gyro), _floats(accel)
        pos, vel = _floats(joint_pos), _floats(joint_vel)
        if not _are_usable(quat, rates, force, pos, vel):
            return NO_ESTIMATE
        rotation = rotation_of(quat)
        turn_rate = turn(rotation, (rates[0], rates[1], rates[2]))  # (3,) world
        imu_arm = turn(rotation, IMU_POS)  # (3,) world
        limits = self.config.soles
        left, right = (
            see_sole(limits, motion, rotation, turn_rate, imu_arm) for motion in feet(pos, vel)
        )
        predicted = self._integrate(turn(rotation, (force[0], force[1], force[2])))
        self._correct(left, right, predicted)
        base_vel = minus(self.state.imu_vel, cross(turn_rate, imu_arm))  # (3,) world
        self._move(left, right, base_vel)
        com_b, com_rate_b = centre_of_mass_motion(pos, vel)
        com_arm = turn(rotation, com_b)
        com_rate = plus(cross(turn_rate, com_arm), turn(rotation, com_rate_b))
        com, com_vel = plus(self.state.base_pos, com_arm), plus(base_vel, com_rate)
        capture = capture_point(com, com_vel)
        support_margin, step_margin = self._margins(capture, left, right)
        return Estimate(
            base_lin_vel=turn_back(rotation, base_vel),
            base_pos=self.state.base_pos,
            stance_confidence=self.state.confidence,
            com=com,
            com_vel=com_vel,
            capture_point=capture,
            support_margin=support_margin,
            step_margin=step_margin,
        )

    def _integrate(self, force: Vec3) -> Vec3:
        """Return the IMU's velocity one tick on, by its specific force alone."""
        state = self.state
        accel = (force[0], force[1], force[2] - GRAVITY_M_S2)
        if not state.is_started:
            state.imu_accel = accel
        mean = towards(state.imu_accel, accel, 0.5)
        state.imu_accel = accel
        tick = self.config.tick_s
        return plus(state.imu_vel, (tick * mean[0], tick * mean[1], tick * mean[2]))

    def _correct(self, left: Sole, right: Sole, predicted: Vec3) -> None:
        """Let the resting feet correct the velocity."""
        config, state = self.config, self.state
        lower = left if left.height <= right.height else right
        known = predicted if state.is_started else lower.imu_vel
        a = rest_confidence(config.soles, left, lower.height, known)
        b = rest_confidence(config.soles, right, lower.height, known)
        state.confidence = (a, b)
        if a + b < LEAST_CONFIDENCE:
            a, b = (LEAST_CONFIDENCE, 0.0) if lower is left else (0.0, LEAST_CONFIDENCE)
        told = towards(left.imu_vel, right.imu_vel, b / (a + b))
        state.imu_vel = towards(known, told, config.velocity_gain * min(1.0, a + b))

    def _move(self, left: Sole, right: Sole, base_vel: Vec3) -> None:
        """Move the base by its velocity; let the resting feet correct height and place."""
        config, state = self.config, self.state
        tick = config.tick_s
        x, y, z = state.base_pos
        height = -min(left.height, right.height)
        if state.is_started:
            x, y = x + tick * base_vel[0], y + tick * base_vel[1]
            z += tick * base_vel[2]
            z += config.height_gain * (height - z)
        else:
            z = height
        total = max(1.0, sum(state.confidence))
        anchors: list[float] = []
        shift_x = shift_y = 0.0
        places = (state.anchors[:2], state.anchors[2:])
        for sole, sure, (ax, ay) in zip((left, right), state.confidence, places):
            here_x, here_y = x + sole.pos[0], y + sole.pos[1]
            if sure < config.support_confidence or not state.is_started:
                anchors += (here_x, here_y)
                continue
            off_x, off_y = ax - here_x, ay - here_y
            shift_x += config.position_gain * sure / total * off_x
            shift_y += config.position_gain * sure / total * off_y
            anchors += (ax - config.anchor_gain * off_x, ay - config.anchor_gain * off_y)
        state.base_pos = (x + shift_x, y + shift_y, z)
        state.anchors = (anchors[0], anchors[1], anchors[2], anchors[3])
        state.is_started = True

    def _margins(self, capture: Point, left: Sole, right: Sole) -> tuple[float, float]:
        """Return how far a point is inside what carries, and inside both soles as they are."""
        config, state = self.config, self.state
        limit = config.support_height_m - state.base_pos[2]
        lower = left if left.height <= right.height else right
        standing: list[Point] = []
        everything: list[Point] = []
        places = (state.anchors[:2], state.anchors[2:])
        for sole, sure, (ax, ay) in zip((left, right), state.confidence, places):
            carries = sure >= config.support_confidence or sole is lower
            off_x, off_y = ax - sole.pos[0], ay - sole.pos[1]
            for x, y, z in sole.corners:
                corner = (x + off_x, y + off_y)
                everything.append(corner)
                if carries and z < limit:
                    standing.append(corner)
        step_margin = signed_distance(capture, convex_hull(everything))
        if len(standing) == len(everything):
            return step_margin, step_margin
        return signed_distance(capture, convex_hull(standing)), step_margin

    def to_state(self) -> dict[str, Any]:
        """Return what is remembered, field by field: bool and lists of float."""
        values = asdict(self.state)
        return {k: list(v) if isinstance(v, tuple) else v for k, v in values.items()}

    def from_state(self, values: dict[str, Any]) -> None:
        """Restore what `to_state` returned, bit for bit.

        Raises:
            ControlError: A field is missing, unknown or of another length.
        """
        shape = {k: np.shape(v) for k, v in asdict(EstimatorState()).items()}
        if shape != {k: np.shape(v) for k, v in values.items()}:
            raise ControlError(
                f"The estimator's state cannot be restored from {', '.join(values)}; it has"
                f" {', '.join(f'{k} {n}' for k, n in shape.items())}."
            )
        fields: dict[str, Any] = {
            k: tuple(v) if isinstance(v, list) else v for k, v in values.items()
        }
        self.state = EstimatorState(**fields)


def _floats(values: Floats) -> Sequence[float]:
    if isinstance(values, np.ndarray):
        numbers: list[float] = values.tolist()
        return numbers
    return values


def _are_usable(quat: Sequence[float], *others: Sequence[float]) -> bool:
    """Return whether all is finite and possible, and the quaternion a rotation."""
    if not 0.5 < sum([v * v for v in quat]) < 2.0:
        return False
    # A sum of squares is NaN or inf if any number is.
    limit = LARGEST_INPUT * LARGEST_INPUT
    return all(sum([v * v for v in values]) < limit for values in others)
