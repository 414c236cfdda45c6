"""From wherever the joints are to the default pose: a ramp of the position targets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from downbeat.catalog.robot import load_g1
from downbeat.control.skill import F32, JointTargets

MOVE_TO_POSE_S = 2.0
POSE_REACHED_RAD = 0.15


@dataclass(slots=True)
class GetUpState:
    """What is remembered.

    Attributes:
        start_pos: (29,) [rad] where the joints were; None: not moving.
        start_utime: [us].
    """

    start_pos: F32 | None = None
    start_utime: int = 0


class GetUp:
    """The ramp; its first target is the measured pose."""

    def __init__(self) -> None:
        robot = load_g1()
        self.state = GetUpState()
        self._pose = np.asarray(robot.default_joint_pos, np.float32)  # (29,)
        self._stiffness = np.asarray(robot.joint_stiffness, np.float32)  # (29,)
        self._damping = np.asarray(robot.joint_damping, np.float32)  # (29,)

    @property
    def is_moving(self) -> bool:
        """Whether the ramp is under way."""
        return self.state.start_pos is not None

    def begin(self, joint_pos: F32, utime: int) -> None:
        """Start from the measured pose (29,) [rad]."""
        self.state = GetUpState(np.array(joint_pos, np.float32), utime)

    def stop(self) -> None:
        """Forget the ramp."""
        self.state = GetUpState()

    def targets(self, utime: int) -> JointTargets | None:
        """Return the targets at `utime` [us], None once the pose is reached."""
        start = self.state.start_pos
        if start is None:
            return None
        distance = float(np.abs(start - self._pose).max())
        duration_s = 0.0 if distance < POSE_REACHED_RAD else MOVE_TO_POSE_S
        elapsed_s = (utime - self.state.start_utime) * 1e-6
        if elapsed_s >= duration_s:
            self.stop()
            return None
        share = np.float32(elapsed_s / duration_s)
        pose = start + share * (self._pose - start)  # (29,)
        return JointTargets(pose, self._stiffness, self._damping)
