"""The `observations` of a deploy.yaml: one input or several, histories, scales, clips."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from downbeat.policies.errors import PolicyError
from downbeat.policies.importers.build import TIME_STEP
from downbeat.policies.importers.context import ImportContext
from downbeat.policies.importers.network import Network
from downbeat.policies.importers.values import finite, positive, short
from downbeat.policies.spec import GaitSpec, InputSpec, TermSpec
from downbeat.policies.terms import TERM_WIDTHS
from downbeat.runtime.errors import one_of

TERMS = {
    "joint_vel_rel": "joint_vel",
    "actions": "last_action",
    "phase": "gait_phase",
    "keyboard_velocity_commands": "velocity_commands",
}
FLAGS = ("scale_first", "use_gym_history")
KEYS = {"params", "clip", "scale", "history_length"}
TICK_S = 0.02


def read_inputs(
    ctx: ImportContext, table: Any, network: Network, config: Path
) -> tuple[tuple[InputSpec, ...], GaitSpec | None]:
    """Read the observations.

    Terms stand there directly, or in groups that have the names of the network's inputs.

    Raises:
        PolicyError: Names the term and the field.
    """
    where = f"{config}:observations"
    if not isinstance(table, Mapping) or not table:
        raise PolicyError(f"{where} is not a table of terms.")
    plain = [n for n in network.inputs if n != TIME_STEP and not n.endswith("_in")]
    groups = {name: entry for name, entry in table.items() if name in plain}
    if not groups:
        if len(plain) != 1:
            raise PolicyError(
                f"{network.path} has inputs {one_of(plain)}; {where} needs a group of terms for "
                "each."
            )
        groups = {plain[0]: table}
    elif set(groups) != set(plain) or set(table) - set(groups) - set(FLAGS):
        raise PolicyError(
            f"{where} has groups {one_of(table)}; the network's inputs are {one_of(plain)}."
        )
    common = {name: table[name] for name in FLAGS if name in table}
    inputs, gaits = [], []
    for name, group in groups.items():
        if not isinstance(group, Mapping):
            raise PolicyError(f"{where}.{name} is not a table of terms.")
        found, gait = _read_group(ctx, name, {**common, **group}, where)
        inputs.append(found)
        gaits += [gait] if gait is not None else []
    if len(set(gaits)) > 1:
        raise PolicyError(f"{where} has gait phases of different periods.")
    if any(term.history > 1 for one in inputs for term in one.terms):
        ctx.note("history = oldest first, filled with the first sample: the family's deployment")
    return tuple(inputs), gaits[0] if gaits else None


def _read_group(
    ctx: ImportContext, name: str, group: Mapping[str, Any], where: str
) -> tuple[InputSpec, GaitSpec | None]:
    for flag in FLAGS:
        if not isinstance(group.get(flag, False), bool):
            raise PolicyError(f"{where}.{flag} {short(group[flag])} is neither true nor false.")
    terms, gait = [], None
    for term, entry in group.items():
        if term in FLAGS:
            continue
        inside = f"{where}.{term}"
        found = _term(str(term), entry, bool(group.get("scale_first", False)), inside)
        if found.name == "gait_phase":
            gait = _gait(ctx, entry, inside)
        terms.append(found)
    layout = "frame" if group.get("use_gym_history", False) else "term"
    return InputSpec(name, tuple(terms), history_layout=layout), gait


def _term(name: str, entry: Any, scale_first: bool, where: str) -> TermSpec:
    ours = TERMS.get(name, name)
    if ours not in TERM_WIDTHS:
        known = one_of(sorted({*TERMS, *TERM_WIDTHS}))
        raise PolicyError(f"Observation term '{name}' is unknown; terms are {known} ({where}).")
    if not isinstance(entry, Mapping):
        raise PolicyError(f"{where} is {short(entry)}; a table with {one_of(KEYS)} is expected.")
    params = entry.get("params") or {}
    if not isinstance(params, Mapping):
        raise PolicyError(f"{where}.params is {short(params)}, a table is expected.")
    _check_joints(params, where)
    history = entry.get("history_length", 1)
    if not isinstance(history, int) or isinstance(history, bool):
        raise PolicyError(f"{where}.history_length {short(history)} is not a whole number.")
    scale = _scale(entry.get("scale"), where)
    return TermSpec(ours, scale, _clip(entry.get("clip"), scale, scale_first, where), history or 1)


def _check_joints(params: Mapping[str, Any], where: str) -> None:
    asset = params.get("asset_cfg")
    ids = asset.get("joint_ids") if isinstance(asset, Mapping) else None
    if ids is not None and ids != [None, None, None] and ids != list(range(len(ids))):
        raise PolicyError(
            f"{where}.params.asset_cfg.joint_ids picks some joints; a term of all joints (null) is "
            "valid."
        )


def _scale(scale: Any, where: str) -> tuple[float, ...]:
    if scale is None:
        return (1.0,)
    if isinstance(scale, int | float):
        return finite([scale], f"{where}.scale")
    numbers = finite(scale, f"{where}.scale")
    return (numbers[0],) if len(set(numbers)) == 1 else numbers


def _clip(
    clip: Any, scale: tuple[float, ...], scale_first: bool, where: str
) -> tuple[float, float] | None:
    """Return the clip as it is before scaling."""
    if clip is None:
        return None
    bounds = finite(clip, f"{where}.clip")
    if len(bounds) != 2 or not bounds[0] < bounds[1]:
        raise PolicyError(f"{where}.clip {short(clip)} is not [low, high].")
    if not scale_first:
        return bounds[0], bounds[1]
    if len(scale) != 1 or not scale[0] > 0.0:
        raise PolicyError(f"{where}: scale_first with a clip needs one positive scale.")
    return bounds[0] / scale[0], bounds[1] / scale[0]


def _gait(ctx: ImportContext, entry: Mapping[str, Any], where: str) -> GaitSpec:
    period = (entry.get("params") or {}).get("period")
    given = ctx.setting("gait.period_s")
    if period is None and given is None:
        raise ctx.need("gait.period_s", f"{where} has no params.period")
    found = positive(ctx.found("gait.period_s", period), f"{where}.params.period")
    return GaitSpec(found, start=TICK_S / found)
