"""Observation terms, written once over the array namespace with leading batch dimensions.

The robot, the simulator and the batch check run these lines. `xp` is `numpy` or `jax.numpy`;
arrays are `(..., n)`. No matrix product and no BLAS: the same bits everywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from downbeat.control.errors import ControlError
from downbeat.control.rotations import (
    first_two_columns,
    quat_about,
    quat_conjugate,
    quat_mul,
    quat_rotate,
    quat_rotate_inverse,
)
from downbeat.policies.spec import InputSpec
from downbeat.runtime.errors import one_of

Array = Any

WAIST_YAW, WAIST_ROLL, WAIST_PITCH = 12, 13, 14
"""Motor order."""
TORSO_FROM_WAIST_YAW_M = (-0.0039635, 0.0, 0.044)
"""Origin of the torso in the frame of waist_yaw_link (catalog/g1_facts.json: waist_roll_link)."""


@dataclass(frozen=True, slots=True)
class RobotState:
    """What the terms read.

    Attributes:
        base_quat_wxyz: (..., 4) unit, world <- base.
        base_ang_vel: (..., 3) [rad/s] base frame.
        joint_pos: (..., 29) [rad] Unitree motor order.
        joint_vel: (..., 29) [rad/s].
        base_lin_vel: (..., 3) [m/s] base frame, estimated; None: not known, taken as zero.
        base_pos: (..., 3) [m] odometry, estimated; None: not known, taken as zero.
    """

    base_quat_wxyz: Array
    base_ang_vel: Array
    joint_pos: Array
    joint_vel: Array
    base_lin_vel: Array = None
    base_pos: Array = None


@dataclass(frozen=True, slots=True)
class Reference:
    """One frame of a motion, in the robot's odometry world.

    Attributes:
        joint_pos: (..., n) [rad] policy order.
        joint_vel: (..., n) [rad/s].
        anchor_pos: (..., 3) [m].
        anchor_quat_wxyz: (..., 4).
    """

    joint_pos: Array
    joint_vel: Array
    anchor_pos: Array
    anchor_quat_wxyz: Array


@dataclass(frozen=True, slots=True)
class TermInputs:
    """Everything a term may read besides the state; arrays in the policy's joint order.

    Attributes:
        state: The robot.
        joint_pos: (..., n) [rad].
        joint_vel: (..., n) [rad/s].
        default_joint_pos: (n,) [rad].
        last_action: (..., n) raw action of the previous tick.
        command: (..., 3) vx, vy [m/s], yaw rate [rad/s].
        reference: The motion's frame; None without a motion.
        anchor_pos: (..., 3) [m] of the robot's anchor body, world; None without a motion.
        anchor_quat_wxyz: (..., 4) of the robot's anchor body, world; None without a motion.
        motion_phase: (...) 0..1.
        feet_phase: (..., 2) gait phase of the left and the right foot [rad].
    """

    state: RobotState
    joint_pos: Array
    joint_vel: Array
    default_joint_pos: Array
    last_action: Array
    command: Array
    reference: Reference | None = None
    anchor_pos: Array = None
    anchor_quat_wxyz: Array = None
    motion_phase: Array = 0.0
    feet_phase: Array = None


def projected_gravity(quat_wxyz: Array, xp: ModuleType = np) -> Array:
    """Return the unit gravity direction in the base frame, (..., 3); (0, 0, -1) upright.

    Symbols: the last row of the rotation matrix of `quat_wxyz`, negated.
    """
    w, x, y, z = (quat_wxyz[..., i] for i in range(4))
    return xp.stack(
        [
            -2.0 * (x * z - w * y),
            -2.0 * (y * z + w * x),
            -(1.0 - 2.0 * (x * x + y * y)),
        ],
        axis=-1,
    )  # (..., 3)


def tilt(quat_wxyz: Array, xp: ModuleType = np) -> Array:
    """Return the angle between the base's z axis and the vertical, (...) [rad]."""
    return xp.arccos(xp.clip(-projected_gravity(quat_wxyz, xp)[..., 2], -1.0, 1.0))


def yaw(quat_wxyz: Array, xp: ModuleType = np) -> Array:
    """Return the heading, (...) [rad], world frame."""
    w, x, y, z = (quat_wxyz[..., i] for i in range(4))
    return xp.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def torso_quat(state: RobotState, xp: ModuleType = np) -> Array:
    """Return the orientation of the torso, world <- torso, (..., 4)."""
    quat = state.base_quat_wxyz
    for axis, joint in ((2, WAIST_YAW), (0, WAIST_ROLL), (1, WAIST_PITCH)):
        quat = quat_mul(quat, quat_about(axis, state.joint_pos[..., joint], xp), xp)
    return quat


def torso_pos(state: RobotState, xp: ModuleType = np) -> Array:
    """Return the place of the torso's origin in the odometry world, (..., 3) [m]."""
    yawed = quat_about(2, state.joint_pos[..., WAIST_YAW], xp)
    quat = quat_mul(state.base_quat_wxyz, yawed, xp)
    offset = xp.asarray(TORSO_FROM_WAIST_YAW_M, state.joint_pos.dtype)
    offset = quat_rotate(quat, xp.broadcast_to(offset, (*quat.shape[:-1], 3)), xp)
    return offset if state.base_pos is None else state.base_pos + offset


def _known(value: Array, like: Array, xp: ModuleType) -> Array:
    return xp.zeros_like(like) if value is None else value


def _motion(inputs: TermInputs) -> Reference:
    if inputs.reference is None:
        raise ControlError("A motion term was asked for without a reference motion.")
    return inputs.reference


def _anchor_pos_b(inputs: TermInputs, xp: ModuleType) -> Array:
    offset = _motion(inputs).anchor_pos - inputs.anchor_pos
    return quat_rotate_inverse(inputs.anchor_quat_wxyz, offset, xp)


