"""Write a skill's folder: ONNX file and manifest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from downbeat.policies.generator.descriptions import DESCRIPTIONS
from downbeat.policies.generator.export import CommandGrid, Tables, write_onnx
from downbeat.policies.generator.model import TICK_S
from downbeat.policies.manifest import (
    OBSERVATION_NAMES,
    Kind,
    SkillManifest,
    file_sha256,
    load_manifest,
)
from downbeat.policies.toml_text import write_toml

LICENCE = "Apache-2.0"


@dataclass(frozen=True, slots=True)
class Label:
    """What the manifest says beyond the tables.

    Attributes:
        name, title, kind, loop, phrases: As in the manifest.
        duration_s: Exact length of the loop [s].
        bpm, beats: 0 for gestures and locomotion.
        tempo_range_bpm: Before certification: what the design aims at.
        command: The [command] table; empty without a command input.
    """

    name: str
    title: str
    kind: Kind
    duration_s: float
    loop: bool = True
    bpm: float = 0.0
    beats: int = 0
    tempo_range_bpm: tuple[float, float] = (0.0, 0.0)
    phrases: tuple[str, ...] = ()
    command: Mapping[str, object] = field(default_factory=dict)


def write_skill(
    label: Label, tables: Tables, out_dir: Path, grid: CommandGrid | None = None
) -> SkillManifest:
    """Write `out_dir/NAME/NAME.onnx` and `manifest.toml`; return the manifest, read back."""
    folder = out_dir / label.name
    path = folder / f"{label.name}.onnx"
    write_onnx(path, label.name, tables, grid)
    table: dict[str, object] = {
        "name": label.name,
        "title": label.title,
        "file": path.name,
        "sha256": file_sha256(path),
        "licence": LICENCE,
        "kind": label.kind,
        "loop": label.loop,
        "rate_hz": round(1.0 / TICK_S),
        "duration_s": label.duration_s,
        "ticks": len(tables.rows),
        "bpm": label.bpm,
        "beats": label.beats,
        "tempo_range_bpm": list(label.tempo_range_bpm),
        "observation_names": list(OBSERVATION_NAMES),
        "phrases": list(label.phrases),
        "descriptions": list(DESCRIPTIONS.get(label.name, ())),
    }
    if label.kind != "planted":
        table |= {"entry_phases_s": [0.0], "exit_phases_s": [0.0]}
    if label.command:
        table["command"] = dict(label.command)
    write_toml(folder / "manifest.toml", table)
    return load_manifest(folder / "manifest.toml")
