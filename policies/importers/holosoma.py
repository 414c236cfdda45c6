"""holosoma: one ONNX file with JSON values in its metadata; the rest is its inference config."""

from __future__ import annotations

from typing import Any, cast

from downbeat.policies.importers.build import (
    check_against_network,
    command_ranges,
    held_joints,
    joints,
    one_input,
    terms_from,
)
from downbeat.policies.importers.context import Draft, ImportContext
from downbeat.policies.importers.network import Network
from downbeat.policies.importers.profiles import HOLOSOMA, HolosomaProfile, pick
from downbeat.policies.importers.values import json_value
from downbeat.policies.spec import GaitSpec, PolicySpec
from downbeat.runtime.errors import one_of

TERMS = {
    "actions": "last_action",
    "base_ang_vel": "base_ang_vel",
    "command_ang_vel": "velocity_command_yaw",
    "command_lin_vel": "velocity_command_xy",
    "cos_phase": "feet_phase_cos",
    "dof_pos": "joint_pos_rel",
    "dof_vel": "joint_vel",
    "projected_gravity": "projected_gravity",
    "sin_phase": "feet_phase_sin",
    "base_lin_vel": "base_lin_vel",
}
TICK_S = 0.02


def recognises(network: Network) -> bool:
    """Whether the file carries this metadata."""
    return "dof_names" in network.metadata and "kp" in network.metadata


def import_policy(ctx: ImportContext, network: Network) -> Draft:
    """Read one file.

    Raises:
        PolicyError: Names the field that is missing or contradicts.
    """
    meta, where = network.metadata, f"{network.path}:metadata"
    for key in ("dof_names", "kp", "kd"):
        if key not in meta:
            raise ctx.need(key, f"its metadata has {one_of(meta)}")
    name, found = pick(HOLOSOMA, ctx.profile, "holosoma_g1_29dof")
    profile = cast(HolosomaProfile, found)
    source = f"built-in profile {name}"
    scale = _from_meta(network, "action_scale")
    if scale is None:
        scale = ctx.infer("action_scale", profile.action_scale, source)
    default = _from_meta(network, "default_joint_pos")
    if default is None:
        default = ctx.infer("default_joint_pos", profile.default_joint_pos, source)
    ctx.infer("observation terms", ", ".join(sorted(profile.terms)), f"{source}, alphabetical")
    scales = dict(profile.scales or {})
    ctx.infer("observation scales", scales, source)
    period = float(ctx.infer("gait.period_s", profile.gait_period_s, source))
    moved = joints(
        ctx,
        json_value(meta["dof_names"], f"{where}.dof_names"),
        default,
        json_value(meta["kp"], f"{where}.kp"),
        json_value(meta["kd"], f"{where}.kd"),
        scale,
        default,
        where,
    )
    terms = terms_from(sorted(profile.terms), TERMS, scales, source)
    spec = PolicySpec(
        dialect="holosoma",
        inputs=(one_input(network, terms),),
        action_output=next(iter(network.outputs)),
        joint_names=moved.names,
        default_joint_pos=moved.default,
        action_scale=moved.scale,
        action_offset=moved.offset,
        joint_stiffness=moved.stiffness,
        joint_damping=moved.damping,
        action_clip=(-100.0, 100.0),
        held=held_joints(ctx, moved.names),
        gait=GaitSpec(period, start=TICK_S / period, still="together"),
    )
    check_against_network(spec, network)
    ranges = _from_meta(network, "command_ranges")
    command = command_ranges(ctx, ranges, ("lin_vel_x", "lin_vel_y", "ang_vel_yaw"))
    return Draft(spec, network.path, "locomotion", period, command=command)


def _from_meta(network: Network, key: str) -> Any:
    text = network.metadata.get(key)
    return None if text is None else json_value(text, f"{network.path}:metadata.{key}")
