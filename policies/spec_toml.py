"""`PolicySpec` to and from the `[policy]` table; the loader is strict and checks sizes."""

from __future__ import annotations

import types
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from downbeat.policies.errors import PolicyError
from downbeat.policies.spec import PolicySpec
from downbeat.policies.terms import TERM_WIDTHS
from downbeat.policies.toml_fields import check_keys, integer, number
from downbeat.runtime.errors import one_of

MAX_INPUT_WIDTH = 8192
MAX_HISTORY = 100
MAX_MOTION_ROWS = 100_000
"""Bounds on what a file may ask for; the largest public policy is far below."""


def spec_to_table(spec: PolicySpec) -> dict[str, Any]:
    """Return the `[policy]` table; values that equal their default are left out."""
    table: dict[str, Any] = _to_table(spec)
    return table


def _to_table(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        out: dict[str, Any] = {}
        for field in fields(value):
            item = getattr(value, field.name)
            if item is None or (field.default is not MISSING and item == field.default):
                continue
            out[field.name] = _to_table(item)
        return out
    if isinstance(value, tuple):
        return [_to_table(item) for item in value]
    return value


def spec_from_table(table: Any, where: str) -> PolicySpec:
    """Build a `PolicySpec` from a parsed `[policy]` table.

    Args:
        table: The table.
        where: file:key for errors.

    Raises:
        PolicyError: A key is unknown, missing or of the wrong type, or sizes contradict each other.
    """
    spec: PolicySpec = _from_table(PolicySpec, table, where)
    check_spec(spec, where)
    return spec


def _from_table(cls: type, table: Any, where: str) -> Any:
    known = {field.name for field in fields(cls)}
    needed = {
        field.name
        for field in fields(cls)
        if field.default is MISSING and field.default_factory is MISSING
    }
    check_keys(table, known, needed, where)
    hints = get_type_hints(cls)
    return cls(**{key: _convert(hints[key], item, f"{where}.{key}") for key, item in table.items()})


def _convert(hint: Any, value: Any, where: str) -> Any:
    origin = get_origin(hint)
    if origin in (types.UnionType, Union):
        inner = next(arg for arg in get_args(hint) if arg is not type(None))
        return _convert(inner, value, where)
    if origin is Literal:
        if value not in get_args(hint):
            raise PolicyError(
                f"{value!r} is unknown; valid are {one_of(get_args(hint))} ({where})."
            )
        return value
    if origin is tuple:
        return _convert_tuple(get_args(hint), value, where)
    if is_dataclass(hint) and isinstance(hint, type):
        return _from_table(hint, value, where)
    if hint is bool and isinstance(value, bool):
        return value
    if hint is float:
        return number(value, where)
    if hint is int:
        return integer(value, where)
    if hint is str and isinstance(value, str):
        return value
    wanted = "true or false" if hint is bool else "text"
    raise PolicyError(f"{value!r} is not {wanted} ({where}).")


def _convert_tuple(args: tuple[Any, ...], value: Any, where: str) -> tuple[Any, ...]:
    if not isinstance(value, list):
        raise PolicyError(f"{value!r} is not a list ({where}).")
    if len(args) == 2 and args[1] is Ellipsis:
        return tuple(_convert(args[0], item, f"{where}[{i}]") for i, item in enumerate(value))
    if len(value) != len(args):
        raise PolicyError(f"{value!r} is not a list of {len(args)} ({where}).")
    return tuple(_convert(arg, item, where) for arg, item in zip(args, value, strict=True))


def check_spec(spec: PolicySpec, where: str) -> None:
    """Check what belongs together.

    Raises:
        PolicyError: One sentence naming the field and what would be valid.
    """
    n = spec.num_joints
    for name in (
        "default_joint_pos",
        "action_scale",
        "action_offset",
        "joint_stiffness",
        "joint_damping",
    ):
        _check_length(getattr(spec, name), n, name, where)
    held = spec.held
    for name in ("joint_pos", "joint_stiffness", "joint_damping"):
        _check_length(getattr(held, name), len(held.joint_names), f"held.{name}", where)
    _check_joints((*spec.joint_names, *held.joint_names), where)
    for name, gains in (
        ("joint_stiffness", (*spec.joint_stiffness, *held.joint_stiffness)),
        ("joint_damping", (*spec.joint_damping, *held.joint_damping)),
    ):
        if any(not 0.0 <= gain <= 1000.0 for gain in gains):
            raise PolicyError(f"A gain is outside 0..1000 ({where}.{name}).")
    _check_inputs(spec, where)
    if spec.needs_motion and spec.motion is None:
        raise PolicyError(f"Motion terms need a reference motion; none is given ({where}.motion).")
    if spec.motion is not None and not 2 <= spec.motion.rows <= MAX_MOTION_ROWS:
        raise PolicyError(
            f"A motion of {spec.motion.rows} rows is not possible; valid are 2..{MAX_MOTION_ROWS} "
            f"({where}.motion.rows)."
        )
    knows_length = spec.motion is not None or 0.0 < spec.phase_duration_s < MAX_MOTION_ROWS
    if "motion_phase" in spec.term_names and not knows_length:
        raise PolicyError(
            "Term 'motion_phase' needs a reference motion or its length "
            f"({where}.phase_duration_s)."
        )
    if spec.needs_gait and (spec.gait is None or not spec.gait.period_s > 0.0):
        raise PolicyError(f"Gait terms need a gait clock; none is given ({where}.gait).")


def _check_length(values: tuple[float, ...], wanted: int, name: str, where: str) -> None:
    if len(values) != wanted:
        raise PolicyError(f"{len(values)} values for {wanted} joints ({where}.{name}).")


def _check_joints(names: tuple[str, ...], where: str) -> None:
    from downbeat.catalog.robot import load_g1

    robot = load_g1().joint_names
    unknown = [name for name in names if name not in robot]
    if unknown:
        raise PolicyError(
            f"Joint '{unknown[0]}' is unknown; joints are {one_of(robot)} ({where}.joint_names)."
        )
    if len(set(names)) != len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise PolicyError(f"Joint '{twice}' is listed twice ({where}.joint_names).")
    missing = [name for name in robot if name not in names]
    if missing:
        raise PolicyError(
            f"Joint '{missing[0]}' is neither moved nor held; list it ({where}.held.joint_names)."
        )


def _check_inputs(spec: PolicySpec, where: str) -> None:
    for one in spec.inputs:
        inside = f"{where}.inputs.{one.name}"
        for term in one.terms:
            if term.name not in TERM_WIDTHS:
                raise PolicyError(
                    f"Observation term '{term.name}' is unknown; terms are {one_of(TERM_WIDTHS)} "
                    f"({inside})."
                )
            width = term.width(spec.num_joints)
            if len(term.scale) not in (1, width):
                raise PolicyError(
                    f"Term '{term.name}' has {len(term.scale)} scales for {width} elements "
                    f"({inside})."
                )
            if not 1 <= term.history <= MAX_HISTORY:
                raise PolicyError(
                    f"Term '{term.name}' has a history of {term.history}; "
                    f"valid are 1..{MAX_HISTORY} ({inside})."
                )
        lengths = {term.history for term in one.terms}
        if one.history_layout == "frame" and len(lengths) > 1:
            raise PolicyError(f"Histories by frame need one length for all terms ({inside}).")
        if one.width(spec.num_joints) > MAX_INPUT_WIDTH:
            raise PolicyError(f"Input '{one.name}' is wider than {MAX_INPUT_WIDTH} ({inside}).")
