"""Show an imported policy: what goes in, what comes out, what had to be inferred."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from downbeat.policies.manifest import SkillManifest
from downbeat.policies.spec import PolicySpec, TermSpec


def print_policy(manifest: SkillManifest, console: Console) -> None:
    """Print everything that its manifest says.

    Args:
        manifest: An imported skill.
        console: One that takes no markup: names come from the files of strangers.
    """
    spec = manifest.policy
    if spec is None:
        return
    console.print(
        f"{manifest.name}: {manifest.kind}, {spec.dialect}, from {manifest.source}", style="bold"
    )
    console.print(_facts(manifest, spec))
    console.print(_terms(spec))
    console.print(_joints(spec))
    if manifest.inferred:
        console.print("not in the policy's own files:", style="bold")
        for line in manifest.inferred:
            console.print(f"  {line}")


def _facts(manifest: SkillManifest, spec: PolicySpec) -> Table:
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(style="dim")
    table.add_column()
    table.add_row("licence", manifest.licence)
    files = zip(
        (manifest.file, *manifest.extra_files),
        (manifest.sha256, *manifest.extra_sha256),
        strict=True,
    )
    table.add_row("files", ", ".join(f"{name} {digest[:12]}" for name, digest in files))
    for one in spec.inputs:
        width = one.width(spec.num_joints)
        table.add_row("input", f"{one.name}: {width} numbers -> {spec.action_output}")
    if spec.action_clip is not None:
        table.add_row("action clip", f"{spec.action_clip[0]:g}..{spec.action_clip[1]:g}")
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
    if spec.phase_duration_s > 0.0:
        table.add_row("motion", f"{spec.phase_duration_s:g} s, known by heart, told its phase")
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
            if term.history > 1 or term.past:
                order = one.history_order.replace("_", " ")
                history += " ticks before this one" if term.past else " ticks"
                history += f", {order}, by {one.history_layout}, first: {one.history_fill}"
            clip = "-" if term.clip is None else f"{term.clip[0]:g}..{term.clip[1]:g}"
            width = str(term.width(spec.num_joints))
            table.add_row(one.name, term.name, width, _scale(term), clip, history)
    return table


def _scale(term: TermSpec) -> str:
    if len(term.scale) == 1:
        return f"{term.scale[0]:g}"
    shown = ", ".join(f"{value:g}" for value in term.scale[:4])
    return shown if len(term.scale) <= 4 else f"{shown}, ... ({len(term.scale)})"


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
