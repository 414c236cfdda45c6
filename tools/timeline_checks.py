"""The timeline's row of checks: which plans were simulated, and what came of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

from downbeat.tools import palette
from downbeat.tools.metrics_checks import Check

CHECK_ROW = (0.12, 0.2)
"""Lower edge and height of the row, in the panel's units."""
LABEL_SHARE, SHORTEST_SHARE = 0.05, 0.006
"""Width of a check's label, and of its bar at least, as a share of a panel."""


def draw_bar(axes: Any, row: tuple[float, float], span: tuple[float, float], **style: Any) -> None:
    """Draw a rounded bar over a span [s] in a row (lower edge, height)."""
    from matplotlib.patches import FancyBboxPatch

    bottom, height = row
    start_s, end_s = span
    axes.add_patch(
        FancyBboxPatch(
            (start_s, bottom),
            max(end_s - start_s, 0.0),
            height,
            boxstyle="round,pad=0,rounding_size=0.12",
            mutation_aspect=0.35,
            linewidth=0,
            **style,
        )
    )


def draw_checks(axes: Any, checks: Sequence[Check], start_s: float, end_s: float) -> None:
    """Draw how long each check took, and how many of its rollouts fell.

    Args:
        axes: Of the panel.
        checks: Of the show, in order.
        start_s: Of the panel, in the show.
        end_s: Of the panel, in the show.
    """
    bottom, height = CHECK_ROW
    shown = [check for check in checks if start_s <= check.asked_s < end_s]
    bars = [check_bar(check, end_s - start_s) for check in shown]
    gap_s = 0.5 * SHORTEST_SHARE * (end_s - start_s)
    for check, bar, side in zip(shown, bars, label_sides(bars, start_s, end_s), strict=True):
        good = palette.GOOD if check.is_simulated else palette.WARNING
        draw_bar(axes, CHECK_ROW, bar, color=palette.BAD if check.refused else good)
        if not side:
            continue
        axes.text(
            bar[1] + gap_s if side == "right" else bar[0] - gap_s,
            bottom + height / 2,
            check.text(),
            color=palette.MUTED,
            size=9,
            va="center",
            ha="left" if side == "right" else "right",
        )


def check_bar(check: Check, panel_s: float) -> tuple[float, float]:
    """Return from when to when a check is drawn [s]; a short one so that it can be seen."""
    answered_s = check.asked_s if check.answered_s is None else check.answered_s
    return check.asked_s, max(answered_s, check.asked_s + SHORTEST_SHARE * panel_s)


def label_sides(
    bars: Sequence[tuple[float, float]], start_s: float, end_s: float
) -> list[Literal["left", "right", ""]]:
    """Return on which side of each bar its label has room; "": on none, its colour has to do.

    Args:
        bars: From left to right [s].
        start_s: Of the panel.
        end_s: Of the panel.
    """
    room_s = LABEL_SHARE * (end_s - start_s)
    sides: list[Literal["left", "right", ""]] = []
    taken_s = start_s
    for (left_s, right_s), after in zip(bars, [*bars, None][1:], strict=True):
        if (end_s if after is None else after[0]) - right_s >= room_s:
            sides.append("right")
            taken_s = right_s + room_s
            continue
        sides.append("left" if left_s - taken_s >= room_s else "")
        taken_s = right_s
    return sides
