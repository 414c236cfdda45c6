"""From wanted motion to a whole-body reference: inverse kinematics, balance, feed-forward torque.

1. The legs are solved so that the feet stand where the plan says, tick by tick.
2. Inverse dynamics gives the zero moment point; its error, low-passed by the inverse of the
   linear inverted pendulum, is added to the pelvis, a few times over.
3. The contact wrench is shared between the feet; joint torques become position targets through
   the motors' gains: target = q + (torque + kd qd) / kp.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from downbeat.policies.generator.choreography import BodyMotion
from downbeat.policies.generator.footsteps import (
    FOOT_FRAME_HEIGHT_M,
    SOLE_CENTRE_M,
    STANCE_HALF_WIDTH_M,
    FootPlan,
)
from downbeat.policies.generator.model import (
    NUM_JOINTS,
    NV,
    BodyModel,
    quat_from_rpy,
    quat_from_yaw,
    rotation,
)

F64 = NDArray[np.float64]
GRAVITY = 9.81
ZMP_PASSES = 6
ZMP_GAIN = 1.1
IK_ITERATIONS = 8
IK_TOLERANCE = 1e-9
IK_MAX_STEP_RAD = 0.3
PAD_TICKS = 100
"""The ends of an open motion are held this long around it before filtering."""
MIN_WEIGHT = 1e-5
WRENCH_COST = np.array([1.0, 1.0, 0.2, 30.0, 30.0, 30.0]) ** 2
"""Cost of each foot's force and moment: vertical force is cheap, moments dear."""


@dataclass(frozen=True, slots=True)
class Motion:
    """What is wanted, N ticks.

    Attributes:
        tick_s: Time between rows [s]; close to the control tick, so that the loop is exact.
        body: Pelvis and upper joints; pelvis_pos is relative to `feet.path`.
        feet: The plan; see `planted_feet` for standing feet.
        periodic: The last row is followed by the first; else a motion with two ends.
        zmp_window: (2,) [m] planted: half width of the zero moment point's window, x and y;
            None: it follows `feet.zmp`.
    """

    tick_s: float
    body: BodyMotion
    feet: FootPlan
    periodic: bool = True
    zmp_window: tuple[float, float] | None = None


@dataclass(slots=True)
class Reference:
    """The motion the robot shall make, N ticks, MuJoCo order and world frame.

    Attributes:
        qpos: (N, 36). qvel: (N, 35).
        target: (N, 29) [rad] position targets that produce the motion without feedback.
        torque: (N, 29) [N m].
        zmp: (N, 2) [m].
        foot_force: (N, 2) [N] vertical force under each foot.
        left_weight: (N,) share of the left foot.
        ik_error: Largest foot error [m, rad].
    """

    qpos: F64
    qvel: F64
    target: F64
    torque: F64
    zmp: F64
    foot_force: F64
    left_weight: F64
    ik_error: float

    def window(self, start: int, stop: int) -> Reference:
        """Return a copy of ticks start to stop."""
        part = slice(start, stop)
        return Reference(
            self.qpos[part].copy(),
            self.qvel[part].copy(),
            self.target[part].copy(),
            self.torque[part].copy(),
            self.zmp[part].copy(),
            self.foot_force[part].copy(),
            self.left_weight[part].copy(),
            self.ik_error,
        )


def planted_feet(ticks: int) -> FootPlan:
    """Return feet that stand side by side for N ticks."""
    pos = np.empty((ticks, 2, 3))
    pos[:, 0] = (0.0, STANCE_HALF_WIDTH_M, FOOT_FRAME_HEIGHT_M)
    pos[:, 1] = (0.0, -STANCE_HALF_WIDTH_M, FOOT_FRAME_HEIGHT_M)
    zmp = np.tile([SOLE_CENTRE_M, 0.0], (ticks, 1))
    zeros = np.zeros((ticks, 3))
    return FootPlan(pos, np.zeros((ticks, 2)), zmp, np.full(ticks, 0.5), zeros)


