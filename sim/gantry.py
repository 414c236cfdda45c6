"""What holds the robot before its first command, and how it lets go."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

SWAY_STIFFNESS, SWAY_DAMPING = 100.0, 20.0
"""[1/s^2], [1/s] sideways, as accelerations; upwards there is no support."""
TILT_STIFFNESS, TILT_DAMPING = 150.0, 24.0
"""[1/s^2], [1/s] about every axis; gravity tips the robot with about 40 1/s^2."""
SETTLE_S = 1.0
SETTLE_GAIN = 100.0
"""Joints are this much stiffer than the motors while the contacts settle: no sag in the pose."""


class Gantry:
    """Holds the pelvis over one spot and upright; the weight rests on the feet all the time."""

    def __init__(self, data: Any, release_s: float) -> None:
        """Hold the robot where it is.

        Args:
            data: MuJoCo state.
            release_s: Seconds from full to no support.
        """
        self._pos = data.qpos[:2].copy()  # (2,)
        self._quat = data.qpos[3:7].copy()  # (4,)
        self._release_s = release_s
        self._remaining_s: float | None = None

    @property
    def is_holding(self) -> bool:
        """Whether nothing may move yet."""
        return self._remaining_s is None

    def release(self) -> None:
        """Begin to let go; once begun it is not undone."""
        if self._remaining_s is None:
            self._remaining_s = self._release_s

    def vanish(self) -> None:
        """Let go at once."""
        self._remaining_s = 0.0

    def apply(self, model: Any, data: Any, dt_s: float) -> None:
        """Write the support into `qfrc_applied` and advance the release by one step."""
        if not self._remaining_s:
            return
        self._remaining_s = max(0.0, self._remaining_s - dt_s)
        share = self._remaining_s / self._release_s if self._release_s > 0.0 else 0.0
        support(model, data, self._pos, self._quat, share * share * (3.0 - 2.0 * share))


def support(model: Any, data: Any, pos: F64, quat: F64, share: float) -> None:
    """Push the base sideways and upright towards a pose, `share` of the full strength.

    The forces are the mass matrix times the accelerations wanted of the base alone: the joints feel
    nothing, and a stiff support of so light a body as the pelvis needs no tiny step.
    """
    wanted = np.zeros(model.nv)
    wanted[:2] = SWAY_STIFFNESS * (pos - data.qpos[:2]) - SWAY_DAMPING * data.qvel[:2]
    error_b = np.zeros(3)  # rotation from the base to the pose, in the base's frame
    mujoco.mju_subQuat(error_b, quat, data.qpos[3:7])
    wanted[3:6] = TILT_STIFFNESS * error_b - TILT_DAMPING * data.qvel[3:6]
    mujoco.mj_mulM(model, data, data.qfrc_applied, share * wanted)


def settle(model: Any, data: Any, joint_pos: F64) -> None:
    """Put the robot on its feet in a pose and let the contacts take its weight.

    The motors' gains are raised meanwhile, so that the pose does not sag, and restored after.

    Args:
        model: MuJoCo model.
        data: Its state; ends at time 0, at rest, with the forces that hold the pose.
        joint_pos: (29,) [rad].
    """
    gains, biases = model.actuator_gainprm.copy(), model.actuator_biasprm.copy()
    model.actuator_gainprm *= SETTLE_GAIN
    model.actuator_biasprm *= SETTLE_GAIN
    data.qpos[:7] = (0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0)
    data.qpos[7:] = joint_pos
    data.ctrl[:] = joint_pos
    mujoco.mj_forward(model, data)
    soles = [i for i in range(model.ngeom) if "_foot" in model.geom(i).name]
    data.qpos[2] -= min(data.geom_xpos[i][2] - model.geom_size[i][0] for i in soles)
    pos, quat = data.qpos[:2].copy(), data.qpos[3:7].copy()
    for _ in range(round(SETTLE_S / model.opt.timestep)):
        support(model, data, pos, quat, 1.0)
        mujoco.mj_step(model, data)
    data.qvel[:] = 0.0
    data.time = 0.0
    support(model, data, pos, quat, 1.0)
    mujoco.mj_forward(model, data)  # forces and sensors of the pose at rest
    data.qfrc_applied[:] = 0.0
    model.actuator_gainprm[:], model.actuator_biasprm[:] = gains, biases
