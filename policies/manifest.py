"""Skill manifests: `policies/NAME/manifest.toml` beside `NAME.onnx`, loaded strictly."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal, get_args

from downbeat.policies.errors import PolicyError
from downbeat.policies.toml_fields import check_keys, integer, number, numbers, texts
from downbeat.runtime.errors import one_of

Kind = Literal["planted", "stepping", "locomotion"]
OBSERVATION_NAMES = ("projected_gravity", "base_ang_vel", "joint_pos", "joint_vel")
OBSERVATION_SIZE = 64
BUNDLED_SKILLS = Path(__file__).resolve().parent


@dataclass(frozen=True, slots=True)
class CommandLimits:
    """What a locomotion skill may be asked for, base frame.

    Attributes:
        vx, vy: (low, high) [m/s].
        yaw_rate: (low, high) [rad/s].
        slew_linear: Fastest change of vx and vy [m/s^2].
        slew_yaw: Fastest change of the yaw rate [rad/s^2].
        heading_gain: Yaw rate per heading error [1/s]; holds a straight line.
        heading_filter_s: Time constant of the low pass on the measured heading [s].
    """

    vx: tuple[float, float]
    vy: tuple[float, float]
    yaw_rate: tuple[float, float]
    slew_linear: float
    slew_yaw: float
    heading_gain: float
    heading_filter_s: float = 0.5


@dataclass(frozen=True, slots=True)
class CertificateCase:
    """One closed-loop test of a certificate; the worst of its runs.

    Attributes:
        name: What was varied.
        seconds: How long a run lasts [s].
        runs, falls: How many runs, and how many of them fell.
        survived_s: Shortest time on the feet [s].
        rmse_rad: Largest RMS joint error against the reference [rad].
        drift_m: Largest way that the feet crept [m]; walking: largest distance off the line.
        note: What else was measured.
    """

    name: str
    seconds: float
    runs: int
    falls: int
    survived_s: float
    rmse_rad: float
    drift_m: float
    note: str = ""


@dataclass(frozen=True, slots=True)
class Certificate:
    """What a skill survived alone, through ONNX Runtime, in simulation.

    Attributes:
        method: How it was tested, one sentence.
        versions: Versions of the physics and of the inference library.
        passed: No fall in any required case.
        pushes_n_s: Largest survived push forward, back, left, right [N s]; reported, not required.
        case: All cases.
    """

    method: str
    versions: str
    passed: bool
    pushes_n_s: tuple[float, ...]
    case: tuple[CertificateCase, ...]


@dataclass(frozen=True, slots=True)
class SkillManifest:
    """One skill, as its manifest describes it.

    Attributes:
        name: Skill name, equal to its folder's.
        title: For people.
        file: ONNX file, relative to the folder.
        sha256: Of the ONNX file.
        licence: SPDX name.
        kind: "planted" (feet stay), "stepping" or "locomotion".
        loop: Whether it repeats; False: it ends after `duration_s`.
        rate_hz: Control rate.
        duration_s: Length of the loop at the built tempo [s], exact.
        ticks: Rows of the table; `time_step = phase_s / duration_s * ticks`.
        bpm: Built tempo; 0 for gestures.
        beats: Beats per loop; 0 for gestures.
        tempo_range_bpm: Tempos danced by advancing the phase; (0, 0) for gestures.
        observation_names: Terms of `obs`, in order.
        phrases: What a person may say to ask for it.
        entry_phases_s: Phases [s] at which it may be entered; None: any.
        exit_phases_s: Phases [s] at which it may be left; None: any.
        command: Limits of the command input; None without one.
        certificate: What it survived; None before `downbeat policy certify`.
        folder: Where the manifest lies.
    """

    name: str
    title: str
    file: str
    sha256: str
    licence: str
    kind: Kind
    loop: bool
    rate_hz: int
    duration_s: float
    ticks: int
    bpm: float
    beats: int
    tempo_range_bpm: tuple[float, float]
    observation_names: tuple[str, ...]
    folder: Path
    phrases: tuple[str, ...] = ()
    entry_phases_s: tuple[float, ...] | None = None
    exit_phases_s: tuple[float, ...] | None = None
    command: CommandLimits | None = None
    certificate: Certificate | None = None

    @property
    def onnx_path(self) -> Path:
        """The ONNX file."""
        return self.folder / self.file


_OPTIONAL = {"phrases", "entry_phases_s", "exit_phases_s", "command", "certificate"}
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
    for key in ("observation_names", "phrases"):
        values[key] = texts(values.get(key, []), f"{path}:{key}")
    for key in ("name", "title", "file", "sha256", "licence", "kind"):
        if not isinstance(values[key], str):
            raise PolicyError(f"{values[key]!r} is not text ({path}:{key}).")
    if not isinstance(values["loop"], bool):
        raise PolicyError(f"{values['loop']!r} is neither true nor false ({path}:loop).")
    if "command" in values:
        values["command"] = _command(values["command"], path)
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


def _certificate(table: Any, path: Path) -> Certificate:
    where = f"{path}:certificate"
    keys = {field.name for field in fields(Certificate)}
    check_keys(table, keys, keys, where)
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
    found = file_sha256(manifest.onnx_path)
    if found != manifest.sha256:
        raise PolicyError(
            f"{manifest.onnx_path} has SHA-256 {found[:12]}..., the manifest expects "
            f"{manifest.sha256[:12]}... ({path}:sha256)."
        )
