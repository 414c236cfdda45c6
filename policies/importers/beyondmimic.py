"""BeyondMimic and mjlab: one ONNX file with CSV strings in its metadata."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from downbeat.policies.errors import PolicyError
from downbeat.policies.importers.build import (
    check_against_network,
    command_ranges,
    held_joints,
    joints,
    terms_from,
)
from downbeat.policies.importers.context import Draft, ImportContext
from downbeat.policies.importers.motion import RATE_HZ, from_network
from downbeat.policies.importers.network import Network
from downbeat.policies.importers.profiles import VELOCITY_RANGES
from downbeat.policies.importers.values import csv_numbers, csv_texts
from downbeat.policies.spec import InputSpec, MotionSpec, PolicySpec, TermSpec
from downbeat.runtime.errors import one_of

NEEDED = (
    "joint_names",
    "joint_stiffness",
    "joint_damping",
    "default_joint_pos",
    "action_scale",
    "observation_names",
)
TERMS: Mapping[str, str] = {
    "joint_pos": "joint_pos_rel",
    "joint_vel": "joint_vel",
    "actions": "last_action",
    "motion_ref_pos_b": "motion_anchor_pos_b",
    "motion_ref_ori_b": "motion_anchor_ori_b",
    "velocity_commands": "velocity_commands",
}
"""`command` is a motion or a velocity, as `command_names` says."""
MOTION_COMMANDS = ("motion",)


def recognises(network: Network) -> bool:
    """Whether the file carries this metadata."""
    return "observation_names" in network.metadata and "joint_names" in network.metadata


def import_policy(ctx: ImportContext, network: Network) -> Draft:
    """Read one file.

    Raises:
        PolicyError: Names the field that is missing or contradicts.
    """
    meta, where = network.metadata, f"{network.path}:metadata"
    for key in NEEDED:
        if key not in meta and ctx.setting(key) is None:
            raise ctx.need(key, f"its metadata has {one_of(meta)}")
    names = csv_texts(meta["joint_names"])
    numbers = {
        key: csv_numbers(meta[key], f"{where}.{key}") if key in meta else ()
        for key in ("default_joint_pos", "joint_stiffness", "joint_damping", "action_scale")
    }
    scale: Any = numbers["action_scale"]
    scale = scale[0] if len(scale) == 1 else scale
    moved = joints(
        ctx,
        names,
        numbers["default_joint_pos"],
        numbers["joint_stiffness"],
        numbers["joint_damping"],
        scale,
        numbers["default_joint_pos"],
        where,
    )
    takes_time = "time_step" in network.inputs
    obs_input = next((name for name in network.inputs if name != "time_step"), "")
    tables = None
    motion = None
    if takes_time:
        width = network.width(obs_input)
        anchor = meta.get("anchor_body_name", "")
        bodies = csv_texts(meta.get("body_names", ""))
        tables = from_network(
            network, anchor, bodies, {obs_input: np.zeros((1, width), np.float32)}
        )
        motion = MotionSpec("motion.npz", len(tables["joint_pos"]), RATE_HZ, anchor)
    spec = PolicySpec(
        dialect="beyondmimic" if takes_time else "mjlab",
        inputs=(InputSpec(obs_input, _terms(ctx, network, bool(motion), where)),),
        action_output="actions" if "actions" in network.outputs else next(iter(network.outputs)),
        joint_names=moved.names,
        default_joint_pos=moved.default,
        action_scale=moved.scale,
        action_offset=moved.offset,
        joint_stiffness=moved.stiffness,
        joint_damping=moved.damping,
        held=held_joints(ctx, moved.names),
        time_step_input="time_step" if takes_time else "",
        motion=motion,
    )
    check_against_network(spec, network)
    if motion is not None:
        return Draft(spec, network.path, "tracking", motion.rows / RATE_HZ, tables)
    if not spec.takes_command:
        raise PolicyError(
            f"{network.path} follows neither a motion nor a velocity command; its terms are "
            f"{meta['observation_names']}."
        )
    return Draft(spec, network.path, "locomotion", 1.0, command=_ranges(ctx))


def _terms(
    ctx: ImportContext, network: Network, has_motion: bool, where: str
) -> tuple[TermSpec, ...]:
    meta = network.metadata
    commands = csv_texts(meta.get("command_names", ""))
    tracks = has_motion or any(name in MOTION_COMMANDS for name in commands)
    dialect = {**TERMS, "command": "motion_command" if tracks else "velocity_commands"}
    if tracks and not has_motion:
        raise PolicyError(
            f"{network.path} follows a motion but has no input 'time_step' to read one; its "
            f"inputs are {one_of(network.inputs)}."
        )
    names = csv_texts(meta["observation_names"])
    found = terms_from(names, dialect, {}, f"{where}.observation_names")
    lengths = meta.get("observation_history_lengths", "")
    if not lengths:
        return found
    counts = csv_numbers(lengths, f"{where}.observation_history_lengths")
    if len(counts) != len(found):
        raise PolicyError(
            f"{len(counts)} history lengths for {len(found)} terms "
            f"({where}.observation_history_lengths)."
        )
    return tuple(
        TermSpec(term.name, term.scale, term.clip, max(1, int(count)))
        for term, count in zip(found, counts, strict=True)
    )


def _ranges(ctx: ImportContext) -> Any:
    found = dict(zip(("vx", "vy", "yaw_rate"), VELOCITY_RANGES, strict=True))
    for key, value in found.items():
        ctx.infer(f"command.{key}", value, "built-in careful range, the file names none")
    return command_ranges(ctx, found, ("vx", "vy", "yaw_rate"))
