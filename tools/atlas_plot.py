"""The heat map of an atlas: every change of skill as a tile."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from downbeat.policies.manifest import SkillManifest
from downbeat.tools import palette
from downbeat.tools.atlas_report import PROVEN, PairSummary, totals

DPI = 100
TILE_IN = 0.5
LEFT_IN, RIGHT_IN, TOP_IN, BOTTOM_IN = 1.6, 0.6, 2.5, 1.3
SMALLEST = 0.42
"""Side of the smallest coloured square, of a tile: one exit of many still shows."""
MODE_STYLES = {
    "hard": ("#d9f99d", "at once"),
    "fade_0.3": (palette.GOOD, "0.3 s blend"),
    "fade_0.6": ("#22b8a6", "0.6 s blend"),
    "legs_0.3": ("#4cc9f0", "legs at once, rest in 0.3 s"),
}
"""Mode -> colour and words, fastest first."""
KIND_WORDS = {
    "stand": "stand",
    "planted": "both feet planted",
    "stepping": "footwork",
    "locomotion": "gait",
    "tracking": "motion",
    "imported": "imported",
}


def draw_atlas(
    path: Path,
    rows: Sequence[PairSummary],
    names: Sequence[str],
    skills: Mapping[str, SkillManifest],
    target: float = PROVEN,
) -> Path:
    """Draw every ordered pair: from (down) and to (across).

    Args:
        path: PNG to write.
        rows: As `atlas_report.summaries` returns them.
        names: Skills in the order of the axes.
        skills: Name -> manifest.
        target: Bound that counts as proven.

    Returns:
        The picture's path.
    """
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    side = len(names) * TILE_IN
    width, height = max(LEFT_IN + side + RIGHT_IN, 9.0), TOP_IN + side + BOTTOM_IN
    path.parent.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context({"font.family": "DejaVu Sans", "font.size": 11}):
        figure = Figure(figsize=(width, height), dpi=DPI, facecolor=palette.BACKGROUND)
        FigureCanvasAgg(figure)
        left = (width - side + LEFT_IN - RIGHT_IN) / 2.0
        box = (left / width, BOTTOM_IN / height, side / width, side / height)
        axes = figure.add_axes(box)
        _draw_tiles(axes, rows, names)
        _draw_names(axes, names, skills)
        _draw_header(figure, rows, target, height)
        _draw_legend(figure, rows, height)
        figure.savefig(path)
    return path


def _draw_tiles(axes: Any, rows: Sequence[PairSummary], names: Sequence[str]) -> None:
    place = {name: index for index, name in enumerate(names)}
    count = len(names)
    axes.set_xlim(0.0, count)
    axes.set_ylim(count, 0.0)
    axes.axis("off")
    for row in rows:
        x, y = place[row.target] + 0.5, place[row.source] + 0.5
        _square(axes, x, y, 0.88, palette.PANEL)
        if row.route == "direct":
            side = 0.88 * (SMALLEST + (1.0 - SMALLEST) * float(np.sqrt(row.covered)))
            _square(axes, x, y, side, MODE_STYLES[row.mode][0])
        elif row.route == "via stand":
            axes.plot([x], [y], "o", ms=7, mfc="none", mec=palette.STAND_COLOUR, mew=2.0)
        elif row.route == "unproven":
            axes.plot([x], [y], "x", ms=7, color=palette.BAD, mew=2.0)
    for index in range(count):
        axes.plot([index + 0.5], [index + 0.5], ".", ms=3, color=palette.STAND_COLOUR)


def _square(axes: Any, x: float, y: float, side: float, colour: str) -> None:
    from matplotlib.patches import FancyBboxPatch

    corner, round_by = side / 2.0, 0.16 * side
    inner = side - 2.0 * round_by
    style = f"round,pad={round_by},rounding_size={round_by}"
    low = (x - corner + round_by, y - corner + round_by)
    axes.add_patch(
        FancyBboxPatch(low, inner, inner, boxstyle=style, facecolor=colour, edgecolor="none")
    )


# ---------------------------------------------------------------------- around the tiles


def _draw_names(axes: Any, names: Sequence[str], skills: Mapping[str, SkillManifest]) -> None:
    for index, name in enumerate(names):
        middle = index + 0.5
        axes.text(-0.25, middle, name, color=palette.INK, ha="right", va="center")
        axes.text(
            middle, -0.25, name, color=palette.INK, ha="left", va="bottom", rotation=55,
            rotation_mode="anchor",
        )  # fmt: skip
    first = 0
    for kind, group in groupby(names, key=lambda name: _kind(skills[name])):
        last = first + len(list(group))
        if first:
            for xs, ys in (((first, first), (0, len(names))), ((0, len(names)), (first, first))):
                axes.plot(xs, ys, color=palette.STAND_COLOUR, lw=1.0, alpha=0.7)
        if last - first > 1:
            axes.text(
                len(names) + 0.3, (first + last) / 2.0, KIND_WORDS[kind], color=palette.MUTED,
                rotation=270, ha="center", va="center", fontsize=10, clip_on=False,
            )  # fmt: skip
        first = last


def _kind(skill: SkillManifest) -> str:
    if skill.name == "stand":
        return "stand"
    return "imported" if skill.policy is not None else skill.kind


def _draw_header(figure: Any, rows: Sequence[PairSummary], target: float, height_in: float) -> None:
    t = totals(rows)
    reached = t["direct"] + t["via_stand"]
    colour = palette.GOOD if reached == t["pairs"] else palette.WARNING
    lines = (
        (0.42, 21, "bold", palette.INK, "Every change of skill, tried before the show"),
        (0.80, 14, "bold", colour, _verdict(t)),
        (1.12, 11.5, "normal", palette.MUTED, _small_print(t, target)),
    )
    for down, size, weight, ink, text in lines:
        figure.text(
            0.5, 1.0 - down / height_in, text, color=ink, size=size, weight=weight, ha="center",
            va="center",
        )  # fmt: skip


def _verdict(t: Mapping[str, Any]) -> str:
    parts = [f"{t['direct']} of {t['pairs']} changes proven direct"]
    if t["via_stand"]:
        parts.append(f"{t['via_stand']} by way of stand")
    if t["unproven"]:
        parts.append(f"{t['unproven']} never made")
    if t["untried"]:
        parts.append(f"{t['untried']} not tried yet")
    return "  \u00b7  ".join(parts)


def _small_print(t: Mapping[str, Any], target: float) -> str:
    return (
        f"proven: at most {100 * target:g} % fall, at 95 % confidence  \u00b7  "
        f"{t['rollouts']:,} simulated robots, each with its own weight, floor, noise and push"
    )


def _draw_legend(figure: Any, rows: Sequence[PairSummary], height_in: float) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    used = {row.mode for row in rows if row.route == "direct"}
    handles: list[Any] = [
        Patch(color=colour, label=words)
        for mode, (colour, words) in MODE_STYLES.items()
        if mode in used
    ]
    routes = {row.route for row in rows}
    ring = {"marker": "o", "mfc": "none", "mec": palette.STAND_COLOUR, "mew": 2.0}
    cross = {"marker": "x", "color": palette.BAD, "mew": 2.0}
    if "via stand" in routes:
        handles.append(Line2D([], [], ls="", ms=8, label="by way of stand", **ring))
    if "untried" in routes:
        handles.append(Patch(color=palette.PANEL, label="not tried yet"))
    if "unproven" in routes:
        handles.append(Line2D([], [], ls="", ms=8, label="never made", **cross))
    figure.legend(
        handles=handles,
        loc="center",
        bbox_to_anchor=(0.5, 0.8 / height_in),
        ncols=len(handles),
        frameon=False,
        labelcolor=palette.MUTED,
        fontsize=11,
        handlelength=1.0,
        handleheight=1.0,
    )
    figure.text(
        0.5,
        0.35 / height_in,
        "down: the skill that is left    across: the skill that comes    "
        "a full tile: from every beat; a small one: from some",
        color=palette.MUTED,
        size=11,
        ha="center",
        va="center",
    )
