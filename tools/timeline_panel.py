"""One panel of the timeline: the rows track, asked, danced and lock over a stretch of the show."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from downbeat.tools import palette
from downbeat.tools.metrics_checks import Check
from downbeat.tools.timeline_checks import CHECK_ROW, draw_bar, draw_checks
from downbeat.tools.timeline_speech import (
    ANSWER_ROW,
    SAID_ROW,
    SPEECH_TOP,
    Line,
    draw_lines,
)
from downbeat.tools.truth import Section, Truth

PANEL_PX = 1480
CHARACTER_PX = 11.8
"""Of the labels at their full size."""
WAVE_HZ = 40
TRACK_ROW, ASKED_ROW, DANCED_ROW = (3.05, 0.5), (2.05, 0.72), (0.95, 0.72)
HEARD_ROW = (0.52, 0.2)
"""Lower edge and height of each row, in the panel's own units."""
TOP = 3.95


@dataclass(frozen=True)
class Span:
    """A stretch of one value [s of the show]."""

    start_s: float
    end_s: float
    value: str


@dataclass(frozen=True)
class Picture:
    """Everything that is drawn, worked out before anything is drawn."""

    truth: Truth
    rows: list[dict[str, Any]]
    danced: list[Span]
    blends: list[Span]
    heard: list[Span]
    checks: list[Check]
    falls: list[tuple[float, float]]
    colours: dict[str, str]
    wave: NDArray[np.float64] | None
    start_s: float
    end_s: float
    said: tuple[Line, ...] = ()
    answers: tuple[Line, ...] = ()

    @property
    def has_speech(self) -> bool:
        """Whether anybody spoke."""
        return bool(self.said or self.answers)


def draw_panel(axes: Any, picture: Picture, start_s: float, end_s: float) -> None:
    """Draw the rows from `start_s` to `end_s` [s of the show] into matplotlib axes."""
    axes.set_facecolor(palette.BACKGROUND)
    axes.set_xlim(start_s, end_s)
    axes.set_ylim(0.0, SPEECH_TOP if picture.has_speech else TOP)
    for side in ("left", "right", "top"):
        axes.spines[side].set_visible(False)
    axes.spines["bottom"].set_color(palette.MUTED)
    axes.tick_params(axis="x", colors=palette.MUTED, labelsize=10.5)
    axes.set_yticks([])
    step_s = next(s for s in (5, 10, 20, 30, 60) if (end_s - start_s) / s <= 14 or s == 60)
    ticks = np.arange(math.ceil(max(start_s, 0.0) / step_s) * step_s, end_s, step_s)
    axes.set_xticks(ticks, [f"{int(t) // 60}:{int(t) % 60:02d}" for t in ticks])
    speech = ((SAID_ROW, "said"), (ANSWER_ROW, "answer")) if picture.has_speech else ()
    for (bottom, height), label in (
        *speech,
        (TRACK_ROW, "track"),
        (ASKED_ROW, "asked"),
        (DANCED_ROW, "danced"),
        (HEARD_ROW, "lock"),
        (CHECK_ROW, "checked"),
    ):
        axes.annotate(
            label,
            (0.0, bottom + height / 2),
            xycoords=("axes fraction", "data"),
            xytext=(-10, 0),
            textcoords="offset points",
            color=palette.INK,
            size=12,
            ha="right",
            va="center",
        )
    for row, lines in ((SAID_ROW, picture.said), (ANSWER_ROW, picture.answers)):
        draw_lines(axes, row, lines, _px_per_s(axes), "\u201c\u201d")
    _draw_tracks(axes, picture)
    _draw_skills(axes, picture)
    _draw_heard(axes, picture)
    draw_checks(axes, picture.checks, start_s, end_s)
    _draw_boundaries(axes, picture, start_s, end_s)
    _draw_falls(axes, picture)


def _draw_tracks(axes: Any, picture: Picture) -> None:
    bottom, height = TRACK_ROW
    for segment in picture.truth.segments:
        draw_bar(
            axes, TRACK_ROW, (segment.start_s + 0.06, segment.end_s - 0.06), color=palette.PANEL
        )
        span = Span(segment.start_s, segment.end_s, segment.track)
        _label(axes, span, bottom + height + 0.17, shorten=True)
    wave = picture.wave
    if wave is not None:
        times_s = np.arange(wave.size) / WAVE_HZ
        middle = bottom + height / 2
        axes.fill_between(
            times_s,
            middle - 0.45 * height * wave,
            middle + 0.45 * height * wave,
            color="#5f78c9",
            linewidth=0,
            alpha=0.9,
        )


