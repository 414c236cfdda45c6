"""Time-varying LQR through the contacts, mapped onto what the robot can measure.

State error (70,): position-like 35 (base position world, base rotation in the base frame, joints),
then velocities 35. The robot has no measurement of base position, velocity and yaw; they are
eliminated by "the weighted planted foot does not move", which is linear and is folded into the
gain. What is left acts on 64 numbers: projected gravity, gyro, joint positions, joint velocities.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from downbeat.policies.generator.model import (
    NUM_JOINTS,
    NV,
    STATE_SIZE,
    BodyModel,
    rotation,
)
from downbeat.policies.generator.reference import Reference
from downbeat.policies.manifest import OBSERVATION_SIZE

F64 = NDArray[np.float64]
POS_STEP = 2e-5
VEL_STEP = 4e-4
CTRL_STEP = 2e-4
MAX_PERIODS = 400
CONVERGED = 1e-3
"""Relative change of the cost-to-go over one period at which Riccati stops."""
GRAVITY_W = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, slots=True)
class Weights:
    """Cost of the regulator.

    The defaults came out of a random search over 200 candidates on three gaits, scored by survival
    under noise, 20 ms delay and mass error, and a second one on six dances that raised joint_vel
    (fewer falls under half of BeyondMimic's noise). They serve every skill but the stand.

    Attributes:
        com, com_z: Centre of mass over the stance foot, horizontal and vertical.
        com_vel: Its velocity.
        tilt, tilt_vel: Base rotation and its rate.
        leg, waist, arm: Joint errors.
        joint_vel: Joint velocity errors.
        foot: Swing foot relative to the stance foot.
        effort: Change of the position targets. Below about 60 noise makes the feet creep.
    """

    com: float = 1095.0
    com_z: float = 200.0
    com_vel: float = 132.0
    tilt: float = 54.0
    tilt_vel: float = 8.9
    leg: float = 35.0
    waist: float = 5.0
    arm: float = 4.6
    joint_vel: float = 1.0
    foot: float = 39.0
    effort: float = 250.0


STAND_WEIGHTS = Weights(
    com=2000.0,
    com_vel=100.0,
    tilt=100.0,
    tilt_vel=2.0,
    arm=2.0,
    joint_vel=0.2,
    foot=0.0,
    effort=120.0,
)
"""The stand: 16 of 16 runs survive half of BeyondMimic's noise; joint_vel .02 survived 12."""


@dataclass(frozen=True, slots=True)
class Feedback:
    """target = reference.target + gain (obs - obs_ref), per tick.

    Attributes:
        gain: (N, 29, 64).
        obs_ref: (N, 64).
    """

    gain: F64
    obs_ref: F64


Dynamics = list[tuple[F64, F64]]
"""Per tick A (70, 70) and B (70, 29) of one control tick."""


def linearise(body: BodyModel, reference: Reference) -> Dynamics:
    """Return the dynamics around every tick, by central differences through the contacts.

    Every tick counts: with a stride of four, lively dances fall within seconds.
    """
    return [
        _linearise_tick(body, reference.qpos[k], reference.qvel[k], reference.target[k])
        for k in range(len(reference.qpos))
    ]


def _linearise_tick(body: BodyModel, qpos: F64, qvel: F64, ctrl: F64) -> tuple[F64, F64]:
    model, data = body.model, body.data
    data.qpos[:] = qpos
    data.qvel[:] = qvel
    data.ctrl[:] = ctrl
    mujoco.mj_forward(model, data)
    warm_start = data.qacc.copy()

    def roll(pos_shift: F64 | None, vel: F64, command: F64) -> tuple[F64, F64]:
        data.qpos[:] = qpos
        if pos_shift is not None:
            mujoco.mj_integratePos(model, data.qpos, pos_shift, 1.0)
        data.qvel[:] = vel
        data.qacc_warmstart[:] = warm_start
        body.step(command)
        return data.qpos.copy(), data.qvel.copy()

    def column(plus: tuple[F64, F64], minus: tuple[F64, F64], step: float) -> F64:
        change = np.concatenate([body.difference(plus[0], minus[0]), plus[1] - minus[1]])
        return change / (2.0 * step)

    a = np.zeros((STATE_SIZE, STATE_SIZE))
    b = np.zeros((STATE_SIZE, NUM_JOINTS))
    shift = np.zeros(NV)
    for i in range(NV):
        shift[:] = 0.0
        shift[i] = POS_STEP
        a[:, i] = column(roll(shift, qvel, ctrl), roll(-shift, qvel, ctrl), POS_STEP)
        shift[i] = VEL_STEP
        fast, slow = roll(None, qvel + shift, ctrl), roll(None, qvel - shift, ctrl)
        a[:, NV + i] = column(fast, slow, VEL_STEP)
    push = np.zeros(NUM_JOINTS)
    for i in range(NUM_JOINTS):
        push[:] = 0.0
        push[i] = CTRL_STEP
        b[:, i] = column(roll(None, qvel, ctrl + push), roll(None, qvel, ctrl - push), CTRL_STEP)
    return a, b


def turn_wrap(dynamics: Dynamics, yaw: float) -> Dynamics:
    """Let the last tick of a turning gait lead into the first one, in the turned frame."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.eye(STATE_SIZE)
    for offset in (0, NV):
        turn[offset : offset + 2, offset : offset + 2] = [[cos, sin], [-sin, cos]]
    a, b = dynamics[-1]
    return [*dynamics[:-1], (turn @ a, turn @ b)]


def state_cost(body: BodyModel, qpos: F64, left_weight: float, weights: Weights) -> F64:
    """Return the state cost (70, 70) at a pose."""
    body.set_pose(qpos)
    feet = body.foot_jacobian(0)[:3], body.foot_jacobian(1)[:3]
    stance = left_weight * feet[0] + (1.0 - left_weight) * feet[1]  # (3, 35)
    swing = (1.0 - left_weight) * feet[0] + left_weight * feet[1]
    com = body.com_jacobian() - stance
    cost = np.zeros((STATE_SIZE, STATE_SIZE))
    position, velocity = cost[:NV, :NV], cost[NV:, NV:]
    position += com.T @ np.diag([weights.com, weights.com, weights.com_z]) @ com
    position += weights.foot * (swing - stance).T @ (swing - stance)
    velocity += weights.com_vel * com.T @ np.diag([1.0, 1.0, 0.2]) @ com
    joints = np.concatenate(
        [np.full(12, weights.leg), np.full(3, weights.waist), np.full(14, weights.arm)]
    )
    position += np.diag(np.concatenate([np.zeros(3), np.full(3, weights.tilt), joints]))
    rates = np.concatenate([np.zeros(3), np.full(3, weights.tilt_vel)])
    velocity += np.diag(np.concatenate([rates, np.full(NUM_JOINTS, weights.joint_vel)]))
    return cost


def periodic_gains(
    body: BodyModel, reference: Reference, dynamics: Dynamics, weights: Weights
) -> F64:
    """Return the periodic LQR gain (N, 29, 70): target change = gain @ state error."""
    ticks = len(dynamics)
    costs = [
        state_cost(body, reference.qpos[k], reference.left_weight[k], weights) for k in range(ticks)
    ]
    gains = np.zeros((ticks, NUM_JOINTS, STATE_SIZE))
    effort = weights.effort * np.eye(NUM_JOINTS)
    to_go = costs[-1].copy()
    for _ in range(MAX_PERIODS):
        before = to_go
        for k in range(ticks - 1, -1, -1):
            a, b = dynamics[k]
            pb = to_go @ b
            gain = np.linalg.solve(effort + b.T @ pb, pb.T @ a)
            to_go = costs[k] + a.T @ to_go @ (a - b @ gain)
            to_go = 0.5 * (to_go + to_go.T)
            gains[k] = -gain
        if np.abs(to_go - before).max() < CONVERGED * np.abs(to_go).max():
            break
    return gains


def observation_map(body: BodyModel, qpos: F64, left_weight: float) -> F64:
    """Return the map (70, 64) from the observation error to the state error.

    Symbols: g unit gravity in the base frame. A small base rotation r (base frame) changes the
    measured gravity by e = g x r, so the part of r across g is -g x e. The part along g is the
    yaw; it follows from "the weighted foot does not turn". Base position and velocity follow from
    "the weighted foot does not move".
    """
    body.set_pose(qpos)
    jacobian = left_weight * body.foot_jacobian(0) + (1.0 - left_weight) * body.foot_jacobian(1)
    place, turn = jacobian[:3], jacobian[5]  # (3, 35), (35,) about the vertical
    g = rotation(qpos[3:7]).T @ GRAVITY_W  # (3,)
    cross = np.array([[0.0, -g[2], g[1]], [g[2], 0.0, -g[0]], [-g[1], g[0], 0.0]])
    tilt = -cross  # (3, 3) gravity error -> rotation across g
    along = turn[3:6] @ g
    base_turn = np.zeros((3, 3 + NUM_JOINTS))  # from [gravity error, joint error]
    base_turn[:, :3] = tilt - np.outer(g, turn[3:6] @ tilt) / along
    base_turn[:, 3:] = -np.outer(g, turn[6:]) / along
    to_world = np.linalg.inv(place[:, :3])
    base_move = -to_world @ place[:, 3:6] @ base_turn
    base_move[:, 3:] -= to_world @ place[:, 6:]
    out = np.zeros((STATE_SIZE, OBSERVATION_SIZE))
    gravity_and_joints = [*range(3), *range(6, 35)]
    out[0:3, gravity_and_joints] = base_move
    out[3:6, gravity_and_joints] = base_turn
    out[6:NV, 6:35] = np.eye(NUM_JOINTS)
    out[NV : NV + 3, 3:6] = -to_world @ place[:, 3:6]
    out[NV : NV + 3, 35:] = -to_world @ place[:, 6:]
    out[NV + 3 : NV + 6, 3:6] = np.eye(3)
    out[NV + 6 :, 35:] = np.eye(NUM_JOINTS)
    return out


def observe_reference(reference: Reference) -> F64:
    """Return what the robot would measure on the reference, (N, 64)."""
    gravity = [rotation(qpos[3:7]).T @ GRAVITY_W for qpos in reference.qpos]
    return np.concatenate(
        [
            np.stack(gravity),
            reference.qvel[:, 3:6],
            reference.qpos[:, 7:],
            reference.qvel[:, 6:],
        ],
        axis=1,
    )


def build_feedback(
    body: BodyModel, reference: Reference, dynamics: Dynamics, weights: Weights
) -> Feedback:
    """Return the gain on measurable observations for every tick."""
    gains = periodic_gains(body, reference, dynamics, weights)
    mapped = [
        gains[k] @ observation_map(body, reference.qpos[k], reference.left_weight[k])
        for k in range(len(gains))
    ]
    return Feedback(np.stack(mapped), observe_reference(reference))
