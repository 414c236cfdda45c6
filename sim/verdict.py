"""What a certification found out: written into the manifest, printed as one line."""

from __future__ import annotations

import platform
import tomllib
from dataclasses import asdict, dataclass

import mujoco
import numpy as np
import onnxruntime

from downbeat.policies.manifest import Certificate, SkillManifest, load_manifest
from downbeat.policies.manifest_types import SkillLimits
from downbeat.policies.toml_edit import set_keys


@dataclass(frozen=True, slots=True)
class Verdict:
    """What certification found out about a skill.

    Attributes:
        certificate: What it survived.
        tempo_range_bpm: Tempos danced; (0, 0) for what has no beat.
        limits: What safety shall allow while it plays; None: the manifest keeps its own.
    """

    certificate: Certificate
    tempo_range_bpm: tuple[float, float]
    limits: SkillLimits | None = None


def versions() -> str:
    """Return the versions that a certificate depends on."""
    return (
        f"mujoco {mujoco.__version__}, onnxruntime {onnxruntime.__version__}, "
        f"numpy {np.__version__}, python {platform.python_version()}"
    )


def write_verdict(manifest: SkillManifest, verdict: Verdict) -> SkillManifest:
    """Write a verdict into the skill's manifest and return it, read back."""
    path = manifest.folder / "manifest.toml"
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    table["tempo_range_bpm"] = list(verdict.tempo_range_bpm)
    certificate = asdict(verdict.certificate)
    certificate["pushes_n_s"] = list(certificate["pushes_n_s"])
    certificate["case"] = [
        {key: value for key, value in case.items() if value != ""} for case in certificate["case"]
    ]
    changes: dict[str, object] = {
        "tempo_range_bpm": table["tempo_range_bpm"],
        "certificate": certificate,
    }
    if verdict.limits is not None:
        limits = asdict(verdict.limits)
        changes["limits"] = {key: value for key, value in limits.items() if value is not None}
    set_keys(path, changes)
    return load_manifest(path)


def summary(name: str, verdict: Verdict) -> str:
    """Return a verdict as one line."""
    certificate = verdict.certificate
    falls = sum(case.falls for case in certificate.case if not case.name.endswith("BPM"))
    runs = sum(case.runs for case in certificate.case if not case.name.endswith("BPM"))
    nominal = certificate.case[0]
    failed = [f"{c.name} {c.falls}/{c.runs} from {c.survived_s:g} s" for c in certificate.case]
    failed = [text for text, case in zip(failed, certificate.case) if case.falls]
    low, high = verdict.tempo_range_bpm
    tempo = f"{low:g}-{high:g} BPM" if high else "no tempo"
    pushes = "/".join(f"{push:g}" for push in certificate.pushes_n_s)
    return (
        f"{name:<10} {'ok  ' if certificate.passed else 'FAIL'} falls {falls}/{runs}, "
        f"rmse {nominal.rmse_rad:.4f} rad, drift {nominal.drift_m:.2f} m, {tempo}, "
        f"push {pushes} N s{'; fails: ' if failed else ''}{', '.join(failed)}"
    )
