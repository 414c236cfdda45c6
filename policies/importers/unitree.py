"""unitree_rl_lab and unitree_rl_mjlab: params/deploy.yaml and exported/policy.onnx."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from downbeat.catalog.robot import load_g1
from downbeat.policies.errors import PolicyError
from downbeat.policies.importers.build import (
    Joints,
    check_against_network,
    command_ranges,
    held_joints,
    joints,
)
from downbeat.policies.importers.context import Draft, ImportContext
from downbeat.policies.importers.motion import RATE_HZ, csv_columns, from_csv, read_csv
from downbeat.policies.importers.network import Network, read_network
from downbeat.policies.importers.profiles import WINDOWS, MotionWindow
from downbeat.policies.importers.rl_gym import recurrent_pairs
from downbeat.policies.importers.safe_yaml import read_yaml
from downbeat.policies.importers.values import finite
from downbeat.policies.spec import GaitSpec, InputSpec, MotionSpec, PolicySpec, TermSpec
from downbeat.policies.terms import TERM_WIDTHS
from downbeat.runtime.errors import one_of

CONFIG = Path("params") / "deploy.yaml"
NETWORK = Path("exported") / "policy.onnx"
TERMS = {
    "joint_vel_rel": "joint_vel",
    "actions": "last_action",
    "phase": "gait_phase",
}
TICK_S = 0.02
RANGE_KEYS = ("lin_vel_x", "lin_vel_y", "ang_vel_z")


def recognises(folder: Path) -> bool:
    """Whether a folder has the authors' layout."""
    return (folder / CONFIG).is_file()


def import_policy(ctx: ImportContext, folder: Path) -> Draft:
    """Read one folder.

    Raises:
        PolicyError: Names the field that is missing or contradicts.
    """
    config = folder / CONFIG
    table = read_yaml(config)
    network = read_network(folder / NETWORK)
    for key in ("joint_ids_map", "stiffness", "damping", "default_joint_pos", "observations"):
        if key not in table:
            raise PolicyError(f"{config} lacks '{key}'; it has {one_of(table)}.")
    step = table.get("step_dt", TICK_S)
    if step != TICK_S:
        raise PolicyError(f"{config}:step_dt is {step}; control runs at {TICK_S} s.")
    moved = _joints(ctx, table, config)
    terms, gait = _terms(ctx, table, config, len(moved.names))
    inputs = {term.name for term in terms}
    motion, tables = None, None
    if any(name.startswith("motion") for name in inputs):
        tables = _motion(ctx, folder / "params", moved)
        motion = MotionSpec("motion.npz", len(tables["joint_pos"]), RATE_HZ, "torso_link")
    obs_input, action = _io_names(network, len(moved.names))
    clip = _action(table, config).get("clip")
    spec = PolicySpec(
        dialect="unitree",
        inputs=(InputSpec(obs_input, terms),),
        action_output=action,
        joint_names=moved.names,
        default_joint_pos=moved.default,
        action_scale=moved.scale,
        action_offset=moved.offset,
        joint_stiffness=moved.stiffness,
        joint_damping=moved.damping,
        held=held_joints(ctx, moved.names),
        recurrent=recurrent_pairs(network, obs_input, action),
        motion=motion,
        gait=gait,
    )
    if clip is not None:
        raise PolicyError(f"{config}: an action clip of {clip} is not supported; null is valid.")
    check_against_network(spec, network)
    if motion is not None:
        return Draft(spec, network.path, "tracking", motion.rows / RATE_HZ, tables)
    ranges = (table.get("commands") or {}).get("base_velocity", {}).get("ranges")
    command = command_ranges(ctx, ranges, RANGE_KEYS)
    period = gait.period_s if gait is not None else 1.0
    return Draft(spec, network.path, "locomotion", period, command=command)


def _action(table: Mapping[str, Any], config: Path) -> Mapping[str, Any]:
    actions = table.get("actions")
    if not isinstance(actions, Mapping) or "JointPositionAction" not in actions:
        names = one_of(actions) if isinstance(actions, Mapping) else "none"
        raise PolicyError(f"{config}:actions has {names}; JointPositionAction is valid.")
    found: Mapping[str, Any] = actions["JointPositionAction"]
    return found


