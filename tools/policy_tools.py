"""`downbeat policy`: generate, certify, inspect."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from downbeat.control.golden import TOLERANCE, verify_golden
from downbeat.control.network import NetworkSkill
from downbeat.policies.manifest import SkillManifest, load_manifest, load_skills
from downbeat.runtime.errors import one_of
from downbeat.tools.errors import ToolError
from downbeat.tools.policy_import import import_policy
from downbeat.tools.policy_inspect import print_policy


def generate(name: str, bpm: float | None, out: Path) -> int:
    """Build one skill."""
    from downbeat.policies.generator.build import generate as build

    started = time.monotonic()
    manifest = build(name, bpm, out)
    seconds = time.monotonic() - started
    size_kb = manifest.onnx_path.stat().st_size / 1e3
    print(
        f"{manifest.onnx_path}: {size_kb:.0f} kB, {manifest.ticks} ticks, built in {seconds:.1f} s"
    )
    print(f"certify it: downbeat policy certify {name} --skills {out} (needs stand there too)")
    return 0


def certify(names: Sequence[str], folder: Path | None, write: bool) -> int:
    """Certify skills; 0 if all passed."""
    from downbeat.sim.certify import certify as run
    from downbeat.sim.certify import summary

    asked = list(names) or sorted(load_skills(folder))
    verdicts = run(
        asked, folder, write, report=lambda name, verdict: print(summary(name, verdict), flush=True)
    )
    return 0 if all(verdict.certificate.passed for verdict in verdicts.values()) else 1


def inspect(names: Sequence[str], folder: Path | None) -> int:
    """Print a table of skills, or everything about some: names, their folders, foreign policies."""
    console = Console(markup=False, highlight=False)
    if not names:
        console.print(_overview(list(load_skills(folder).values())))
        return 0
    with tempfile.TemporaryDirectory() as room:
        chosen = [_find(name, folder, Path(room) / str(i)) for i, name in enumerate(names)]
        console.print(_overview(chosen))
        for manifest in chosen:
            if manifest.policy is not None:
                print_policy(manifest, console)
                console.print(f"golden vectors: {_golden(manifest)}")
            if manifest.certificate is not None:
                console.print(_certificate(manifest))
    return 0


def _find(name: str, folder: Path | None, room: Path) -> SkillManifest:
    """Return a skill by name or folder, or a foreign policy imported into `room`."""
    path = Path(name)
    if path.name == "manifest.toml" and path.is_file():
        return load_manifest(path.absolute())
    if (path / "manifest.toml").is_file():
        return load_manifest(path.absolute() / "manifest.toml")
    if path.exists() and (len(path.parts) > 1 or path.suffix):
        return import_policy(path, room)
    skills = load_skills(folder)
    if name not in skills:
        raise ToolError(
            f"Skill '{name}' is unknown and there is nothing at that path; skills are "
            f"{one_of(skills)}."
        )
    return skills[name]


def _golden(manifest: SkillManifest) -> str:
    worst = verify_golden(NetworkSkill(manifest))
    return (
        "the same bits" if worst == 0.0 else f"largest deviation {worst:.2g}, {TOLERANCE:g} allowed"
    )


def _overview(skills: Sequence[SkillManifest]) -> Table:
    table = Table("skill", "kind", "beats", "tempo", "loop", "exits [s]", "kB", "certified")
    for m in skills:
        low, high = m.tempo_range_bpm
        exits = "any" if m.exit_phases_s is None else ", ".join(f"{p:g}" for p in m.exit_phases_s)
        passed = "-" if m.certificate is None else ("yes" if m.certificate.passed else "NO")
        table.add_row(
            m.name,
            m.kind,
            str(m.beats or "-"),
            f"{low:g}-{high:g}" if high else "-",
            f"{m.duration_s:g} s" if m.loop else "once",
            exits,
            f"{m.onnx_path.stat().st_size / 1e3:.0f}",
            passed,
        )
    return table


def _certificate(manifest: SkillManifest) -> Table:
    certificate = manifest.certificate
    table = Table("case", "runs", "falls", "stood [s]", "rmse [rad]", "drift [m]")
    table.title = f"{manifest.name}: {certificate.method if certificate else ''}"
    for case in certificate.case if certificate else ():
        table.add_row(
            case.name,
            str(case.runs),
            str(case.falls),
            f"{case.survived_s:g}",
            f"{case.rmse_rad:.4f}",
            f"{case.drift_m:.2f}",
        )
    return table
