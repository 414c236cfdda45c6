"""What all importers share: the robot's joints, the joints a network leaves alone, the checks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from downbeat.catalog.robot import load_g1
from downbeat.policies.errors import PolicyError
from downbeat.policies.importers.context import ImportContext
from downbeat.policies.importers.network import Network
from downbeat.policies.importers.values import finite, spread
from downbeat.policies.spec import HeldJoints, InputSpec, PolicySpec, TermSpec
from downbeat.policies.spec_toml import check_spec
from downbeat.policies.terms import TERM_WIDTHS
from downbeat.runtime.errors import one_of

SCALAR_TERMS = "term scales"


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
    checked = check_names(names, where)
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
    return Joints(
        checked,
        values["default_joint_pos"],
        values["joint_stiffness"],
        values["joint_damping"],
        values["action_scale"],
        values["action_offset"],
    )


def held_joints(ctx: ImportContext, moved: Sequence[str]) -> HeldJoints:
    """Hold what the network leaves alone: our default pose with our gains."""
    robot = load_g1()
    names = tuple(name for name in robot.joint_names if name not in moved)
    if not names:
        return HeldJoints()
    index = [robot.joint_index(name) for name in names]
    ctx.inferred.append(
        f"held joints = {len(names)} ({names[0]} ... {names[-1]}): catalog/g1_facts.json, stand "
        "pose and gains"
    )
    return HeldJoints(
        names,
        tuple(float(robot.default_joint_pos[i]) for i in index),
        tuple(float(robot.joint_stiffness[i]) for i in index),
        tuple(float(robot.joint_damping[i]) for i in index),
    )


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


def one_input(network: Network, terms: tuple[TermSpec, ...], **options: Any) -> InputSpec:
    """Return the spec of the network's only observation input."""
    name = next(iter(network.inputs))
    return InputSpec(name, terms, **options)