def _anchor_ori_b(inputs: TermInputs, xp: ModuleType) -> Array:
    inverse = quat_conjugate(inputs.anchor_quat_wxyz, xp)
    return first_two_columns(quat_mul(inverse, _motion(inputs).anchor_quat_wxyz, xp), xp)


def _motion_command(inputs: TermInputs, xp: ModuleType) -> Array:
    motion = _motion(inputs)
    return xp.concatenate([motion.joint_pos, motion.joint_vel], axis=-1)


def _gait_phase(inputs: TermInputs, xp: ModuleType) -> Array:
    left = inputs.feet_phase[..., 0]
    return xp.stack([xp.sin(left), xp.cos(left)], axis=-1)


Term = Callable[[TermInputs, ModuleType], Array]

TERMS: Mapping[str, Term] = {
    "projected_gravity": lambda i, xp: projected_gravity(i.state.base_quat_wxyz, xp),
    "base_ang_vel": lambda i, xp: i.state.base_ang_vel,
    "base_lin_vel": lambda i, xp: _known(i.state.base_lin_vel, i.state.base_ang_vel, xp),
    "joint_pos": lambda i, xp: i.joint_pos,
    "joint_pos_rel": lambda i, xp: i.joint_pos - i.default_joint_pos,
    "joint_vel": lambda i, xp: i.joint_vel,
    "last_action": lambda i, xp: i.last_action,
    "velocity_commands": lambda i, xp: i.command,
    "velocity_command_xy": lambda i, xp: i.command[..., :2],
    "velocity_command_yaw": lambda i, xp: i.command[..., 2:],
    "motion_command": _motion_command,
    "motion_joint_pos": lambda i, xp: _motion(i).joint_pos,
    "motion_joint_vel": lambda i, xp: _motion(i).joint_vel,
    "motion_anchor_pos_b": _anchor_pos_b,
    "motion_anchor_ori_b": _anchor_ori_b,
    "motion_phase": lambda i, xp: xp.asarray(i.motion_phase)[..., None],
    "gait_phase": _gait_phase,
    "feet_phase_sin": lambda i, xp: xp.sin(i.feet_phase),
    "feet_phase_cos": lambda i, xp: xp.cos(i.feet_phase),
}
"""Term name -> function; names and widths stand in `policies/terms.py`."""

STATE_TERMS: Mapping[str, Callable[[RobotState, ModuleType], Array]] = {
    "projected_gravity": lambda s, xp: projected_gravity(s.base_quat_wxyz, xp),
    "base_ang_vel": lambda s, xp: s.base_ang_vel,
    "joint_pos": lambda s, xp: s.joint_pos,
    "joint_vel": lambda s, xp: s.joint_vel,
}
"""The terms that skills of our own format are made of: all 29 joints, motor order."""


def check_terms(names: tuple[str, ...], where: str) -> None:
    """Raise ControlError when a skill of our own format asks for a term that does not exist."""
    for name in names:
        if name not in STATE_TERMS:
            raise ControlError(
                f"Observation term '{name}' is unknown; terms are {one_of(STATE_TERMS)} ({where})."
            )


def observe(state: RobotState, names: tuple[str, ...], xp: ModuleType = np) -> Array:
    """Concatenate the named terms of our own format, (..., sum of term widths)."""
    return xp.concatenate([STATE_TERMS[name](state, xp) for name in names], axis=-1)


Histories = tuple[Array, ...]
"""One array per term of an input, (..., frames, width), oldest first."""


def observe_input(
    spec: InputSpec, inputs: TermInputs, histories: Histories | None, xp: ModuleType = np
) -> tuple[Array, Histories]:
    """Compute one input of a network; pure: histories go in and come out.

    Args:
        spec: The input's terms, scales, clips and histories.
        inputs: What the terms read.
        histories: Those of the previous tick; None at the start.
        xp: `numpy` or `jax.numpy`.

    Returns:
        The observation (..., width), and the histories for the next tick.
    """
    seen: list[Array] = []
    kept: list[Array] = []
    for index, term in enumerate(spec.terms):
        value = TERMS[term.name](inputs, xp)  # (..., width)
        if term.clip is not None:
            value = xp.clip(value, term.clip[0], term.clip[1])
        if term.scale != (1.0,):
            value = value * xp.asarray(term.scale, value.dtype)
        frame = value[..., None, :]  # (..., 1, width)
        if term.history == 1 and not term.past:
            kept.append(frame)
            seen.append(frame)
            continue
        if histories is not None:
            before = histories[index]
        else:
            first = frame if spec.history_fill == "first" else xp.zeros_like(frame)
            before = xp.concatenate([first] * term.history, axis=-2)
        kept.append(xp.concatenate([before[..., 1:, :], frame], axis=-2))
        seen.append(before if term.past else kept[-1])
    obs = _flatten(spec, seen, xp)
    if spec.clip is not None:
        obs = xp.clip(obs, -spec.clip, spec.clip)
    return obs, tuple(kept)


def _flatten(spec: InputSpec, frames_seen: list[Array], xp: ModuleType) -> Array:
    seen = frames_seen
    if spec.history_order == "newest_first":
        seen = [frames[..., ::-1, :] for frames in frames_seen]
    if spec.history_layout == "frame":
        joined = xp.concatenate(seen, axis=-1)  # (..., frames, all terms)
        return joined.reshape((*joined.shape[:-2], -1))
    flat = [frames.reshape((*frames.shape[:-2], -1)) for frames in seen]
    return xp.concatenate(flat, axis=-1)


def joint_target(action: Array, scale: Array, offset: Array) -> Array:
    """Return the joint position targets of an action, policy order, (..., n) [rad]."""
    return offset + scale * action