def build_reference(body: BodyModel, motion: Motion) -> Reference:
    """Return the whole-body reference of `motion`; judge it with `checks` before use."""
    pelvis = motion.body.pelvis_pos.copy()  # (N, 3)
    pelvis[:, :2] += motion.feet.path[:, :2]
    rpy = motion.body.pelvis_rpy.copy()
    rpy[:, 2] += motion.feet.path[:, 2]
    wanted_zmp = motion.feet.zmp
    for iteration in range(ZMP_PASSES):
        qpos, ik_error = _solve_poses(body, motion, pelvis, rpy)
        qvel, qacc = _derivatives(body, motion, qpos)
        force, com_height, zmp = _inverse_dynamics(body, qpos, qvel, qacc)
        if iteration == 0 and motion.zmp_window is not None:
            wanted_zmp = _squash(zmp, motion.zmp_window)
        if iteration < ZMP_PASSES - 1:
            error = wanted_zmp - zmp
            pelvis[:, :2] += ZMP_GAIN * _pendulum_filter(error, com_height, motion)
    torque, foot_force = _share_contact_wrench(body, motion, qpos, force)
    robot = body.robot
    target = qpos[:, 7:] + (torque + robot.joint_damping * qvel[:, 6:]) / robot.joint_stiffness
    weight = motion.feet.left_weight
    return Reference(qpos, qvel, target, torque, zmp, foot_force, weight, ik_error)


def _squash(zmp: F64, window: tuple[float, float]) -> F64:
    """Keep the zero moment point's own way, but inside the window around the sole's middle."""
    centre = np.array([SOLE_CENTRE_M, 0.0])
    limit = np.array(window)
    return centre + limit * np.tanh((zmp - centre) / limit)


def _solve_poses(body: BodyModel, motion: Motion, pelvis: F64, rpy: F64) -> tuple[F64, float]:
    """Return qpos (N, 36) and the largest foot error."""
    ticks = len(pelvis)
    poses = np.zeros((ticks, 7 + NUM_JOINTS))
    qpos = np.concatenate([np.zeros(7), body.robot.default_joint_pos])
    worst = 0.0
    for k in range(ticks):
        qpos[:3] = pelvis[k]
        qpos[3:7] = quat_from_rpy(rpy[k])
        qpos[19:] = motion.body.upper_joint_pos[k]
        worst = max(worst, solve_legs(body, qpos, motion.feet.pos[k], motion.feet.yaw[k]))
        poses[k] = qpos
    return poses, worst


def solve_legs(body: BodyModel, qpos: F64, foot_pos: F64, foot_yaw: F64) -> float:
    """Change the leg joints in `qpos` (36,) so that the feet reach their places.

    Args:
        body: Model.
        qpos: Start of the search; changed in place.
        foot_pos: (2, 3) [m] foot frames, world.
        foot_yaw: (2,) [rad].

    Returns:
        Largest remaining error [m, rad].
    """
    quats = [quat_from_yaw(yaw) for yaw in foot_yaw]
    inverse, delta, error = np.zeros(4), np.zeros(4), np.zeros(6)
    worst = 0.0
    for _ in range(IK_ITERATIONS):
        body.set_pose(qpos)
        worst = 0.0
        for side, foot in enumerate(body.foot_bodies):
            error[:3] = foot_pos[side] - body.data.xpos[foot]
            mujoco.mju_negQuat(inverse, body.data.xquat[foot])
            mujoco.mju_mulQuat(delta, quats[side], inverse)
            mujoco.mju_quat2Vel(error[3:], delta, 1.0)
            dofs = body.leg_dofs[side]
            jacobian = body.foot_jacobian(side)[:, dofs]  # (6, 6)
            normal = jacobian.T @ jacobian + 1e-8 * np.eye(6)
            change = np.linalg.solve(normal, jacobian.T @ error)
            qpos[dofs + 1] += np.clip(change, -IK_MAX_STEP_RAD, IK_MAX_STEP_RAD)
            worst = max(worst, float(np.abs(error).max()))
        if worst < IK_TOLERANCE:
            break
    return worst


def _neighbours(k: int, ticks: int, periodic: bool) -> tuple[int, int]:
    if periodic:
        return (k - 1) % ticks, (k + 1) % ticks
    return max(k - 1, 0), min(k + 1, ticks - 1)


