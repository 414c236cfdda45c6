"""The timeline's rows of speech: what was said to the robot, and what it answered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from downbeat.lcm_types import speech_t
from downbeat.tools import palette
from downbeat.tools.metrics_speech import spoken_truth
from downbeat.tools.runlog import RunLog

SAID_ROW, ANSWER_ROW = (4.42, 0.2), (4.06, 0.2)
"""Lower edge and height, in the panel's own units: above the tracks and their names."""
SPEECH_TOP = 4.75
CHARACTER_PX = 7.6
TEXT_SIZE = 11.0
ANSWER_COLOUR = "#4cc9f0"


@dataclass(frozen=True)
class Line:
    """Something said [s of the show].

    Attributes:
        start_s, end_s: While it sounded.
        text: The words.
        note: What became of it.
        colour: Of its bar.
    """

    start_s: float
    end_s: float
    text: str
    note: str
    colour: str


def said_lines(
    log: RunLog, raw: dict[str, Any], metrics: dict[str, Any], zero_utime: int
) -> tuple[list[Line], list[Line]]:
    """Return what people said, and what the robot said.

    Args:
        log: The run.
        raw: Content of truth.json; without utterances the transcripts are shown.
        metrics: Of the run.
        zero_utime: When sample 0 sounded [us].
    """
    report = metrics.get("speech") or {}
    lines = [
        _judged(said.start_s, said.end_s, row)
        for said, row in zip(spoken_truth(raw), report.get("utterances", []), strict=False)
    ]
    if not lines:
        lines = [
            Line(_s(m.start_utime, zero_utime), _s(m.end_utime, zero_utime), m.text, "", _SEEN)
            for m in log.events["TRANSCRIPT"]
            if m.is_final and m.text
        ]
    return lines, _answers(log, zero_utime)


_SEEN = palette.MUTED


def _judged(start_s: float, end_s: float, row: dict[str, Any]) -> Line:
    found = row["found"] or ("answered" if row["expected"] == "answer" and row["good"] else "-")
    if row["good"] and not row["expected"]:
        note = ""  # nothing was to happen, and nothing did
    elif row["onset_s"] is not None:
        note = f"{found} {row['onset_s']:+.1f} s"
    else:
        note = found
    return Line(start_s, end_s, row["text"], note, palette.GOOD if row["good"] else palette.BAD)


def _answers(log: RunLog, zero_utime: int) -> list[Line]:
    """Return the robot's own sentences; one that was cut ends where it was cut."""
    begun: dict[int, Any] = {}
    lines = []
    for msg in log.events["SPEECH"]:
        if msg.state == speech_t.STARTED:
            begun[msg.utterance_id] = msg
        elif msg.state == speech_t.FINISHED and (first := begun.pop(msg.utterance_id, None)):
            start_s, end_s = _s(first.start_utime, zero_utime), _s(msg.header.utime, zero_utime)
            lines.append(Line(start_s, end_s, first.text, "", ANSWER_COLOUR))
    return lines


def _s(utime: int, zero_utime: int) -> float:
    return float(utime - zero_utime) * 1e-6


def draw_lines(
    axes: Any, row: tuple[float, float], lines: Sequence[Line], px_per_s: float, quotes: str
) -> None:
    """Draw a row: a bar while it sounded, and the words behind it as far as there is room.

    Args:
        axes: Of the panel, limits set.
        row: Lower edge and height.
        lines: In order.
        px_per_s: Scale.
        quotes: Around the words.
    """
    bottom, height = row
    top = axes.get_ylim()[1]
    first_s, last_s = axes.get_xlim()
    ends = [*(line.start_s for line in lines[1:]), float("inf")]
    for line, until_s in zip(lines, ends, strict=False):  # without lines there is one end
        if not first_s <= line.start_s < last_s:
            continue
        axes.axvspan(
            line.start_s,
            max(line.end_s, line.start_s + 3.0 / px_per_s),
            ymin=bottom / top,
            ymax=(bottom + 0.22 * height) / top,
            color=line.colour,
            linewidth=0,
        )
        room = int((min(until_s, last_s) - line.start_s) * px_per_s / CHARACTER_PX) - 1
        note = f"  {line.note}" if line.note else ""
        text = _fit(line.text, room - len(note) - 2)
        if not text:
            continue
        shown = axes.annotate(
            f"{quotes[0]}{text}{quotes[1]}",
            (line.start_s, bottom + 0.3 * height),
            color=palette.INK,
            size=TEXT_SIZE,
            va="bottom",
            ha="left",
            annotation_clip=True,
        )
        if note:
            axes.annotate(
                note.strip(),
                (1.0, 0.0),
                xycoords=shown,
                xytext=(6, 0),
                textcoords="offset points",
                color=line.colour,
                size=TEXT_SIZE,
                weight="bold",
                va="bottom",
                ha="left",
                annotation_clip=True,
            )


def _fit(text: str, letters: int) -> str:
    """Return the text, cut at a word where it is too long; nothing where there is no room."""
    if len(text) <= letters:
        return text
    if letters < 4:
        return ""
    head = text[: letters - 1]
    return (head.rsplit(" ", 1)[0] if " " in head else head) + "\u2026"
