"""BeyondMimic and mjlab: one ONNX file with CSV strings in its metadata."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from downbeat.policies.errors import PolicyError
from downbeat.policies.importers.baked import anchored, read_baked
from downbeat.policies.importers.build import (
    TIME_STEP,
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
from downbeat.policies.importers.motion_files import motion_beside
from downbeat.policies.importers.network import Network
from downbeat.policies.importers.profiles import VELOCITY_RANGES
from downbeat.policies.importers.values import csv_numbers, csv_texts, name_list
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
NUMBERS = ("joint_stiffness", "joint_damping", "default_joint_pos", "action_scale")
TERMS: Mapping[str, str] = {
    "joint_pos": "joint_pos_rel",
    "joint_vel": "joint_vel",
    "joint_vel_rel": "joint_vel",
    "actions": "last_action",
    "motion_ref_pos_b": "motion_anchor_pos_b",
    "motion_ref_ori_b": "motion_anchor_ori_b",
    "velocity_commands": "velocity_commands",
}
"""`command` is a motion or a velocity, as `command_names` says."""
MOTION_COMMAND = "motion"


def recognises(network: Network) -> bool:
    """Whether the file carries metadata of this kind, complete or not."""
    return len({*NEEDED, "command_names"} & set(network.metadata)) >= 2


def import_policy(ctx: ImportContext, network: Network) -> Draft:
    """Read one file.

    Raises:
        PolicyError: Names the field that is missing or contradicts.
    """
    where = f"{network.path}:metadata"
    values = {key: _value(ctx, network, key) for key in NEEDED}
    moved = joints(
        ctx,
        values["joint_names"],
        values["default_joint_pos"],
        values["joint_stiffness"],
        values["joint_damping"],
        values["action_scale"],
        values["default_joint_pos"],
        where,
    )
    obs, action = obs_input(network), action_output(network, len(moved.names))
    terms = _terms(ctx, network, values["observation_names"], where)
    takes_time = TIME_STEP in network.inputs
    spec = PolicySpec(
        dialect="beyondmimic" if takes_time else "mjlab",
        inputs=(InputSpec(obs, terms),),
        action_output=action,
        joint_names=moved.names,
        default_joint_pos=moved.default,
        action_scale=moved.scale,
        action_offset=moved.offset,
        joint_stiffness=moved.stiffness,
        joint_damping=moved.damping,
        held=held_joints(ctx, moved.names),
        time_step_input=TIME_STEP if takes_time else "",
        recurrent=recurrent_pairs(network, (obs, TIME_STEP), action),
        motion=MotionSpec("motion.npz", 2, RATE_HZ, "torso_link") if _tracks(terms) else None,
    )
    check_against_network(spec, network)
    if spec.motion is not None:
        anchor = _anchor(ctx, network)
        if takes_time:
            tables = _baked(ctx, network, anchor)
        else:
            tables = motion_beside(ctx, network.path.parent, moved.names, anchor)
        return Draft.tracking(spec, network.path, tables, anchor)
    if not spec.takes_command:
        raise PolicyError(
            f"{network.path} follows neither a motion nor a velocity command; its terms are "
            f"{one_of(values['observation_names'])} ({where}.observation_names)."
        )
    return Draft(spec, network.path, "locomotion", 1.0, command=_ranges(ctx))


def _value(ctx: ImportContext, network: Network, key: str) -> Any:
    """Return a field as the file has it, or what the user set."""
    meta, where = network.metadata, f"{network.path}:metadata.{key}"
    given = ctx.setting(key)
    if given is not None:
        # `joints` asks again and says that it was set; the observation names are only asked here.
        if key == "observation_names":
            ctx.infer(key, given, "--set")
        return given if key in NUMBERS else name_list(given, f"--set {key}")
    if key not in meta:
        raise ctx.need(key, f"its metadata has {one_of(meta)}")
    if key not in NUMBERS:
        return csv_texts(meta[key])
    numbers = csv_numbers(meta[key], where)
    return numbers[0] if len(numbers) == 1 else numbers


def _anchor(ctx: ImportContext, network: Network) -> str:
    found = network.metadata.get("anchor_body_name")
    given = ctx.setting("anchor_body_name")
    if given is None and found is None:
        raise ctx.need("anchor_body_name", "torso_link and pelvis are valid")
    anchor = str(ctx.found("anchor_body_name", found))
    if anchor not in ("torso_link", "pelvis"):
        raise PolicyError(
            f"Anchor body '{anchor}' cannot be tracked; valid are torso_link and pelvis "
            f"({network.path}:metadata.anchor_body_name)."
        )
    return anchor


def _baked(ctx: ImportContext, network: Network, anchor: str) -> Tables:
    bodies = csv_texts(network.metadata.get("body_names", ""))
    if anchor not in bodies:
        raise PolicyError(
            f"Anchor body '{anchor}' of {network.path} is not among its bodies {one_of(bodies)} "
            "(metadata: anchor_body_name, body_names)."
        )
    tables = read_baked(network, ("joint_pos", "joint_vel", "body_pos_w", "body_quat_w"))
    if tables["body_pos_w"].shape[1:] != (len(bodies), 3):
        raise PolicyError(
            f"The motion in {network.path} has bodies {tables['body_pos_w'].shape[1:]}, its "
            f"metadata names {len(bodies)} (body_names)."
        )
    index = bodies.index(anchor)
    ctx.note(f"motion.rate_hz = {RATE_HZ:g}: one baked row a tick, as the format is played")
    quats = np.ascontiguousarray(tables["body_quat_w"][:, index])
    return anchored(tables, tables["body_pos_w"][:, index], quats, str(network.path))


def _tracks(terms: tuple[TermSpec, ...]) -> bool:
    return any(term.name.startswith("motion_") for term in terms)


def _terms(
    ctx: ImportContext, network: Network, names: tuple[str, ...], where: str
) -> tuple[TermSpec, ...]:
    meta = network.metadata
    commands = csv_texts(meta.get("command_names", ""))
    tracks = TIME_STEP in network.inputs or any(MOTION_COMMAND in name for name in commands)
    if "command" in names and "command_names" not in meta:
        meaning = "a motion" if tracks else "a velocity"
        ctx.note(f"command = {meaning}: its inputs are {', '.join(network.inputs)}")
    dialect = {**TERMS, "command": "motion_command" if tracks else "velocity_commands"}
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
    if max(counts) > 1:
        ctx.note("history = oldest first, by term, filled with the first sample: Isaac Lab's way")
    return tuple(
        TermSpec(term.name, term.scale, term.clip, max(1, int(count)))
        for term, count in zip(found, counts, strict=True)
    )


def _ranges(ctx: ImportContext) -> Any:
    found = dict(zip(("vx", "vy", "yaw_rate"), VELOCITY_RANGES, strict=True))
    for key, value in found.items():
        ctx.infer(f"command.{key}", value, "built-in careful range, the file names none")
    return command_ranges(ctx, found, ("vx", "vy", "yaw_rate"))
