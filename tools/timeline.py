"""timeline.png: asked against danced, section by section, with what was heard below."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from downbeat.lcm_types import music_match_t
from downbeat.tools import palette
from downbeat.tools.metrics import first_sample_utime
from downbeat.tools.metrics_checks import checks_of
from downbeat.tools.metrics_sections import fallen_spans
from downbeat.tools.runlog import AUDIO_NAME, LOG_NAME, RunLog, read_run
from downbeat.tools.timeline_panel import TOP, WAVE_HZ, Picture, Span, draw_panel
from downbeat.tools.timeline_speech import SPEECH_TOP, said_lines
from downbeat.tools.truth import TRUTH_NAME, Truth, read_truth

TIMELINE_NAME = "timeline.png"
WIDTH_PX = 1600
DPI = 100
PANEL_S = 130.0
"""Longer shows get several panels below each other."""
HEADER_IN, PANEL_IN, AXES_IN, FOOTER_IN = 0.95, 4.15, 3.8, 0.85


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
    axes_in = AXES_IN * (SPEECH_TOP / TOP if picture.has_speech else 1.0)
    panel_in = axes_in + PANEL_IN - AXES_IN
    height_in = HEADER_IN + panels * panel_in + FOOTER_IN
    path = run_dir / TIMELINE_NAME
    with matplotlib.rc_context({"font.family": "DejaVu Sans", "font.size": 11}):
        figure = Figure(figsize=(WIDTH_PX / DPI, height_in), dpi=DPI, facecolor=palette.BACKGROUND)
        FigureCanvasAgg(figure)
        _draw_header(figure, metrics, height_in)
        span_s = (picture.end_s - picture.start_s) / panels
        for k in range(panels):
            bottom_in = FOOTER_IN + (panels - 1 - k) * panel_in
            axes = figure.add_axes((0.062, bottom_in / height_in, 0.925, axes_in / height_in))
            start_s = picture.start_s + k * span_s
            draw_panel(axes, picture, start_s, start_s + span_s)
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
    said, answers = said_lines(log, truth.raw, metrics, zero)
    return Picture(
        truth=truth,
        rows=metrics["sections"],
        danced=danced,
        blends=[span for span in spans(ticks_s[inside], blending) if span.value],
        heard=_heard(log, truth, zero),
        checks=checks_of(log, zero),
        falls=[((a - zero) * 1e-6, (b - zero) * 1e-6) for a, b in fallen_spans(log)],
        colours=palette.skill_colours([*asked, *(span.value for span in danced)]),
        wave=None if audio is None else _envelope(audio),
        start_s=-1.0,
        end_s=truth.duration_s + 1.0,
        said=tuple(said),
        answers=tuple(answers),
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


# ---------------------------------------------------------------------- around the panels


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
        Patch(color=palette.GOOD, label="locked on the right track, plan proven"),
        Patch(color=palette.WARNING, label="candidate, not simulated"),
        Patch(color=palette.BAD, label="wrong track, missed (\u2717), refused, fall"),
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