def _joints(ctx: ImportContext, table: Mapping[str, Any], config: Path) -> Joints:
    """Gains stand in motor order, defaults and scales in the policy's order."""
    robot = load_g1().joint_names
    ids = [int(i) for i in finite(table["joint_ids_map"], f"{config}:joint_ids_map")]
    if any(not 0 <= i < len(robot) for i in ids) or len(set(ids)) != len(ids):
        raise PolicyError(
            f"{config}:joint_ids_map {ids} must hold different motor numbers 0..{len(robot) - 1}."
        )
    gains = {}
    for key in ("stiffness", "damping"):
        values = finite(table[key], f"{config}:{key}")
        if len(values) <= max(ids):
            raise PolicyError(
                f"{config}:{key} has {len(values)} values in motor order, joint_ids_map needs "
                f"{max(ids) + 1}."
            )
        gains[key] = [values[i] for i in ids]
    action = _action(table, config)
    for key in ("scale", "offset"):
        if action.get(key) is None:
            raise PolicyError(f"{config}: the action has no '{key}'.")
    return joints(
        ctx,
        [robot[i] for i in ids],
        table["default_joint_pos"],
        gains["stiffness"],
        gains["damping"],
        action["scale"],
        action["offset"],
        str(config),
    )


def _terms(
    ctx: ImportContext, table: Mapping[str, Any], config: Path, num_joints: int
) -> tuple[tuple[TermSpec, ...], GaitSpec | None]:
    found, gait = [], None
    observations = table["observations"]
    if not isinstance(observations, Mapping) or not observations:
        raise PolicyError(f"{config}:observations is not a table of terms.")
    for name, entry in observations.items():
        ours = TERMS.get(name, name)
        where = f"{config}:observations.{name}"
        if ours not in TERM_WIDTHS or not isinstance(entry, Mapping):
            known = one_of(sorted({*TERMS, *TERM_WIDTHS}))
            raise PolicyError(f"Observation term '{name}' is unknown; terms are {known} ({where}).")
        scale = entry.get("scale")
        clip = entry.get("clip")
        numbers = (1.0,) if scale is None else _scale(scale, where)
        low_high = None if clip is None else finite(clip, f"{where}.clip")
        if low_high is not None and len(low_high) != 2:
            raise PolicyError(f"{where}.clip {clip} is not [low, high].")
        history = entry.get("history_length", 1)
        if not isinstance(history, int) or isinstance(history, bool):
            raise PolicyError(f"{where}.history_length {history!r} is not a whole number.")
        found.append(
            TermSpec(
                ours, numbers, None if low_high is None else (low_high[0], low_high[1]), history
            )
        )
        if ours == "gait_phase":
            period = (entry.get("params") or {}).get("period")
            if period is None:
                raise ctx.need("gait.period_s", f"{where} has no params.period")
            gait = GaitSpec(finite([period], where)[0], start=TICK_S / float(period))
    return tuple(found), gait


def _scale(scale: Any, where: str) -> tuple[float, ...]:
    if isinstance(scale, int | float):
        return (float(scale),)
    numbers = finite(scale, f"{where}.scale")
    return (numbers[0],) if len(set(numbers)) == 1 else numbers


def _io_names(network: Network, num_joints: int) -> tuple[str, str]:
    recurrent = [name for name in network.inputs if name.endswith("_in")]
    plain = [name for name in network.inputs if name not in recurrent]
    actions = [name for name, shape in network.outputs.items() if shape[-1:] == (num_joints,)]
    if len(plain) != 1 or not actions:
        raise PolicyError(
            f"{network.path} has inputs {one_of(network.inputs)} and outputs "
            f"{one_of(network.outputs)}; one observation and {num_joints} actions are expected."
        )
    return plain[0], actions[0]


def _motion(ctx: ImportContext, folder: Path, moved: Joints) -> dict[str, Any]:
    named = ctx.setting("motion.file")
    files = sorted(folder.glob("*.csv"))
    if named is not None:
        files = [file for file in files if file.name == named]
    if len(files) != 1:
        names = one_of([file.name for file in folder.glob("*.csv")]) or "none"
        raise ctx.need("motion.file", f"{folder} has {names}")
    file = files[0]
    window = WINDOWS.get(file.stem)
    source = f"built-in window for {file.name}"
    if window is None:
        rate = 30.0 if "30hz" in file.stem.lower() else 60.0
        window, source = MotionWindow(0.0, None, rate), "the whole file"
    start = float(ctx.infer("motion.start_s", window.start_s, source))
    end = ctx.infer("motion.end_s", window.end_s, source)
    rate = float(ctx.infer("motion.rate_hz", window.rate_hz, f"name of {file.name}"))
    count = read_csv(file).shape[1] - 7
    columns = csv_columns(count, moved.names)
    if columns is None:
        raise PolicyError(
            f"{file} has {count} joint columns; {len(load_g1().joint_names)} (motor order) or "
            f"{len(moved.names)} (the policy's order) are valid."
        )
    order = "motor order" if count == len(load_g1().joint_names) else "the policy's order"
    ctx.inferred.append(f"motion columns = {count} joints in {order}: their number")
    return dict(
        from_csv(file, rate, start, None if end is None else float(end), columns, moved.names)
    )
