"""The robot as the generator sees it: a compiled MuJoCo model with the indices it needs."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from downbeat.catalog.mjcf import ModelOptions, g1_mjcf
from downbeat.catalog.robot import load_g1

F64 = NDArray[np.float64]
TICK_S = 0.02
NUM_JOINTS = 29
NV = 6 + NUM_JOINTS
STATE_SIZE = 2 * NV
SIDES = ("left", "right")
LEG_JOINTS = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")


class BodyModel:
    """Model, data and indices; one instance is not shared between threads.

    Attributes:
        model, data: MuJoCo, 5 ms steps, four per control tick.
        foot_bodies: Body ids of the left and the right foot.
        leg_dofs: (2, 6) degrees of freedom of each leg; joint angles lie one further in qpos.
        substeps: Physics steps per control tick.
    """

    def __init__(self, options: ModelOptions | None = None) -> None:
        self.robot = load_g1()
        options = options or ModelOptions(visual=False)
        self.model = mujoco.MjModel.from_xml_string(g1_mjcf(options))
        self.data = mujoco.MjData(self.model)
        self.foot_bodies = tuple(self.model.body(name).id for name in self.robot.feet.body_names)
        self.leg_dofs = np.array(
            [
                [6 + self.robot.joint_index(f"{side}_{joint}") for joint in LEG_JOINTS]
                for side in SIDES
            ]
        )  # (2, 6)
        self.substeps = round(TICK_S / self.model.opt.timestep)
        self._jac_pos = np.zeros((3, NV))
        self._jac_rot = np.zeros((3, NV))

    def set_pose(self, qpos: F64) -> None:
        """Compute body poses and the centre of mass of `qpos` (36,)."""
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)

    def foot_jacobian(self, side: int) -> F64:
        """Return the Jacobian (6, 35) of a foot's position and rotation at the set pose."""
        mujoco.mj_jacBody(
            self.model, self.data, self._jac_pos, self._jac_rot, self.foot_bodies[side]
        )
        return np.vstack([self._jac_pos, self._jac_rot])

    def com_jacobian(self) -> F64:
        """Return the Jacobian (3, 35) of the centre of mass at the set pose."""
        jacobian = np.zeros((3, NV))
        mujoco.mj_jacSubtreeCom(self.model, self.data, jacobian, 0)
        return jacobian

    def step(self, ctrl: F64) -> None:
        """Advance the physics by one control tick with position targets `ctrl` (29,)."""
        self.data.ctrl[:] = ctrl
        mujoco.mj_step(self.model, self.data, self.substeps)

    def difference(self, qpos: F64, from_qpos: F64, period_s: float = 1.0) -> F64:
        """Return the velocity (35,) that leads from `from_qpos` to `qpos` in `period_s`."""
        out = np.zeros(NV)
        mujoco.mj_differentiatePos(self.model, out, period_s, from_qpos, qpos)
        return out


def quat_from_rpy(rpy: F64) -> F64:
    """Return the quaternion wxyz (4,) of roll, pitch, yaw (3,) [rad], yaw applied first."""
    cr, cp, cy = np.cos(rpy / 2.0)
    sr, sp, sy = np.sin(rpy / 2.0)
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def quat_from_yaw(yaw: float) -> F64:
    """Return the quaternion wxyz (4,) of a turn about the vertical."""
    return np.array([np.cos(yaw / 2.0), 0.0, 0.0, np.sin(yaw / 2.0)])


def rotation(quat_wxyz: F64) -> F64:
    """Return the rotation matrix (3, 3) of a quaternion."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quat_wxyz)
    return matrix.reshape(3, 3)
