"""Write an imported policy as a skill of ours: manifest, network, motion."""

from __future__ import annotations

import re
import shutil
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
SLEW_LINEAR_M_S2 = 0.6
SLEW_YAW_RAD_S2 = 1.2
RATE_HZ = 50


def skill_name(path: Path) -> str:
    """Return a skill name for a path: the file's, or the folder's where that says more."""
    stem = path.stem if path.suffix == ".onnx" else path.name
    if stem in ("policy", "model", "deploy"):
        stem = path.parent.parent.name
    text = re.sub(r"[^a-z0-9]+", "_", stem.lower()).strip("_")
    return text if NAME.fullmatch(text) else f"policy_{text}"[:40]


def write_skill(ctx: ImportContext, draft: Draft, out: Path, licence: str) -> SkillManifest:
    """Write `out/NAME/` and load it back.

    Raises:
        PolicyError: The name is not valid, or the folder cannot be written.
    """
    if not NAME.fullmatch(ctx.name):
        raise PolicyError(f"Skill name '{ctx.name}' must be lower_snake (--name).")
    folder = out / ctx.name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        onnx_name = _copy_network(draft.onnx, folder, ctx.name)
        extra = list(read_network(folder / onnx_name).external)
        if draft.motion is not None:
            np.savez(folder / "motion.npz", **draft.motion)
            extra.append("motion.npz")
    except OSError as error:
        raise PolicyError(f"{folder} cannot be written: {error.strerror or error}.") from error
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
        shutil.copyfile(source.parent / file, folder / file)
    return target


def _table(ctx: ImportContext, draft: Draft, licence: str, onnx: Path) -> dict[str, Any]:
    tracking = draft.kind == "tracking"
    table: dict[str, Any] = {
        "name": ctx.name,
        "title": ctx.name.replace("_", " "),
        "file": onnx.name,
        "sha256": file_sha256(onnx),
        "licence": licence or draft.licence or "unknown",
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
        "source": f"{draft.spec.dialect}: {ctx.path.name}",
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
            "heading_gain": 0.5,
        }
    return table
