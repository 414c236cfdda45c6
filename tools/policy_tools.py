"""`downbeat policy`: generate, certify, inspect."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from downbeat.policies.manifest import SkillManifest, load_skills
from downbeat.runtime.errors import one_of
from downbeat.tools.errors import ToolError


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
    """Print a table of skills, or one skill's certificate."""
    skills = load_skills(folder)
    for name in names:
        if name not in skills:
            raise ToolError(f"Skill '{name}' is unknown; skills are {one_of(skills)}.")
    console = Console()
    chosen = [skills[name] for name in (names or sorted(skills))]
    console.print(_overview(chosen))
    for manifest in chosen if names else ():
        if manifest.certificate is not None:
            console.print(_certificate(manifest))
    return 0


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
