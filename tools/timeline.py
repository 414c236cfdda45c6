"""timeline.png: asked against danced, section by section, with what was heard below."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from downbeat.lcm_types import music_match_t
from downbeat.tools import palette
from downbeat.tools.metrics import first_sample_utime
from downbeat.tools.metrics_sections import fallen_spans
from downbeat.tools.runlog import AUDIO_NAME, LOG_NAME, RunLog, read_run
from downbeat.tools.truth import TRUTH_NAME, Section, Truth, read_truth
from numpy.typing import NDArray

TIMELINE_NAME = "timeline.png"
WIDTH_PX = 1600
DPI = 100
PANEL_PX = 1480
CHARACTER_PX = 11.8
"""Of the labels at their full size."""
WAVE_HZ = 40
PANEL_S = 130.0
"""Longer shows get several panels below each other."""
HEADER_IN, PANEL_IN, FOOTER_IN = 0.95, 4.15, 0.85
TRACK_ROW, ASKED_ROW, DANCED_ROW, HEARD_ROW = (3.05, 0.5), (2.05, 0.72), (0.85, 0.72), (0.3, 0.2)
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
    falls: list[tuple[float, float]]
    colours: dict[str, str]
    wave: NDArray[np.float64] | None
    start_s: float
    end_s: float


def draw_timeline(run_dir: Path, metrics: dict[str, Any], audio: Path | None = None) -> Path:
    """Draw timeline.png into the run folder.

    Args:
        run_dir: Holds run.lcmlog and truth.json.
        metrics: As computed for this run.
        audio: The show's sound, for its waveform; None: mashup.wav of the run folder, if any.

    Returns:
        The picture's path.

    Raises:
        ToolError: The log or the truth file is missing or wrong.
    """
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    sound = audio or run_dir / AUDIO_NAME
    wave = sound if sound.is_file() else None
    picture = gather(read_run(run_dir / LOG_NAME), read_truth(run_dir / TRUTH_NAME), metrics, wave)
    panels = max(1, math.ceil((picture.end_s - picture.start_s) / PANEL_S - 0.05))
    height_in = HEADER_IN + panels * PANEL_IN + FOOTER_IN
    path = run_dir / TIMELINE_NAME
    with matplotlib.rc_context({"font.family": "DejaVu Sans", "font.size": 11}):
        figure = Figure(figsize=(WIDTH_PX / DPI, height_in), dpi=DPI, facecolor=palette.BACKGROUND)
        FigureCanvasAgg(figure)
        _draw_header(figure, metrics, height_in)
        span_s = (picture.end_s - picture.start_s) / panels
        for k in range(panels):
            bottom_in = FOOTER_IN + (panels - 1 - k) * PANEL_IN
            axes = figure.add_axes((0.062, bottom_in / height_in, 0.925, 3.8 / height_in))
            start_s = picture.start_s + k * span_s
            _draw_panel(axes, picture, start_s, start_s + span_s)
        _draw_footer(figure, height_in)
        figure.savefig(path)
    return path


# ---------------------------------------------------------------------- what to draw


def gather(log: RunLog, truth: Truth, metrics: dict[str, Any], audio: Path | None) -> Picture:
    """Work out everything that is drawn."""
    zero = first_sample_utime(log)
    ticks_s = (log.control.utime - zero) * 1e-6
    inside = (ticks_s >= -2.0) & (ticks_s <= truth.duration_s + 2.0)
    danced = spans(ticks_s[inside], log.control.executed[inside])
    blending = np.where(log.control.previous_skill[inside] == "", "", "blend")
    asked = [section.skill for section in truth.sections]
    return Picture(
        truth=truth,
        rows=metrics["sections"],
        danced=danced,
        blends=[span for span in spans(ticks_s[inside], blending) if span.value],
        heard=_heard(log, truth, zero),
        falls=[((a - zero) * 1e-6, (b - zero) * 1e-6) for a, b in fallen_spans(log)],
        colours=palette.skill_colours([*asked, *(span.value for span in danced)]),
        wave=None if audio is None else _envelope(audio),
        start_s=-1.0,
        end_s=truth.duration_s + 1.0,
    )


def spans(times_s: NDArray[np.float64], values: NDArray[np.str_]) -> list[Span]:
    """Return runs of equal values; each lasts until the next begins."""
    if times_s.size == 0:
        return []
    starts = np.flatnonzero(np.r_[True, values[1:] != values[:-1]])
    ends = np.r_[starts[1:], times_s.size - 1]
    return [
        Span(float(times_s[a]), float(times_s[b]), str(values[a])) for a, b in zip(starts, ends)
    ]


def _heard(log: RunLog, truth: Truth, zero_utime: int) -> list[Span]:
    """Return what the listener knew: locked right, locked wrong, candidate, lost."""
    times, states = [], []
    for message in log.events["MUSIC_MATCH"]:
        time_s = (message.header.utime - zero_utime) * 1e-6
        segment = truth.segment_at(time_s)
        if message.lock != music_match_t.LOCKED:
            state = "candidate" if message.lock == music_match_t.CANDIDATE else "lost"
        else:
            state = "right" if segment and message.track == segment.track else "wrong"
        times.append(time_s)
        states.append(state)
    return spans(np.array(times), np.array(states, dtype=np.str_))


def _envelope(audio: Path, rate_hz: int = WAVE_HZ) -> NDArray[np.float64]:
    """Return the sound's peak level, 0..1, (n,)."""
    import soundfile

    peaks = []
    with soundfile.SoundFile(str(audio)) as file:
        block = max(1, file.samplerate // rate_hz)
        for chunk in file.blocks(blocksize=block, dtype="float32", always_2d=True):
            peaks.append(float(np.abs(chunk).max()))
    level = np.array(peaks)
    return level / max(float(level.max()), 1e-6)


# ---------------------------------------------------------------------- drawing


def _draw_header(figure: Any, metrics: dict[str, Any], height_in: float) -> None:
    rows = metrics["sections"]
    followed = sum(row["followed"] for row in rows)
    good = followed == len(rows) and metrics["falls"] == 0
    y = 1.0 - 0.38 / height_in
    figure.text(
        0.013, y, "Asked and danced", color=palette.INK, size=20, weight="bold", va="center"
    )
    verdict = f"{followed} of {len(rows)} sections followed   {_falls(metrics['falls'])}"
    colour = palette.GOOD if good else palette.BAD
    figure.text(0.987, y, verdict, color=colour, size=15, weight="bold", va="center", ha="right")
    figure.text(
        0.013,
        1.0 - 0.72 / height_in,
        _numbers(metrics),
        color=palette.MUTED,
        size=11.5,
        va="center",
    )


def _falls(count: int) -> str:
    return {0: "no fall", 1: "1 fall"}.get(count, f"{count} falls")


def _numbers(metrics: dict[str, Any]) -> str:
    parts = []
    error = metrics["announced"]["onset_error_ms"]
    if error["max"] is not None:
        parts.append(f"announced changes: onset error p95 {error['p95']:.0f} ms")
    reaction = metrics["unannounced"]["reaction_s"]
    if reaction["max"] is not None:
        parts.append(f"start and surprise cuts: reaction p50 {reaction['p50']:.1f} s")
    beat = metrics["beat_phase_error_ms"]
    if beat["max"] is not None:
        parts.append(f"beat phase error p95 {beat['p95']:.0f} ms")
    return "     ".join(parts)


def _draw_panel(axes: Any, picture: Picture, start_s: float, end_s: float) -> None:
    axes.set_facecolor(palette.BACKGROUND)
    axes.set_xlim(start_s, end_s)
    axes.set_ylim(0.0, TOP)
    for side in ("left", "right", "top"):
        axes.spines[side].set_visible(False)
    axes.spines["bottom"].set_color(palette.MUTED)
    axes.tick_params(axis="x", colors=palette.MUTED, labelsize=10.5)
    axes.set_yticks([])
    step_s = next(s for s in (5, 10, 20, 30, 60) if (end_s - start_s) / s <= 14 or s == 60)
    ticks = np.arange(math.ceil(max(start_s, 0.0) / step_s) * step_s, end_s, step_s)
    axes.set_xticks(ticks, [f"{int(t) // 60}:{int(t) % 60:02d}" for t in ticks])
    for (bottom, height), label in (
        (TRACK_ROW, "track"),
        (ASKED_ROW, "asked"),
        (DANCED_ROW, "danced"),
        (HEARD_ROW, "lock"),
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
    _draw_tracks(axes, picture)
    _draw_skills(axes, picture)
    _draw_heard(axes, picture)
    _draw_boundaries(axes, picture, start_s, end_s)
    _draw_falls(axes, picture)


def _bar(axes: Any, row: tuple[float, float], span: tuple[float, float], **style: Any) -> None:
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


def _draw_tracks(axes: Any, picture: Picture) -> None:
    bottom, height = TRACK_ROW
    for segment in picture.truth.segments:
        _bar(axes, TRACK_ROW, (segment.start_s + 0.06, segment.end_s - 0.06), color=palette.PANEL)
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
            _bar(axes, row, (span.start_s + gap_s, span.end_s - gap_s), color=colour)
            ink = palette.INK if span.value in palette.STANDING else palette.BACKGROUND
            _label(axes, span, row[0] + row[1] / 2, colour=ink)
    bottom, height = DANCED_ROW
    for span in picture.blends:
        axes.axvspan(
            span.start_s,
            span.end_s,
            ymin=bottom / TOP,
            ymax=(bottom + height) / TOP,
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
            ymin=bottom / TOP,
            ymax=(bottom + height) / TOP,
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


def _draw_footer(figure: Any, height_in: float) -> None:
    """Explain lines, hatch and strip colours."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [
        Line2D([], [], color=palette.INK, linewidth=1.6, label="announced change"),
        Line2D(
            [], [], color=palette.CUT, linewidth=1.6, linestyle="--", label="start, surprise cut"
        ),
        Patch(facecolor="#9aa0b3", hatch="////", edgecolor="#10121a", label="cross-fade"),
        Patch(color=palette.GOOD, label="locked on the right track"),
        Patch(color=palette.WARNING, label="candidate"),
        Patch(color=palette.BAD, label="wrong track, missed (\u2717), fall"),
    ]
    figure.legend(
        handles=handles,
        loc="lower center",
        bbox_to_anchor=(0.5, 0.06 / height_in),
        ncols=len(handles),
        frameon=False,
        labelcolor=palette.MUTED,
        fontsize=10.5,
    )
