"""holosoma: one ONNX file with JSON values in its metadata; the rest is its inference config.

Two tasks: walking on command with a gait clock, and tracking of a motion that is baked in.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from downbeat.policies.errors import PolicyError
from downbeat.policies.importers.baked import anchored, read_baked
from downbeat.policies.importers.build import (
    TIME_STEP,
    Joints,
    action_output,
    check_against_network,
    command_ranges,
    held_joints,
    joints,
    obs_input,
    recurrent_pairs,
    terms_from,
)
from downbeat.policies.importers.context import Draft, ImportContext
from downbeat.policies.importers.motion import RATE_HZ, Tables
from downbeat.policies.importers.network import Network
from downbeat.policies.importers.profiles import HOLOSOMA, HolosomaProfile
from downbeat.policies.importers.values import json_value, positive
from downbeat.policies.spec import GaitSpec, InputSpec, MotionSpec, PolicySpec, TermSpec
from downbeat.runtime.errors import one_of

TERMS = {
    "actions": "last_action",
    "base_ang_vel": "base_ang_vel",
    "base_lin_vel": "base_lin_vel",
    "command_ang_vel": "velocity_command_yaw",
    "command_lin_vel": "velocity_command_xy",
    "cos_phase": "feet_phase_cos",
    "dof_pos": "joint_pos_rel",
    "dof_vel": "joint_vel",
    "motion_command": "motion_command",
    "motion_ref_ori_b": "motion_anchor_ori_b",
    "motion_ref_pos_b": "motion_anchor_pos_b",
    "projected_gravity": "projected_gravity",
    "sin_phase": "feet_phase_sin",
}
NEEDED = ("dof_names", "kp", "kd")
TICK_S = 0.02
ACTION_CLIP = 100.0
RANGE_KEYS = ("lin_vel_x", "lin_vel_y", "ang_vel_yaw")


def recognises(network: Network) -> bool:
    """Whether the file carries metadata of this kind, complete or not."""
    return len({*NEEDED, "command_ranges", "robot_urdf"} & set(network.metadata)) >= 2


def import_policy(ctx: ImportContext, network: Network) -> Draft:
    """Read one file.

    Raises:
        PolicyError: Names the field that is missing or contradicts.
    """
    tracks = TIME_STEP in network.inputs
    name, profile = ctx.pick(HOLOSOMA, "holosoma_g1_wbt" if tracks else "holosoma_g1_29dof")
    if profile is None or tracks != (profile.gait_period_s is None):
        raise PolicyError(
            f"Profile '{name}' does not fit {network.path}: it has inputs {one_of(network.inputs)}."
        )
    source = f"built-in profile {name}"
    moved = _joints(ctx, network, profile, source)
    terms = _terms(ctx, profile, source)
    obs, action = obs_input(network), action_output(network, len(moved.names))
    gait = None
    if profile.gait_period_s is not None:
        given = ctx.infer("gait.period_s", profile.gait_period_s, source)
        period = positive(given, "gait.period_s")
        gait = GaitSpec(period, start=TICK_S / period, still="together")
        ctx.note(f"gait.still = both feet at phase 0.5 while nothing is commanded: {source}")
    ctx.note(f"action_clip = -{ACTION_CLIP:g}..{ACTION_CLIP:g}: {source}")
    spec = PolicySpec(
        dialect="holosoma",
        inputs=(InputSpec(obs, terms),),
        action_output=action,
        joint_names=moved.names,
        default_joint_pos=moved.default,
        action_scale=moved.scale,
        action_offset=moved.offset,
        joint_stiffness=moved.stiffness,
        joint_damping=moved.damping,
        action_clip=(-ACTION_CLIP, ACTION_CLIP),
        held=held_joints(ctx, moved.names),
        time_step_input=TIME_STEP if tracks else "",
        recurrent=recurrent_pairs(network, (obs, TIME_STEP), action),
        motion=MotionSpec("motion.npz", 2, RATE_HZ, "torso_link") if tracks else None,
        gait=gait,
    )
    check_against_network(spec, network)
    if tracks:
        ctx.note(f"motion.anchor_body = torso_link: {source}")
        ctx.note(f"motion.rate_hz = {RATE_HZ:g}: one baked row a tick, as the format is played")
        return Draft.tracking(spec, network.path, _baked(network), "torso_link")
    ranges = _from_meta(network, "command_ranges")
    if ranges is not None and not isinstance(ranges, dict):
        raise PolicyError(f"{network.path}:metadata.command_ranges is not a table of ranges.")
    command = command_ranges(ctx, ranges, RANGE_KEYS)
    return Draft(spec, network.path, "locomotion", gait.period_s if gait else 1.0, command=command)


def _joints(ctx: ImportContext, network: Network, profile: HolosomaProfile, source: str) -> Joints:
    found: dict[str, Any] = {}
    for key in NEEDED:
        found[key] = _from_meta(network, key)
        ours = {"dof_names": "joint_names", "kp": "joint_stiffness", "kd": "joint_damping"}[key]
        if found[key] is None and ctx.setting(ours) is None:
            raise ctx.need(ours, f"its metadata has {one_of(network.metadata)} but no {key}")
    scale = _from_meta(network, "action_scale")
    if scale is None:
        scale = ctx.infer("action_scale", profile.action_scale, source)
    default = _from_meta(network, "default_joint_pos")
    if default is None:
        default = ctx.infer("default_joint_pos", profile.default_joint_pos, source)
    return joints(
        ctx,
        found["dof_names"],
        default,
        found["kp"],
        found["kd"],
        scale,
        default,
        f"{network.path}:metadata",
    )


def _terms(ctx: ImportContext, profile: HolosomaProfile, source: str) -> tuple[TermSpec, ...]:
    names = sorted(profile.terms)
    scales = dict(profile.scales or {})
    ctx.note(f"observation terms = {', '.join(names)} (alphabetical): {source}")
    shown = ", ".join(f"{name} {value:g}" for name, value in scales.items()) or "1"
    ctx.note(f"observation scales = {shown}: {source}")
    return terms_from(names, TERMS, scales, source)


def _baked(network: Network) -> Tables:
    tables = read_baked(network, ("joint_pos", "joint_vel", "ref_pos_xyz", "ref_quat_xyzw"))
    quats = np.roll(tables["ref_quat_xyzw"], 1, axis=1)  # wxyz
    return anchored(tables, tables["ref_pos_xyz"], quats, str(network.path))


def _from_meta(network: Network, key: str) -> Any:
    text = network.metadata.get(key)
    return None if text is None else json_value(text, f"{network.path}:metadata.{key}")
