"""Sensor noise of the plant: what the robot measures instead of what is true."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from downbeat.catalog.robot import NUM_JOINTS

F64 = NDArray[np.float64]

_IMU_WIDTH = 9
"""Numbers drawn per inertial unit: orientation, gyro, accelerometer."""


@dataclass(frozen=True, slots=True)
class NoiseConfig:
    """Half widths of uniform noise, drawn afresh for every sample.

    The first four are the skills' certificate ("hardware-like", chosen, not measured on a G1); half
    of BeyondMimic's training noise would be .025, .1, .005 and .25.

    Attributes:
        orientation_rad: About each body axis of an inertial unit.
        gyro_rad_s: Per axis.
        joint_pos_rad: Per joint.
        joint_vel_rad_s: Per joint.
        accel_m_s2: Per axis.
    """

    orientation_rad: float = 0.01
    gyro_rad_s: float = 0.05
    joint_pos_rad: float = 0.003
    joint_vel_rad_s: float = 0.15
    accel_m_s2: float = 0.2

    @property
    def is_off(self) -> bool:
        """Whether every width is zero: measurements are then exact."""
        return not any(
            (
                self.orientation_rad,
                self.gyro_rad_s,
                self.joint_pos_rad,
                self.joint_vel_rad_s,
                self.accel_m_s2,
            )
        )


NO_NOISE = NoiseConfig(0.0, 0.0, 0.0, 0.0, 0.0)


class NoiseSource:
    """Seeded noise; one draw per measured state, so that the same steps give the same bits."""

    def __init__(self, config: NoiseConfig, seed: int, num_imus: int) -> None:
        """Prepare.

        Args:
            config: Widths.
            seed: Of the generator.
            num_imus: Inertial units per state.
        """
        self.config = config
        self._rng = np.random.Generator(np.random.PCG64(seed))
        imu = [config.orientation_rad] * 3 + [config.gyro_rad_s] * 3 + [config.accel_m_s2] * 3
        widths = (
            [config.joint_pos_rad] * NUM_JOINTS + [config.joint_vel_rad_s] * NUM_JOINTS
        ) + imu * num_imus
        self._half_width = np.array(widths, dtype=np.float64)  # (58 + 9 num_imus,)
        self._sample = np.zeros_like(self._half_width)

    def draw(self) -> None:
        """Draw the noise of the next state."""
        if self.config.is_off:
            return
        self._rng.random(out=self._sample)
        self._sample *= 2.0
        self._sample -= 1.0
        self._sample *= self._half_width

    @property
    def joint_pos(self) -> F64:
        """(29,) [rad]."""
        return self._sample[:NUM_JOINTS]

    @property
    def joint_vel(self) -> F64:
        """(29,) [rad/s]."""
        return self._sample[NUM_JOINTS : 2 * NUM_JOINTS]

    def imu(self, index: int) -> tuple[F64, F64, F64]:
        """Return rotation vector [rad], gyro [rad/s] and accelerometer [m/s^2] noise, (3,) each."""
        start = 2 * NUM_JOINTS + _IMU_WIDTH * index
        sample = self._sample
        return (
            sample[start : start + 3],
            sample[start + 3 : start + 6],
            sample[start + 6 : start + 9],
        )


def rotate(quat_wxyz: F64, rotation: F64) -> tuple[float, float, float, float]:
    """Return `quat_wxyz` turned by a small rotation vector in its own body frame, unit length.

    Args:
        quat_wxyz: (4,) unit.
        rotation: (3,) [rad]; zeros return the quaternion itself, bit for bit.
    """
    w, x, y, z = quat_wxyz.tolist()
    rx, ry, rz = rotation.tolist()
    angle = math.sqrt(rx * rx + ry * ry + rz * rz)
    if angle == 0.0:
        return w, x, y, z
    scale = math.sin(0.5 * angle) / angle
    c, sx, sy, sz = math.cos(0.5 * angle), rx * scale, ry * scale, rz * scale
    return (
        w * c - x * sx - y * sy - z * sz,
        w * sx + x * c + y * sz - z * sy,
        w * sy - x * sz + y * c + z * sx,
        w * sz + x * sy - y * sx + z * c,
    )


def roll_pitch_yaw(quat_wxyz: tuple[float, float, float, float]) -> tuple[float, float, float]:
    """Return roll, pitch, yaw [rad] of a unit quaternion (rotations about x, then y, then z)."""
    w, x, y, z = quat_wxyz
    sin_pitch = min(1.0, max(-1.0, 2.0 * (w * y - z * x)))
    return (
        math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        math.asin(sin_pitch),
        math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
    )