def _draw_skills(axes: Any, picture: Picture) -> None:
    asked = [Span(s.start_s, s.end_s, s.skill) for s in picture.truth.sections]
    gap_s = 0.7 / _px_per_s(axes)
    for row, row_spans in ((ASKED_ROW, asked), (DANCED_ROW, picture.danced)):
        for span in row_spans:
            colour = picture.colours[span.value]
            draw_bar(axes, row, (span.start_s + gap_s, span.end_s - gap_s), color=colour)
            ink = palette.INK if span.value in palette.STANDING else palette.BACKGROUND
            _label(axes, span, row[0] + row[1] / 2, colour=ink)
    bottom, height = DANCED_ROW
    for span in picture.blends:
        axes.axvspan(
            span.start_s,
            span.end_s,
            ymin=bottom / axes.get_ylim()[1],
            ymax=(bottom + height) / axes.get_ylim()[1],
            facecolor="none",
            edgecolor="#10121a",
            hatch="////",
            linewidth=0,
        )


def _px_per_s(axes: Any) -> float:
    start_s, end_s = axes.get_xlim()
    return float(PANEL_PX / (end_s - start_s))


def _label(
    axes: Any, span: Span, y: float, colour: str = palette.INK, shorten: bool = False
) -> None:
    """Write a span's value in the middle of what is seen of it, smaller or not at all if narrow."""
    first_s, last_s = axes.get_xlim()
    start_s, end_s = max(span.start_s, first_s), min(span.end_s, last_s)
    room_px = (end_s - start_s) * _px_per_s(axes) - 10.0
    text = span.value
    if shorten and len(text) * CHARACTER_PX > room_px:
        text = text[: max(0, int(room_px / CHARACTER_PX) - 1)] + "\u2026"
    size = next((s for s in (13.5, 11.0, 9.0) if len(text) * CHARACTER_PX * s / 13.5 < room_px), 0)
    if not size or len(text) < 2:
        return
    axes.text(
        0.5 * (start_s + end_s),
        y,
        text,
        color=colour,
        size=size,
        weight="bold",
        ha="center",
        va="center",
        clip_on=True,
    )


def _draw_heard(axes: Any, picture: Picture) -> None:
    colours = {
        "right": palette.GOOD,
        "wrong": palette.BAD,
        "candidate": palette.WARNING,
        "lost": "#3a3f50",
    }
    bottom, height = HEARD_ROW
    for span in picture.heard:
        axes.axvspan(
            span.start_s,
            span.end_s,
            ymin=bottom / axes.get_ylim()[1],
            ymax=(bottom + height) / axes.get_ylim()[1],
            color=colours[span.value],
            linewidth=0,
        )


def _draw_boundaries(axes: Any, picture: Picture, start_s: float, end_s: float) -> None:
    for section, row in zip(picture.truth.sections, picture.rows):
        if not start_s <= section.start_s < end_s:
            continue
        announced = section.boundary == "announced"
        colour = palette.INK if announced else palette.CUT
        axes.plot(
            [section.start_s] * 2,
            [HEARD_ROW[0], TRACK_ROW[0] + TRACK_ROW[1]],
            color=colour,
            linewidth=1.6,
            linestyle="-" if announced else (0, (4, 3)),
            zorder=5,
        )
        _draw_onset(axes, section, row, colour)


def _draw_onset(axes: Any, section: Section, row: dict[str, Any], colour: str) -> None:
    """Write how late the dance came between the two rows, and mark sections that were missed."""
    if row["onset_error_ms"] is not None:
        text = f"{round(row['onset_error_ms']):+d} ms"
    elif row["reaction_s"] is not None:
        text = f"{row['reaction_s']:+.1f} s"
    else:
        text = "never"
    y = 0.5 * (ASKED_ROW[0] + DANCED_ROW[0] + DANCED_ROW[1])
    axes.annotate(
        text,
        (section.start_s, y),
        xytext=(6, 0),
        textcoords="offset points",
        color=colour,
        size=12,
        weight="bold",
        va="center",
        zorder=6,
        clip_on=True,
    )
    if not row["followed"]:
        axes.annotate(
            "\u2717",
            (section.end_s, y),
            xytext=(-6, 0),
            textcoords="offset points",
            color=palette.BAD,
            size=12,
            weight="bold",
            va="center",
            ha="right",
            zorder=6,
            clip_on=True,
        )


def _draw_falls(axes: Any, picture: Picture) -> None:
    bottom, height = DANCED_ROW
    for start_s, end_s in picture.falls:
        axes.axvspan(
            start_s, max(end_s, start_s + 0.2), color=palette.BAD, alpha=0.35, zorder=4, linewidth=0
        )
        axes.plot(
            start_s,
            bottom + height / 2,
            marker="X",
            markersize=17,
            color=palette.BAD,
            markeredgecolor=palette.INK,
            zorder=7,
        )
