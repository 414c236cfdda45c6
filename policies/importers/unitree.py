"""unitree_rl_lab and unitree_rl_mjlab: params/deploy.yaml and exported/policy.onnx."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from downbeat.catalog.robot import load_g1
from downbeat.policies.errors import PolicyError
from downbeat.policies.importers.build import (
    TIME_STEP,
    Joints,
    action_output,
    check_against_network,
    command_ranges,
    held_joints,
    joints,
    recurrent_pairs,
)
from downbeat.policies.importers.context import Draft, ImportContext
from downbeat.policies.importers.motion_files import motion_beside
from downbeat.policies.importers.network import read_network
from downbeat.policies.importers.safe_yaml import read_yaml
from downbeat.policies.importers.unitree_terms import read_inputs
from downbeat.policies.importers.values import finite, short
from downbeat.policies.spec import PolicySpec
from downbeat.runtime.errors import one_of

CONFIG = Path("params") / "deploy.yaml"
NETWORK = Path("exported") / "policy.onnx"
NEEDED = (
    "joint_ids_map",
    "stiffness",
    "damping",
    "default_joint_pos",
    "actions",
    "observations",
)
TICK_S = 0.02
RANGE_KEYS = ("lin_vel_x", "lin_vel_y", "ang_vel_z")
ANCHOR = "torso_link"


def recognises(folder: Path) -> bool:
    """Whether a folder has the authors' layout."""
    return (folder / CONFIG).is_file()


def import_policy(ctx: ImportContext, folder: Path) -> Draft:
    """Read one folder.

    Raises:
        PolicyError: Names the field that is missing or contradicts.
    """
    config = folder / CONFIG
    table = read_yaml(config, folder)
    network = read_network(folder / NETWORK, folder)
    for key in NEEDED:
        if key not in table:
            raise PolicyError(f"{config} lacks '{key}'; it has {one_of(table)}.")
    step = table.get("step_dt", TICK_S)
    if step != TICK_S:
        raise PolicyError(f"{config}:step_dt is {short(step)}; control runs at {TICK_S} s.")
    moved = _joints(ctx, table, config)
    inputs, gait = read_inputs(ctx, table["observations"], network, config)
    action = action_output(network, len(moved.names))
    spec = PolicySpec(
        dialect="unitree",
        inputs=inputs,
        action_output=action,
        joint_names=moved.names,
        default_joint_pos=moved.default,
        action_scale=moved.scale,
        action_offset=moved.offset,
        joint_stiffness=moved.stiffness,
        joint_damping=moved.damping,
        held=held_joints(ctx, moved.names),
        recurrent=recurrent_pairs(network, (*(i.name for i in inputs), TIME_STEP), action),
        gait=gait,
    )
    if spec.needs_motion:
        ctx.note(f"motion.anchor_body = {ANCHOR}: the family's own deployment")
        tables = motion_beside(ctx, folder / "params", moved.names, ANCHOR)
        draft = Draft.tracking(spec, network.path, tables, ANCHOR)
        check_against_network(draft.spec, network)
        return draft
    check_against_network(spec, network)
    command = command_ranges(ctx, _ranges(table, config), RANGE_KEYS)
    period = gait.period_s if gait is not None else 1.0
    return Draft(spec, network.path, "locomotion", period, command=command)


def _ranges(table: Mapping[str, Any], config: Path) -> Mapping[str, Any] | None:
    found: Any = table
    for key in ("commands", "base_velocity", "ranges"):
        found = found.get(key)
        if found is None:
            return None
        if not isinstance(found, Mapping):
            raise PolicyError(f"{config}: '{key}' is {short(found)}, a table is expected.")
    ranges: Mapping[str, Any] = found
    return ranges


def _action(table: Mapping[str, Any], config: Path) -> Mapping[str, Any]:
    actions = table["actions"]
    names = list(actions) if isinstance(actions, Mapping) else []
    if names != ["JointPositionAction"] or not isinstance(actions[names[0]], Mapping):
        raise PolicyError(f"{config}:actions has {one_of(names)}; JointPositionAction is valid.")
    found: Mapping[str, Any] = actions["JointPositionAction"]
    return found


def _joints(ctx: ImportContext, table: Mapping[str, Any], config: Path) -> Joints:
    """Gains stand in motor order, defaults and scales in the policy's order."""
    robot = load_g1().joint_names
    ids = [int(i) for i in finite(table["joint_ids_map"], f"{config}:joint_ids_map")]
    if any(not 0 <= i < len(robot) for i in ids) or len(set(ids)) != len(ids) or not ids:
        raise PolicyError(
            f"{config}:joint_ids_map {ids} must hold different motor numbers 0..{len(robot) - 1}."
        )
    action = _action(table, config)
    _check_ids(action, len(ids), config)
    _check_clip(ctx, action, [robot[i] for i in ids], config)
    values = {}
    for key, neutral in (("scale", 1.0), ("offset", 0.0)):
        values[key] = action.get(key)
        if values[key] is None:
            values[key] = ctx.infer(f"action_{key}", neutral, f"{CONFIG.name} has null")
    return joints(
        ctx,
        [robot[i] for i in ids],
        table["default_joint_pos"],
        _gains(ctx, table, "stiffness", ids, config),
        _gains(ctx, table, "damping", ids, config),
        values["scale"],
        values["offset"],
        str(config),
    )


def _gains(
    ctx: ImportContext, table: Mapping[str, Any], key: str, ids: Sequence[int], config: Path
) -> list[float]:
    values = finite(table[key], f"{config}:{key}")
    if len(values) > max(ids):
        return [values[i] for i in ids]
    if len(values) == len(ids):
        ctx.note(f"{key} = in the policy's order: {len(values)} values cannot be motor order")
        return list(values)
    raise PolicyError(
        f"{config}:{key} has {len(values)} values; joint_ids_map needs at least {max(ids) + 1} in "
        f"motor order, or {len(ids)} in its own."
    )


def _check_ids(action: Mapping[str, Any], count: int, config: Path) -> None:
    """Refuse actions on some of the joints: which ones are then held is not said anywhere."""
    ids = action.get("joint_ids")
    if ids is None or ids == [None, None, None] or ids == list(range(count)):
        return
    raise PolicyError(
        f"{config}: the action's joint_ids are {short(ids)}; all {count} joints in order (null) "
        "are valid."
    )


def _check_clip(
    ctx: ImportContext, action: Mapping[str, Any], names: Sequence[str], config: Path
) -> None:
    """Accept a clip that cannot matter: one that is wider than the joints can move."""
    clip = action.get("clip")
    if clip is None:
        return
    where = f"{config}: the action's clip"
    if not isinstance(clip, list) or len(clip) != len(names):
        raise PolicyError(f"{where} {short(clip)} is not one [low, high] for each joint.")
    robot = load_g1()
    for name, pair in zip(names, clip, strict=True):
        low, high = (float(v) for v in robot.joint_range[robot.joint_index(name)])
        bounds = finite(pair, where)
        if len(bounds) != 2 or bounds[0] > low or bounds[1] < high:
            raise PolicyError(
                f"{where} holds {name} within {short(pair)}, less than its range {low:g}..{high:g};"
                " this is not supported, null is valid."
            )
    ctx.note("action clip = none: the one in deploy.yaml is wider than the joints can move")
