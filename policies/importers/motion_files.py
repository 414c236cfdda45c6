"""Which motion file belongs to a policy, which part of it is played, and at which rate."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from downbeat.catalog.robot import load_g1
from downbeat.policies.errors import PolicyError
from downbeat.policies.importers.context import ImportContext
from downbeat.policies.importers.motion import (
    Source,
    Tables,
    csv_columns,
    csv_source,
    npz_source,
    read_csv,
    resample,
)
from downbeat.policies.importers.profiles import WINDOWS
from downbeat.policies.importers.safe_yaml import read_yaml
from downbeat.policies.importers.values import finite
from downbeat.runtime.errors import one_of

RATE_IN_NAME = re.compile(r"(\d{2,3})\s*_?(?:hz|fps)", re.IGNORECASE)
CONFIG_NAME = "config.yaml"
LEVELS_UP = 4
"""The author's config.yaml lies beside the folder `policy` that holds all policies."""


@dataclass(frozen=True)
class _Window:
    """What is known about how a file is played; None: not known.

    Attributes:
        start_s, end_s: [s].
        rate_hz: Rows per second.
        source: From where.
    """

    start_s: float = 0.0
    end_s: float | None = None
    rate_hz: float | None = None
    source: str = "the whole file"


def motion_beside(
    ctx: ImportContext, folder: Path, joint_names: Sequence[str], anchor: str
) -> Tables:
    """Return the motion whose file lies in `folder`.

    Args:
        ctx: The import.
        folder: Where the author puts the motion.
        joint_names: Joints of the policy, in its order.
        anchor: "torso_link" or "pelvis".

    Raises:
        PolicyError: There is none, there are several, or it does not fit.
    """
    file = _file(ctx, folder)
    window = _window(ctx, folder, file)
    source = _source(ctx, file, folder, joint_names, window)
    start = _number(ctx, "motion.start_s", window.start_s, window.source)
    end = _number(ctx, "motion.end_s", window.end_s, window.source)
    return resample(source, start or 0.0, end, joint_names, anchor)


def _file(ctx: ImportContext, folder: Path) -> Path:
    files = sorted([*folder.glob("*.csv"), *folder.glob("*.npz")])
    named = ctx.setting("motion.file")
    chosen = files if named is None else [file for file in files if file.name == str(named)]
    if len(chosen) != 1:
        raise ctx.need("motion.file", f"{folder} has {one_of(file.name for file in files)}")
    if len(files) > 1:
        ctx.note(f"motion.file = {chosen[0].name}: --set")
    return chosen[0]


def _source(
    ctx: ImportContext, file: Path, folder: Path, joint_names: Sequence[str], window: _Window
) -> Source:
    if file.suffix == ".npz":
        return npz_source(file, folder, joint_names)
    table = read_csv(file, folder)
    count = table.shape[1] - 7
    columns = csv_columns(count, joint_names)
    robot = load_g1().joint_names
    if columns is None:
        raise PolicyError(
            f"{file} has {count} joint columns; {len(robot)} (motor order) or {len(joint_names)} "
            "(the policy's order) are valid."
        )
    order = "motor order" if count == len(robot) else "the policy's order"
    ctx.note(f"motion columns = {count} joints in {order}: their number")
    return csv_source(table, file, _rate(ctx, file, window), columns)


def _rate(ctx: ImportContext, file: Path, window: _Window) -> float:
    named = RATE_IN_NAME.search(file.stem)
    if window.rate_hz is not None:
        rate, source = window.rate_hz, window.source
    elif named is not None:
        rate, source = float(named.group(1)), f"name of {file.name}"
    elif ctx.setting("motion.rate_hz") is not None:
        rate, source = 0.0, "--set"
    else:
        raise ctx.need("motion.rate_hz", "published files have 30 or 60 rows per second")
    found = _number(ctx, "motion.rate_hz", rate, source) or 0.0
    if not 1.0 <= found <= 1000.0:
        raise PolicyError(f"A motion at {found:g} Hz is not possible; 1..1000 is valid ({file}).")
    return found


def _number(ctx: ImportContext, key: str, value: float | None, source: str) -> float | None:
    found = ctx.infer(key, "end of the file" if value is None else value, source)
    return None if found == "end of the file" else finite([found], f"--set {key}")[0]


def _window(ctx: ImportContext, folder: Path, file: Path) -> _Window:
    name, window = ctx.pick(WINDOWS, _profile_for(file))
    if window is not None and ctx.profile:
        return _Window(window.start_s, window.end_s, window.rate_hz, f"built-in profile {name}")
    authors = _authors_window(folder, file)
    if authors is not None:
        return authors
    if window is not None:
        return _Window(window.start_s, window.end_s, window.rate_hz, f"built-in profile {name}")
    return _Window()


def _profile_for(file: Path) -> str:
    return next((name for name, window in WINDOWS.items() if window.file == file.name), "")


def _authors_window(folder: Path, file: Path) -> _Window | None:
    """Look into the author's state machine, which says what part of the file is played."""
    policy = folder.parent if folder.name == "params" else folder
    for above in list(policy.resolve().parents)[:LEVELS_UP]:
        config = above / CONFIG_NAME
        if not config.is_file() or not (above / "policy").is_dir():
            continue
        states = read_yaml(config).get("FSM")
        for name, state in states.items() if isinstance(states, Mapping) else ():
            if isinstance(state, Mapping) and _belongs(state, policy, file):
                return _from_state(state, f"the author's {CONFIG_NAME}, FSM.{name}", config)
    return None


def _belongs(state: Mapping[Any, Any], policy: Path, file: Path) -> bool:
    folder, motion = str(state.get("policy_dir", "")), str(state.get("motion_file", ""))
    return Path(folder).name == policy.resolve().name and Path(motion).name == file.name


def _from_state(state: Mapping[Any, Any], source: str, config: Path) -> _Window:
    numbers = {
        key: finite([state[key]], f"{config}:{key}")[0]
        for key in ("time_start", "time_end", "fps")
        if state.get(key) is not None
    }
    return _Window(
        numbers.get("time_start", 0.0), numbers.get("time_end"), numbers.get("fps"), source
    )