def _derivatives(body: BodyModel, motion: Motion, qpos: F64) -> tuple[F64, F64]:
    """Return central differences qvel, qacc, (N, 35) each."""
    ticks = len(qpos)
    qvel = np.zeros((ticks, NV))
    qacc = np.zeros((ticks, NV))
    pairs = [_neighbours(k, ticks, motion.periodic) for k in range(ticks)]
    # At the ends of an open motion only one neighbour exists.
    spans = [2.0 if motion.periodic else float(max(after - before, 1)) for before, after in pairs]
    for k, (before, after) in enumerate(pairs):
        qvel[k] = body.difference(qpos[after], qpos[before], spans[k] * motion.tick_s)
    for k, (before, after) in enumerate(pairs):
        qacc[k] = (qvel[after] - qvel[before]) / (spans[k] * motion.tick_s)
    return qvel, qacc


def _inverse_dynamics(body: BodyModel, qpos: F64, qvel: F64, qacc: F64) -> tuple[F64, float, F64]:
    """Return generalised forces (N, 35), mean height of the centre of mass, and ZMP (N, 2)."""
    model, data = body.model, body.data
    force = np.zeros_like(qvel)
    zmp = np.zeros((len(qpos), 2))
    heights = np.zeros(len(qpos))
    for k in range(len(qpos)):
        data.qpos[:] = qpos[k]
        data.qvel[:] = qvel[k]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        data.qacc[:] = qacc[k]
        mujoco.mj_rne(model, data, 1, force[k])
        force[k] += model.dof_armature * qacc[k]
        heights[k] = data.subtree_com[0, 2]
        # The free joint's force is in the world frame, its moment in the base frame.
        push = force[k, :3]
        moment = rotation(qpos[k, 3:7]) @ force[k, 3:6] + np.cross(qpos[k, :3], push)
        zmp[k] = -moment[1] / push[2], moment[0] / push[2]
    return force, float(heights.mean()), zmp


def _pendulum_filter(error: F64, com_height: float, motion: Motion) -> F64:
    """Return the shift of the mass (N, 2) [m] that moves the zero moment point by `error`.

    For the linear inverted pendulum zmp = c - (h / g) c'', so c = zmp / (1 + (h / g) w^2).
    """
    pad = 0
    if not motion.periodic:
        pad = PAD_TICKS
        held = np.pad(error, ((pad, pad), (0, 0)), mode="edge")
        error = np.vstack([held, held[::-1]])  # mirrored: the transform sees no jump
    omega = 2.0 * np.pi * np.fft.fftfreq(len(error), motion.tick_s)  # (M,)
    gain = 1.0 / (1.0 + com_height / GRAVITY * omega**2)
    shift = np.real(np.fft.ifft(np.fft.fft(error, axis=0) * gain[:, None], axis=0))
    return shift[pad : pad + len(motion.feet.zmp)]


def _share_contact_wrench(
    body: BodyModel, motion: Motion, qpos: F64, force: F64
) -> tuple[F64, F64]:
    """Return joint torques (N, 29) and vertical foot forces (N, 2).

    The base has no motor: its six generalised forces must come from the feet. Among the wrenches
    that do, the one with the least weighted norm is taken; a foot without weight costs much.
    """
    torque = np.zeros((len(qpos), NUM_JOINTS))
    foot_force = np.zeros((len(qpos), 2))
    for k in range(len(qpos)):
        body.set_pose(qpos[k])
        jacobian = np.vstack([body.foot_jacobian(0), body.foot_jacobian(1)])  # (12, 35)
        left = motion.feet.left_weight[k]
        share = np.maximum([left, 1.0 - left], MIN_WEIGHT)
        cheap = np.concatenate([share[0] / WRENCH_COST, share[1] / WRENCH_COST])  # (12,)
        base = jacobian[:, :6].T  # (6, 12)
        gram = (base * cheap) @ base.T
        wrench = cheap * (base.T @ np.linalg.solve(gram, force[k, :6]))  # (12,)
        torque[k] = force[k, 6:] - jacobian[:, 6:].T @ wrench
        foot_force[k] = wrench[2], wrench[8]
    return torque, foot_force
