"""Reference motions of tracking policies: load, interpolate, align to the robot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from downbeat.control.errors import ControlError
from downbeat.control.observation import Reference, RobotState, torso_pos, torso_quat, yaw
from downbeat.control.rotations import quat_mul, quat_rotate, yaw_quat
from downbeat.policies.spec import MotionSpec

F32 = npt.NDArray[np.float32]

MAX_BYTES = 200_000_000
ANCHOR_BODIES = ("torso_link", "pelvis")


@dataclass(frozen=True, slots=True)
class Frame:
    """The motion at one instant, in its own world; arrays as in `Reference`."""

    joint_pos: F32
    joint_vel: F32
    anchor_pos: F32
    anchor_quat_wxyz: F32


class Motion:
    """A motion table with continuous time."""

    def __init__(self, folder: Path, spec: MotionSpec, num_joints: int) -> None:
        """Load the table.

        Raises:
            ControlError: The file is not a motion of that size.
        """
        path = folder / spec.file
        self.spec = spec
        if spec.anchor_body not in ANCHOR_BODIES:
            raise ControlError(
                f"Anchor body '{spec.anchor_body}' cannot be tracked; bodies are "
                f"{' and '.join(ANCHOR_BODIES)} ({path})."
            )
        widths = {
            "joint_pos": num_joints,
            "joint_vel": num_joints,
            "anchor_pos": 3,
            "anchor_quat": 4,
        }
        try:
            if path.stat().st_size > MAX_BYTES:
                raise ControlError(f"Motion {path} is larger than {MAX_BYTES // 10**6} MB.")
            with np.load(path, allow_pickle=False) as file:
                tables = {name: np.ascontiguousarray(file[name], np.float32) for name in widths}
        except (OSError, KeyError, ValueError) as error:
            raise ControlError(f"Motion {path} cannot be read: {error}.") from error
        for name, width in widths.items():
            if tables[name].shape != (spec.rows, width) or not np.isfinite(tables[name]).all():
                raise ControlError(
                    f"Motion {path}: {name} is {tables[name].shape} or not finite; "
                    f"({spec.rows}, {width}) finite numbers are expected."
                )
        self._joint_pos = tables["joint_pos"]  # (T, n)
        self._joint_vel = tables["joint_vel"]  # (T, n)
        self._anchor_pos = tables["anchor_pos"]  # (T, 3)
        self._anchor_quat = tables["anchor_quat"]  # (T, 4)

    @property
    def tables(self) -> tuple[F32, F32, F32, F32]:
        """joint_pos (T, n), joint_vel (T, n), anchor_pos (T, 3), anchor_quat (T, 4)."""
        return self._joint_pos, self._joint_vel, self._anchor_pos, self._anchor_quat

    @property
    def duration_s(self) -> float:
        """Length [s]."""
        return self.spec.rows / self.spec.rate_hz

    def row(self, phase_s: float) -> float:
        """Return the fractional row at a time, held at both ends."""
        return min(max(phase_s * self.spec.rate_hz, 0.0), self.spec.rows - 1.0)

    def frame(self, phase_s: float) -> Frame:
        """Interpolate the motion at skill time `phase_s`."""
        row = self.row(phase_s)
        low = min(int(row + 1e-6), self.spec.rows - 1)
        share = row - low
        if share < 1e-6 or low + 1 >= self.spec.rows:
            return Frame(
                self._joint_pos[low],
                self._joint_vel[low],
                self._anchor_pos[low],
                self._anchor_quat[low],
            )
        b = np.float32(share)
        a = np.float32(1.0) - b
        high = low + 1
        first, second = self._anchor_quat[low], self._anchor_quat[high]
        sign = np.float32(1.0 if (first * second).sum() >= 0.0 else -1.0)
        quat = a * first + (sign * b) * second
        return Frame(
            a * self._joint_pos[low] + b * self._joint_pos[high],
            a * self._joint_vel[low] + b * self._joint_vel[high],
            a * self._anchor_pos[low] + b * self._anchor_pos[high],
            quat / np.sqrt((quat * quat).sum()),
        )


@dataclass(slots=True)
class Alignment:
    """Where a motion's world lies in the robot's: set once, at entry, at the entry frame.

    Attributes:
        yaw: [rad] about the vertical.
        shift: (3,) [m]; heights too, because published references are off by up to 0.13 m.
    """

    yaw: float
    shift: F32

    @classmethod
    def at_entry(cls, state: RobotState, frame: Frame, anchor_body: str) -> Alignment:
        """Put the motion's anchor where the robot's anchor is, heading where it heads."""
        turn = float(yaw(anchor_quat(state, anchor_body))) - float(yaw(frame.anchor_quat_wxyz))
        rotated = quat_rotate(yaw_quat(np.float32(turn)), frame.anchor_pos)
        here = anchor_pos(state, anchor_body)
        return cls(turn, np.asarray(here - rotated, np.float32))

    def apply(self, frame: Frame) -> Reference:
        """Return a frame as the robot's world sees it."""
        turn = yaw_quat(np.float32(self.yaw))
        return Reference(
            frame.joint_pos,
            frame.joint_vel,
            self.shift + quat_rotate(turn, frame.anchor_pos),
            quat_mul(turn, frame.anchor_quat_wxyz),
        )


def anchor_quat(state: RobotState, body: str) -> F32:
    """Return the orientation of the robot's anchor body, (4,)."""
    return np.asarray(state.base_quat_wxyz if body == "pelvis" else torso_quat(state), np.float32)


def anchor_pos(state: RobotState, body: str) -> F32:
    """Return the place of the robot's anchor body in the odometry world, (3,) [m]."""
    if body == "pelvis":
        zero = np.zeros(3, np.float32)
        return zero if state.base_pos is None else np.asarray(state.base_pos, np.float32)
    return np.asarray(torso_pos(state), np.float32)
