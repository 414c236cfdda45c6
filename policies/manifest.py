"""Skill manifests: `policies/NAME/manifest.toml` beside `NAME.onnx`, loaded strictly."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, get_args

from downbeat.policies.errors import PolicyError
from downbeat.policies.manifest_types import (
    Certificate,
    CertificateCase,
    CommandLimits,
    Kind,
    SkillLimits,
    SkillManifest,
)
from downbeat.policies.spec_toml import spec_from_table
from downbeat.policies.toml_fields import check_keys, integer, number, numbers, texts
from downbeat.runtime.errors import one_of

__all__ = [
    "BUNDLED_SKILLS",
    "Certificate",
    "CertificateCase",
    "CommandLimits",
    "Kind",
    "SkillLimits",
    "SkillManifest",
    "file_sha256",
    "load_manifest",
    "load_skills",
]

OBSERVATION_NAMES = ("projected_gravity", "base_ang_vel", "joint_pos", "joint_vel")
OBSERVATION_SIZE = 64
BUNDLED_SKILLS = Path(__file__).resolve().parent

_OPTIONAL = {
    "phrases",
    "descriptions",
    "entry_phases_s",
    "exit_phases_s",
    "command",
    "limits",
    "policy",
    "extra_files",
    "extra_sha256",
    "source",
    "inferred",
    "certificate",
}
_KEYS = {field.name for field in fields(SkillManifest)} - {"folder"}


def load_skills(folder: Path | None = None) -> dict[str, SkillManifest]:
    """Load every skill below `folder`, sorted by name.

    Args:
        folder: Holds NAME/manifest.toml; None: the bundled skills.

    Raises:
        PolicyError: The folder has no skill, or a manifest is wrong (file:key).
    """
    root = BUNDLED_SKILLS if folder is None else folder
    found = [load_manifest(path) for path in sorted(root.glob("*/manifest.toml"))]
    if not found:
        raise PolicyError(f"No skill found: {root} has no NAME/manifest.toml.")
    return {manifest.name: manifest for manifest in found}


def load_manifest(path: Path) -> SkillManifest:
    """Load one manifest and check it against its ONNX file.

    Raises:
        PolicyError: One sentence with file:key and what would be valid.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise PolicyError(f"Manifest {path} cannot be read: {error}.") from error
    manifest = _from_table(table, path)
    _check(manifest, path)
    return manifest


