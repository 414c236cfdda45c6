"""Show an imported policy: what goes in, what comes out, what had to be inferred."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from downbeat.policies.manifest import SkillManifest
from downbeat.policies.spec import PolicySpec, TermSpec


def print_policy(manifest: SkillManifest, console: Console) -> None:
    """Print everything that its manifest says."""
    spec = manifest.policy
    if spec is None:
        return
    console.print(f"[bold]{manifest.name}[/bold]: {manifest.source}, {manifest.kind}")
    console.print(_facts(manifest, spec))
    console.print(_terms(spec))
    console.print(_joints(spec))
    if manifest.inferred:
        console.print("[bold]not in the policy's own files:[/bold]")
        for line in manifest.inferred:
            console.print(f"  {line}", markup=False, highlight=False)


def _facts(manifest: SkillManifest, spec: PolicySpec) -> Table:
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(style="dim")
    table.add_column()
    table.add_row("licence", manifest.licence)
    if spec.motion is not None:
        table.add_row(
            "motion",
            f"{spec.motion.rows} rows at {spec.motion.rate_hz:g} Hz = {manifest.duration_s:g} s, "
            f"anchor {spec.motion.anchor_body}",
        )
    if manifest.command is not None:
        c = manifest.command
        table.add_row("command", f"vx {c.vx}, vy {c.vy} m/s, yaw rate {c.yaw_rate} rad/s")
    if spec.gait is not None:
        table.add_row("gait", f"{spec.gait.period_s:g} s, at rest: {spec.gait.still}")
    for one in spec.recurrent:
        table.add_row("recurrent", f"{one.input} <- {one.output} {list(one.shape)}")
    if spec.needs_position:
        table.add_row(
            "note", "reads estimated place or speed; prefer one that does not on hardware"
        )
    return table


def _terms(spec: PolicySpec) -> Table:
    table = Table("input", "term", "width", "scale", "clip", "history")
    for one in spec.inputs:
        for term in one.terms:
            history = str(term.history)
            if term.history > 1:
                history += f" {one.history_order}, filled with {one.history_fill}"
            clip = "-" if term.clip is None else f"{term.clip[0]:g}..{term.clip[1]:g}"
            width = str(term.width(spec.num_joints))
            table.add_row(one.name, term.name, width, _scale(term), clip, history)
    return table


def _scale(term: TermSpec) -> str:
    if len(term.scale) == 1:
        return f"{term.scale[0]:g}"
    return ", ".join(f"{value:g}" for value in term.scale[:4])


def _joints(spec: PolicySpec) -> Table:
    table = Table("#", "joint", "default", "scale", "offset", "kp", "kd")
    rows = zip(
        spec.joint_names,
        spec.default_joint_pos,
        spec.action_scale,
        spec.action_offset,
        spec.joint_stiffness,
        spec.joint_damping,
        strict=True,
    )
    for index, (name, *numbers) in enumerate(rows):
        table.add_row(str(index), name, *(f"{value:g}" for value in numbers))
    held = spec.held
    for name, pos, kp, kd in zip(
        held.joint_names, held.joint_pos, held.joint_stiffness, held.joint_damping, strict=True
    ):
        table.add_row("held", name, f"{pos:g}", "-", "-", f"{kp:g}", f"{kd:g}", style="dim")
    return table
