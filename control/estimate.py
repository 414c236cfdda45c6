"""Where the robot is and how it moves, from its legs and its IMU: no ground truth, no force sensor.

A foot that rests on the floor does not move, so the joints and the gyro tell how the base does; the
accelerometer bridges the noise. A foot is taken to rest when it is low and when the motion it tells
of agrees with what is known. The velocity that is filtered is that of the IMU, not of the base: it
is what the accelerometer integrates to, without a derivative of the gyro.

Frames: b base (pelvis), w world as the IMU has it (z up, its own heading), x and y from where the
estimator was reset, z above the sole. Plain floats, no clock, no randomness.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from downbeat.catalog.robot import load_g1
from downbeat.control.kinematics import (
    SOLE_CORNERS,
    FootMotion,
    Vec3,
    centre_of_mass_motion,
    feet,
)
from downbeat.control.support import Point, convex_hull, signed_distance

GRAVITY_M_S2 = 9.81
IMU_POS: Vec3 = load_g1().site("imu_in_pelvis").pos
UNKNOWN: Vec3 = (math.nan, math.nan, math.nan)
_ZERO: Vec3 = (0.0, 0.0, 0.0)
_CORNERS: tuple[Point, ...] = tuple((c[0], c[1]) for c in SOLE_CORNERS)


@dataclass(frozen=True, slots=True)
class EstimatorConfig:
    """Settings of the filter; gains are shares per tick of 20 ms.

    Attributes:
        tick_s: Period of `update`.
        velocity_gain: Of the legs' velocity against the integrated accelerometer.
        height_gain: Of the legs' height against the integrated velocity.
        position_gain: Of resting feet against the integrated velocity.
        anchor_gain: With which the place of a resting foot follows.
        corner_depth_m: Corners of a sole this much above its lowest one carry nothing.
        rest_height_m: A foot this much above the lower one may rest.
        lift_height_m: A foot this much above the lower one does not.
        rest_speed_m_s: A foot this fast may rest.
        slip_speed_m_s: A foot this fast does not.
        support_height_m: Corners lower than this above the floor are part of the support.
        support_confidence: A foot supports from here on.
    """

    tick_s: float = 0.02
    velocity_gain: float = 0.12
    height_gain: float = 0.2
    position_gain: float = 0.1
    anchor_gain: float = 0.05
    corner_depth_m: float = 0.01
    rest_height_m: float = 0.008
    lift_height_m: float = 0.025
    rest_speed_m_s: float = 0.25
    slip_speed_m_s: float = 0.6
    support_height_m: float = 0.02
    support_confidence: float = 0.4


@dataclass(frozen=True, slots=True)
class Estimate:
    """What is known after a tick; NaN where an input was not finite.

    Attributes:
        base_lin_vel: (3,) [m/s] base frame.
        base_pos: (3,) [m] world; x and y drift, z is above the soles.
        stance_confidence: Of the left and the right foot, 0 in the air, 1 at rest on the floor.
        com: (3,) [m] centre of mass, world, as `base_pos`.
        com_vel: (3,) [m/s] world.
        capture_point: (2,) [m] where a foot would have to stand to stop the fall, world.
        support_margin: [m] of the capture point inside the hull of the resting soles.
    """

    base_lin_vel: Vec3
    base_pos: Vec3
    stance_confidence: tuple[float, float]
    com: Vec3
    com_vel: Vec3
    capture_point: Point
    support_margin: float

    @property
    def base_height(self) -> float:
        """Of the pelvis above the soles [m]."""
        return self.base_pos[2]


NO_ESTIMATE = Estimate(UNKNOWN, UNKNOWN, (0.0, 0.0), UNKNOWN, UNKNOWN, (math.nan,) * 2, math.nan)
"""What is known when an input is not finite."""


@dataclass(slots=True)
class EstimatorState:
    """Everything an estimator remembers.

    Attributes:
        is_started: Whether an update has been made.
        imu_vel: (3,) [m/s] of the pelvis IMU, world.
        imu_accel: (3,) [m/s^2] at the last tick, without gravity, world.
        base_pos: (3,) [m] world.
        anchors: Where the left and the right foot rest, x and y [m] each, world.
        confidence: Of the left and the right foot at the last tick.
    """

    is_started: bool = False
    imu_vel: Vec3 = _ZERO
    imu_accel: Vec3 = _ZERO
    base_pos: Vec3 = _ZERO
    anchors: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    confidence: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class _Foot:
    """A sole seen from the base, axes of the world.

    Attributes:
        pos: (3,) [m] of its centre.
        corners: x, y, z [m] of its corners.
        height: [m] of the corners that carry.
        imu_vel: (3,) [m/s] the IMU's velocity if this foot rests.
    """

    pos: Vec3
    corners: tuple[Vec3, ...]
    height: float
    imu_vel: Vec3


class StateEstimator:
    """Leg odometry and IMU, one `update` per tick."""

    def __init__(self, config: EstimatorConfig | None = None) -> None:
        self.config = config or EstimatorConfig()
        self.state = EstimatorState()

    def reset(self) -> None:
        """Forget everything: at rest, at the origin."""
        self.state = EstimatorState()

    def to_state(self) -> dict[str, Any]:
        """Return what is remembered: bool, float and lists of float, ready for JSON."""
        return {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(self.state).items()}

    def from_state(self, values: dict[str, Any]) -> None:
        """Restore what `to_state` returned, bit for bit.

        Raises:
            ControlError: A field is missing, unknown, or has another length.
        """
        self.state = _state_from(values)

    def update(
        self,
        base_quat_wxyz: Sequence[float],
        gyro: Sequence[float],
        accel: Sequence[float],
        joint_pos: Sequence[float],
        joint_vel: Sequence[float],
    ) -> Estimate:
        """Take one measurement; the state stays as it was if it is not usable.

        Args:
            base_quat_wxyz: (4,) world <- base.
            gyro: (3,) [rad/s] base frame.
            accel: (3,) [m/s^2] specific force of the pelvis IMU, base frame.
            joint_pos: (29,) [rad] motor order.
            joint_vel: (29,) [rad/s].
        """
        if not _is_usable(base_quat_wxyz, gyro, accel, joint_pos, joint_vel):
            return NO_ESTIMATE
        rotation = _rotation(base_quat_wxyz)
        turn_rate = _turn(rotation, (gyro[0], gyro[1], gyro[2]))  # (3,) world
        imu_arm = _turn(rotation, IMU_POS)  # (3,) world
        soles = [
            _foot(self.config, motion, rotation, turn_rate, imu_arm)
            for motion in feet(joint_pos, joint_vel)
        ]
        predicted = self._predict(_turn(rotation, (accel[0], accel[1], accel[2])))
        self._correct(soles, predicted)
        state = self.state
        imu_spin = _cross(turn_rate, imu_arm)
        base_vel = _minus(state.imu_vel, imu_spin)  # (3,) world
        com_b, com_rate_b = centre_of_mass_motion(joint_pos, joint_vel)
        com_arm = _turn(rotation, com_b)
        com = _plus(state.base_pos, com_arm)
        com_vel = _plus(base_vel, _plus(_cross(turn_rate, com_arm), _turn(rotation, com_rate_b)))
        capture = capture_point(com, com_vel)
        return Estimate(
            base_lin_vel=_turn_back(rotation, base_vel),
            base_pos=state.base_pos,
            stance_confidence=state.confidence,
            com=com,
            com_vel=com_vel,
            capture_point=capture,
            support_margin=signed_distance(capture, self._support(soles)),
        )

    def _predict(self, specific_force: Vec3) -> Vec3:
        """Integrate the accelerometer over one tick; return the IMU's velocity, world."""
        state = self.state
        x, y, z = specific_force
        accel = (x, y, z - GRAVITY_M_S2)
        if not state.is_started:
            state.imu_accel = accel
        half = 0.5 * self.config.tick_s
        before, vel = state.imu_accel, state.imu_vel
        state.imu_accel = accel
        return (
            vel[0] + half * (before[0] + accel[0]),
            vel[1] + half * (before[1] + accel[1]),
            vel[2] + half * (before[2] + accel[2]),
        )

    def _correct(self, soles: Sequence[_Foot], predicted: Vec3) -> None:
        """Let the resting feet correct velocity, height and place."""
        config, state = self.config, self.state
        left, right = soles
        lower = left if left.height <= right.height else right
        known = predicted if state.is_started else lower.imu_vel
        confidence = tuple(_confidence(config, sole, lower.height, known) for sole in soles)
        weights = list(confidence)
        if sum(weights) < LEAST_CONFIDENCE:
            weights = [LEAST_CONFIDENCE if sole is lower else 0.0 for sole in soles]
        total = weights[0] + weights[1]
        a, b = weights[0] / total, weights[1] / total
        told = tuple(a * u + b * v for u, v in zip(left.imu_vel, right.imu_vel))
        gain = config.velocity_gain * min(1.0, total) if state.is_started else 1.0
        vel = tuple(u + gain * (v - u) for u, v in zip(known, told))
        state.imu_vel = (vel[0], vel[1], vel[2])
        self._move(soles, confidence, -(a * left.height + b * right.height))
        state.confidence = (confidence[0], confidence[1])
        state.is_started = True
