"""What all importers share: the robot's joints, the joints a network leaves alone, the checks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from downbeat.catalog.robot import load_g1
from downbeat.policies.errors import PolicyError
from downbeat.policies.importers.context import ImportContext
from downbeat.policies.importers.network import Network
from downbeat.policies.importers.profiles import HELD_DAMPING, HELD_STIFFNESS, LEGS
from downbeat.policies.importers.values import finite, name_list, spread
from downbeat.policies.spec import (
    HeldJoints,
    PolicySpec,
    RecurrentSpec,
    TermSpec,
)
from downbeat.policies.spec_toml import check_spec
from downbeat.policies.terms import TERM_WIDTHS
from downbeat.runtime.errors import one_of

POSE_TOLERANCE_RAD = 0.5
"""A default pose this far beyond a joint's range belongs to another robot or another order."""
TIME_STEP = "time_step"


@dataclass(frozen=True)
class Joints:
    """The joints that a network moves, in its order."""

    names: tuple[str, ...]
    default: tuple[float, ...]
    stiffness: tuple[float, ...]
    damping: tuple[float, ...]
    scale: tuple[float, ...]
    offset: tuple[float, ...]


def check_names(names: Sequence[str], where: str) -> tuple[str, ...]:
    """Return the joint names if the robot has them all.

    Raises:
        PolicyError: Names the joint and those the robot has.
    """
    robot = load_g1().joint_names
    for name in names:
        if name not in robot:
            raise PolicyError(
                f"Joint '{name}' is unknown; the robot has {one_of(robot)} ({where})."
            )
    return tuple(names)


def joints(
    ctx: ImportContext,
    names: Sequence[str],
    default: Any,
    stiffness: Any,
    damping: Any,
    scale: Any,
    offset: Any,
    where: str,
) -> Joints:
    """Check and collect the joint arrays; `--set` may replace each of them."""
    named = name_list(ctx.found("joint_names", names), f"{where}:joint_names")
    checked = check_names(named, where)
    count = len(checked)
    table = {
        "default_joint_pos": default,
        "joint_stiffness": stiffness,
        "joint_damping": damping,
        "action_scale": scale,
        "action_offset": offset,
    }
    values = {
        key: spread(ctx.found(key, value), count, f"{where}:{key}") for key, value in table.items()
    }
    _check_pose(checked, values["default_joint_pos"], where)
    return Joints(
        checked,
        values["default_joint_pos"],
        values["joint_stiffness"],
        values["joint_damping"],
        values["action_scale"],
        values["action_offset"],
    )


def _check_pose(names: Sequence[str], default: Sequence[float], where: str) -> None:
    robot = load_g1()
    for name, value in zip(names, default, strict=True):
        low, high = (float(v) for v in robot.joint_range[robot.joint_index(name)])
        if not low - POSE_TOLERANCE_RAD <= value <= high + POSE_TOLERANCE_RAD:
            raise PolicyError(
                f"The default pose has {name} at {value:g} rad; the joint's range is {low:g}.."
                f"{high:g} ({where}:default_joint_pos)."
            )


def recurrent_pairs(network: Network, fed: Sequence[str], action: str) -> tuple[RecurrentSpec, ...]:
    """Pair recurrent inputs with outputs by name (h_in, h_out) and shape.

    Args:
        network: The file.
        fed: Inputs that are fed with something else.
        action: Output with the actions.

    Raises:
        PolicyError: An input has no output.
    """
    pairs = []
    for name, shape in network.inputs.items():
        if name in fed:
            continue
        twin = name.removesuffix("_in") + "_out"
        if not name.endswith("_in") or twin == action or network.outputs.get(twin) != shape:
            raise PolicyError(
                f"Nothing is known about input '{name}' {list(shape)} of {network.path}: it has no "
                f"output of its shape to be fed back from (h_in from h_out); outputs are "
                f"{one_of(network.outputs)}."
            )
        pairs.append(RecurrentSpec(name, twin, shape))
    return tuple(pairs)


def obs_input(network: Network) -> str:
    """Return the name of the only input that carries observations.

    Raises:
        PolicyError: There is none, or there are several.
    """
    names = [n for n in network.inputs if n != TIME_STEP and not n.endswith("_in")]
    if len(names) != 1 and "obs" in names:
        return "obs"
    if len(names) != 1:
        raise PolicyError(
            f"{network.path} has inputs {one_of(network.inputs)}; exactly one observation is "
            "expected."
        )
    return names[0]