def file_sha256(path: Path) -> str:
    """Return the hex SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _from_table(table: Mapping[str, Any], path: Path) -> SkillManifest:
    check_keys(table, _KEYS, _KEYS - _OPTIONAL, f"{path}")
    values: dict[str, Any] = dict(table)
    for key, length in (("tempo_range_bpm", 2), ("entry_phases_s", None), ("exit_phases_s", None)):
        if key in values:
            values[key] = numbers(values[key], length, f"{path}:{key}")
    for key in ("duration_s", "bpm"):
        values[key] = number(values[key], f"{path}:{key}")
    for key in ("rate_hz", "ticks", "beats"):
        values[key] = integer(values[key], f"{path}:{key}")
    for key in (
        "observation_names",
        "phrases",
        "descriptions",
        "extra_files",
        "extra_sha256",
        "inferred",
    ):
        values[key] = texts(values.get(key, []), f"{path}:{key}")
    for key in ("name", "title", "file", "sha256", "licence", "kind", "source"):
        if not isinstance(values.setdefault(key, ""), str):
            raise PolicyError(f"{values[key]!r} is not text ({path}:{key}).")
    if not isinstance(values["loop"], bool):
        raise PolicyError(f"{values['loop']!r} is neither true nor false ({path}:loop).")
    if "command" in values:
        values["command"] = _command(values["command"], path)
    if "limits" in values:
        values["limits"] = _limits(values["limits"], path)
    if "policy" in values:
        values["policy"] = spec_from_table(values["policy"], f"{path}:policy")
    if "certificate" in values:
        values["certificate"] = _certificate(values["certificate"], path)
    return SkillManifest(folder=path.parent, **values)


def _command(table: Any, path: Path) -> CommandLimits:
    where = f"{path}:command"
    keys = {field.name for field in fields(CommandLimits)}
    check_keys(table, keys, keys - {"heading_filter_s"}, where)
    values: dict[str, Any] = {}
    for key, value in table.items():
        if key in ("vx", "vy", "yaw_rate"):
            values[key] = numbers(value, 2, f"{where}.{key}")
        else:
            values[key] = number(value, f"{where}.{key}")
    return CommandLimits(**values)


def _limits(table: Any, path: Path) -> SkillLimits:
    where = f"{path}:limits"
    check_keys(table, {field.name for field in fields(SkillLimits)}, set(), where)
    return SkillLimits(**{key: number(value, f"{where}.{key}") for key, value in table.items()})


def _certificate(table: Any, path: Path) -> Certificate:
    where = f"{path}:certificate"
    keys = {field.name for field in fields(Certificate)}
    check_keys(table, keys, keys - {"target_jump_p99_rad"}, where)
    case_keys = {field.name for field in fields(CertificateCase)}
    cases = []
    for index, case in enumerate(table["case"]):
        check_keys(case, case_keys, case_keys - {"note"}, f"{where}.case[{index}]")
        cases.append(CertificateCase(**case))
    pushes = numbers(table["pushes_n_s"], None, f"{where}.pushes_n_s")
    return Certificate(
        method=str(table["method"]),
        versions=str(table["versions"]),
        passed=bool(table["passed"]),
        pushes_n_s=pushes,
        case=tuple(cases),
        target_jump_p99_rad=number(
            table.get("target_jump_p99_rad", 0.0), f"{where}.target_jump_p99_rad"
        ),
    )


def _check(manifest: SkillManifest, path: Path) -> None:
    """Check values that depend on each other or on the ONNX file."""
    if manifest.name != path.parent.name:
        raise PolicyError(
            f"Skill '{manifest.name}' lies in folder '{path.parent.name}'; "
            f"both need the same name ({path}:name)."
        )
    if manifest.kind not in get_args(Kind):
        raise PolicyError(
            f"Kind '{manifest.kind}' is unknown; kinds are {one_of(get_args(Kind))} ({path}:kind)."
        )
    if manifest.ticks < 1 or not manifest.duration_s > 0.0:
        raise PolicyError(
            f"{manifest.ticks} ticks in {manifest.duration_s} s is no loop; "
            f"both must be above 0 ({path}:ticks)."
        )
    low, high = manifest.tempo_range_bpm
    if manifest.bpm > 0.0 and not low <= manifest.bpm <= high:
        raise PolicyError(
            f"The built tempo {manifest.bpm:g} BPM lies outside {low:g}..{high:g} "
            f"({path}:tempo_range_bpm)."
        )
    if (manifest.kind == "locomotion") != (manifest.command is not None):
        raise PolicyError(
            f"A skill of kind locomotion needs a [command] table and no other kind has one "
            f"({path}:command)."
        )
    _check_file(manifest, path)


def _check_file(manifest: SkillManifest, path: Path) -> None:
    if not manifest.onnx_path.is_file():
        raise PolicyError(f"{manifest.onnx_path} does not exist ({path}:file).")
    _check_digest(manifest.folder, manifest.file, manifest.sha256, f"{path}:sha256")
    if len(manifest.extra_files) != len(manifest.extra_sha256):
        raise PolicyError(
            f"{len(manifest.extra_files)} extra files have {len(manifest.extra_sha256)} digests "
            f"({path}:extra_sha256)."
        )
    for name, digest in zip(manifest.extra_files, manifest.extra_sha256, strict=True):
        _check_digest(manifest.folder, name, digest, f"{path}:extra_files")
    motion = manifest.policy.motion if manifest.policy is not None else None
    if motion is not None and motion.file not in manifest.extra_files:
        raise PolicyError(
            f"Motion file '{motion.file}' is not among extra_files ({path}:policy.motion.file)."
        )


def _check_digest(folder: Path, name: str, digest: str, where: str) -> None:
    file = folder / name
    if Path(name).is_absolute() or not file.resolve().is_relative_to(folder.resolve()):
        raise PolicyError(f"{name} lies outside the skill's folder {folder} ({where}).")
    if not file.is_file():
        raise PolicyError(f"{file} does not exist ({where}).")
    found = file_sha256(file)
    if found != digest:
        raise PolicyError(
            f"{file} has SHA-256 {found[:12]}..., the manifest expects {digest[:12]}... ({where})."
        )
