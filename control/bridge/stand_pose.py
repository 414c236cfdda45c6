"""The pose that the bridge moves to before it hands over, and gains that hold the robot in it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from downbeat.catalog.robot import load_g1

F32 = npt.NDArray[np.float32]

_LEG = ((350.0, 5.0), (200.0, 5.0), (200.0, 5.0), (300.0, 10.0), (300.0, 5.0), (150.0, 5.0))
_WAIST = (200.0, 5.0)
_ARM = (40.0, 3.0)
_GAINS = np.array([*_LEG, *_LEG, *[_WAIST] * 3, *[_ARM] * 14], np.float32)  # (29, 2)
"""(kp, kd): the standby gains of motion_tracking_controller. The gains of our skills do not hold a
pose: 57 N m/rad in the ankles against m g h = 225, and the knees give way by 2 cm (measured)."""
MAX_TILT_RAD = 0.5
"""A robot that leans further is lying or falling, and is not moved to a standing pose."""


class PoseRamp:
    """From where the joints are to the stand pose; its first target is the measured pose."""

    def __init__(self, duration_s: float) -> None:
        self._duration_s = duration_s
        self._pose = np.asarray(load_g1().default_joint_pos, np.float32)  # (29,)
        self._start = self._pose.copy()
        self._utime = 0
        self.stiffness: F32 = _GAINS[:, 0].copy()
        self.damping: F32 = _GAINS[:, 1].copy()

    def begin(self, measured: F32, utime: int) -> None:
        """Start from the measured pose (29,) [rad]."""
        self._start[:] = measured
        self._utime = utime

    def _share(self, utime: int) -> float:
        return min(1.0, (utime - self._utime) * 1e-6 / self._duration_s)

    def is_over(self, utime: int) -> bool:
        """Whether the pose is commanded."""
        return self._share(utime) >= 1.0

    def target(self, utime: int) -> F32:
        """Return the targets at `utime` [us], (29,) [rad]: no jerk at either end."""
        share = self._share(utime)
        smooth = np.float32(share * share * (3.0 - 2.0 * share))
        return np.asarray(self._start + smooth * (self._pose - self._start))


def tilt_of(quat_wxyz: npt.NDArray[np.float32]) -> float:
    """Return the angle between the body's and the world's vertical [rad]."""
    _w, x, y, _z = quat_wxyz.tolist()
    return float(np.arccos(max(-1.0, min(1.0, 1.0 - 2.0 * (x * x + y * y)))))
