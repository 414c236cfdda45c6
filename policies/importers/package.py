"""Write an imported policy as a skill of ours: manifest, network, motion.

A skill is written beside its place and moved there when all of it is checked: an import that fails
leaves nothing, and what was there before stays.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from downbeat.policies.errors import PolicyError
from downbeat.policies.importers.context import Draft, ImportContext
from downbeat.policies.importers.network import read_network
from downbeat.policies.manifest import SkillManifest, file_sha256, load_manifest
from downbeat.policies.spec_toml import spec_to_table
from downbeat.policies.toml_text import write_toml

NAME = re.compile(r"[a-z][a-z0-9_]{0,40}")
SAYS_NOTHING = re.compile(
    r"(policy|model|motion|deploy|exported|params|checkpoint|latest)(_?\d+)?|v\d+", re.IGNORECASE
)
SHARED_BY_MANY = frozenset({"velocity", "locomotion", "walk", "mimic", "tracking"})
"""Every author has one of that name: the folder above tells them apart."""
SLEW_LINEAR_M_S2 = 0.6
SLEW_YAW_RAD_S2 = 1.2
HEADING_GAIN_1_S = 0.5
RATE_HZ = 50


def skill_name(path: Path) -> str:
    """Return a skill name for a path: the last part that says what it is."""
    parts = [*path.parts[1:-1], path.stem if path.suffix == ".onnx" else path.name]
    while len(parts) > 1 and SAYS_NOTHING.fullmatch(parts[-1]):
        parts.pop()
    name = parts[-1]
    if name.lower() in SHARED_BY_MANY:
        above = [p for p in parts[:-1] if p.lower() not in ("policy", "config", "deploy", "robots")]
        name = f"{above[-1]}_{name}" if above else name
    text = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
    return text if NAME.fullmatch(text) else f"policy_{text}"[:40].strip("_")


@contextmanager
def staging(out: Path, name: str, source: str) -> Iterator[Path]:
    """Give a folder to write the skill into; move it to `out/name` at the end.

    Args:
        out: Folder of imported skills.
        name: Name of the skill.
        source: Where it comes from; an import of the same source is replaced.

    Raises:
        PolicyError: The name is not valid or taken, or the folder cannot be written.
    """
    if not NAME.fullmatch(name):
        raise PolicyError(f"Skill name '{name}' must be lower_snake, 1..41 letters (--name).")
    target = out / name
    _check_free(target, source)
    try:
        out.mkdir(parents=True, exist_ok=True)
        room = Path(tempfile.mkdtemp(prefix=f".{name}-", dir=out))
    except OSError as error:
        raise PolicyError(f"{out} cannot be written: {error.strerror or error}.") from error
    try:
        (room / name).mkdir()
        yield room / name
        if target.exists():
            shutil.rmtree(target)
        os.replace(room / name, target)
    except OSError as error:
        raise PolicyError(f"{target} cannot be written: {error.strerror or error}.") from error
    finally:
        shutil.rmtree(room, ignore_errors=True)


def _check_free(target: Path, source: str) -> None:
    if not target.exists():
        return
    try:
        table = tomllib.loads((target / "manifest.toml").read_text(encoding="utf-8"))
        there = str(table["source"])
    except (OSError, ValueError, KeyError):
        there = "something that is no imported skill"
    if there != source:
        raise PolicyError(
            f"{target} holds {there}, not an earlier import of {source}; give another --name or "
            "--out."
        )


def source_of(ctx: ImportContext) -> str:
    """Return where a policy came from: the last parts of its path."""
    return "/".join(ctx.path.resolve().parts[-3:])


def write_skill(ctx: ImportContext, draft: Draft, folder: Path, licence: str) -> SkillManifest:
    """Write the skill into `folder` and load it back.

    Raises:
        PolicyError: A field contradicts another.
    """
    if draft.command is not None:
        ctx.note(
            f"command.slew, heading_gain = {SLEW_LINEAR_M_S2:g} m/s2, {SLEW_YAW_RAD_S2:g} rad/s2, "
            f"{HEADING_GAIN_1_S:g} 1/s: our defaults"
        )
    onnx_name = _copy_network(draft.onnx, folder, ctx.name)
    extra = list(read_network(folder / onnx_name).external)
    if draft.motion is not None:
        np.savez(folder / "motion.npz", **draft.motion)
        extra.append("motion.npz")
    table = _table(ctx, draft, licence, folder / onnx_name)
    table["extra_files"] = extra
    table["extra_sha256"] = [file_sha256(folder / name) for name in extra]
    table["policy"] = spec_to_table(draft.spec)
    write_toml(folder / "manifest.toml", table)
    return load_manifest(folder / "manifest.toml")


def _copy_network(source: Path, folder: Path, name: str) -> str:
    target = f"{name}.onnx"
    shutil.copyfile(source, folder / target)
    for file in read_network(source).external:
        if file in (target, "manifest.toml", "motion.npz", "golden.npz"):
            raise PolicyError(f"{source} keeps its weights in '{file}', a name that we need.")
        shutil.copyfile(source.resolve().parent / file, folder / file)
    return target


def _table(ctx: ImportContext, draft: Draft, licence: str, onnx: Path) -> dict[str, Any]:
    tracking = draft.kind == "tracking"
    said = licence or draft.licence
    if not said:
        ctx.note("licence = unknown: no file says; give --licence before passing it on")
    table: dict[str, Any] = {
        "name": ctx.name,
        "title": ctx.name.replace("_", " "),
        "file": onnx.name,
        "sha256": file_sha256(onnx),
        "licence": said or "unknown",
        "kind": draft.kind,
        "loop": not tracking,
        "rate_hz": RATE_HZ,
        "duration_s": round(draft.duration_s, 6),
        "ticks": max(1, round(draft.duration_s * RATE_HZ)),
        "bpm": 0.0,
        "beats": 0,
        "tempo_range_bpm": [0.0, 0.0],
        "observation_names": [t.name for one in draft.spec.inputs for t in one.terms],
        "phrases": [ctx.name.replace("_", " ")],
        "source": source_of(ctx),
        "inferred": ctx.inferred,
    }
    if tracking:
        table["entry_phases_s"] = [0.0]
    if draft.command is not None:
        vx, vy, yaw_rate = draft.command
        table["command"] = {
            "vx": list(vx),
            "vy": list(vy),
            "yaw_rate": list(yaw_rate),
            "slew_linear": SLEW_LINEAR_M_S2,
            "slew_yaw": SLEW_YAW_RAD_S2,
            "heading_gain": HEADING_GAIN_1_S,
        }
    return table