def action_output(network: Network, num_joints: int) -> str:
    """Return the name of the output with the actions: `actions`, `action`, or the only one.

    Raises:
        PolicyError: None has a width of `num_joints`.
    """
    wide = [name for name, shape in network.outputs.items() if shape[-1:] == (num_joints,)]
    for name in ("actions", "action", *wide):
        if name in wide:
            return name
    found = ", ".join(f"{name} {list(shape)}" for name, shape in network.outputs.items())
    raise PolicyError(
        f"{network.path} has outputs {found}; one of {num_joints} actions is expected for its "
        f"{num_joints} joints."
    )


def held_joints(ctx: ImportContext, moved: Sequence[str]) -> HeldJoints:
    """Hold what the network leaves alone, as stiff as on a robot that lacks these joints."""
    robot = load_g1()
    names = tuple(name for name in robot.joint_names if name not in moved)
    if not names:
        return HeldJoints()
    index = [robot.joint_index(name) for name in names]
    pose = [
        float(robot.default_joint_pos[i]) if robot.joint_names[i] in LEGS else 0.0 for i in index
    ]
    values = {
        "held.joint_pos": (pose, "zero, where models of fewer joints have them fixed"),
        "held.joint_stiffness": ([HELD_STIFFNESS[i] for i in index], "unitree_rl_gym's hardware"),
        "held.joint_damping": (
            [HELD_DAMPING[i] for i in index],
            "unitree_rl_gym's hardware, the waist three times that",
        ),
    }
    ctx.note(f"held joints = {', '.join(names)}: the network does not move them")
    pos, stiffness, damping = (
        spread(ctx.infer(key, value, source), len(names), f"--set {key}")
        for key, (value, source) in values.items()
    )
    return HeldJoints(names, pos, stiffness, damping)


def terms_from(
    names: Sequence[str], dialect: Mapping[str, str], scales: Mapping[str, float], where: str
) -> tuple[TermSpec, ...]:
    """Translate the terms of a dialect into ours.

    Raises:
        PolicyError: A term is not known to the dialect.
    """
    found = []
    for name in names:
        ours = dialect.get(name, name)
        if ours not in TERM_WIDTHS:
            raise PolicyError(
                f"Observation term '{name}' is unknown; terms of this format are "
                f"{one_of(sorted({*dialect, *TERM_WIDTHS}))} ({where})."
            )
        found.append(TermSpec(ours, (float(scales.get(name, 1.0)),)))
    return tuple(found)


def check_against_network(spec: PolicySpec, network: Network) -> PolicySpec:
    """Check a finished spec by itself and against the network's shapes.

    Raises:
        PolicyError: Names what contradicts what.
    """
    where = f"{network.path}:policy"
    check_spec(spec, where)
    n = spec.num_joints
    for one in spec.inputs:
        wanted = one.width(n)
        if network.width(one.name) == 0:
            raise PolicyError(
                f"Input '{one.name}' of {network.path} has no fixed width; its terms are {wanted}, "
                "export it with that."
            )
        if network.width(one.name) != wanted:
            parts = ", ".join(f"{t.name} {t.width(n) * t.history}" for t in one.terms)
            raise PolicyError(
                f"Input '{one.name}' of {network.path} takes {network.width(one.name)} numbers, "
                f"but its terms are {wanted} ({parts})."
            )
    if network.width(spec.action_output) != n:
        raise PolicyError(
            f"Output '{spec.action_output}' of {network.path} has "
            f"{network.width(spec.action_output)} numbers, but {n} joints are named."
        )
    fed = {one.name for one in spec.inputs} | {r.input for r in spec.recurrent}
    fed |= {spec.time_step_input} if spec.time_step_input else set()
    if fed != set(network.inputs):
        missing = sorted(set(network.inputs) ^ fed)
        raise PolicyError(
            f"{network.path} has inputs {one_of(network.inputs)}; nothing is known about "
            f"'{missing[0]}'."
        )
    return spec


def command_ranges(ctx: ImportContext, found: Mapping[str, Any] | None, keys: Sequence[str]) -> Any:
    """Return ((vx), (vy), (yaw_rate)) ranges from a mapping, or what the user set."""
    ranges = []
    for ours, theirs in zip(("vx", "vy", "yaw_rate"), keys, strict=True):
        value = ctx.setting(f"command.{ours}")
        if value is None:
            value = (found or {}).get(theirs)
        if value is None:
            raise ctx.need(f"command.{ours}", "a range [low, high]")
        low_high = finite(value, f"{ctx.path}:{theirs}")
        if len(low_high) != 2 or not low_high[0] <= 0.0 <= low_high[1]:
            raise PolicyError(
                f"{theirs} {low_high} is not a range [low, high] around 0 ({ctx.path})."
            )
        ranges.append((low_high[0], low_high[1]))
    return tuple(ranges)
