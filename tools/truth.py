"""What was really played: truth.json, read by the evaluator and by nobody else."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from downbeat.runtime.errors import one_of
from downbeat.tools.errors import ToolError

F64 = NDArray[np.float64]

TRUTH_NAME = "truth.json"
BOUNDARIES = ("start", "announced", "unannounced")


@dataclass(frozen=True)
class Segment:
    """A stretch of one track; times [s] of the show, `track_from_s` of the track."""

    track: str
    track_from_s: float
    start_s: float
    end_s: float


@dataclass(frozen=True)
class Section:
    """What should be danced from when to when [s of the show]."""

    start_s: float
    end_s: float
    skill: str
    track: str
    boundary: Literal["start", "announced", "unannounced"]


@dataclass(frozen=True)
class TrueBeats:
    """The true beats of a track: beat k falls at `times_s[k]`, straight lines in between."""

    times_s: F64

    @staticmethod
    def constant(tempo_bpm: float, first_beat_s: float) -> TrueBeats:
        """Beats of one tempo for ever."""
        period_s = 60.0 / tempo_bpm
        return TrueBeats(np.array([first_beat_s, first_beat_s + period_s]))

    def at(self, track_s: F64) -> F64:
        """Return the position in beats, beyond both ends at the tempo found there."""
        times = self.times_s
        index = np.clip(np.searchsorted(times, track_s, side="right") - 1, 0, times.size - 2)
        period = times[index + 1] - times[index]
        return index + (track_s - times[index]) / period

    def bpm(self, track_s: F64) -> F64:
        """Return the tempo over the two beats before and after, [BPM]."""
        span = self.times_s.size - 1
        beats = np.clip(np.round(self.at(track_s)).astype(np.int64), 0, span)
        low, high = np.clip(beats - 2, 0, span - 1), np.clip(beats + 2, 1, span)
        return 60.0 * (high - low) / (self.times_s[high] - self.times_s[low])


@dataclass(frozen=True)
class Truth:
    """The whole file."""

    duration_s: float
    announced: bool
    segments: tuple[Segment, ...]
    sections: tuple[Section, ...]
    beats: dict[str, TrueBeats]
    seed: int | None = None
    raw: dict[str, Any] = field(default_factory=dict)

    def segment_at(self, show_s: float) -> Segment | None:
        """Return what was playing at a time of the show."""
        for segment in self.segments:
            if segment.start_s <= show_s < segment.end_s:
                return segment
        return None


def read_truth(path: Path) -> Truth:
    """Read and check the file.

    Raises:
        ToolError: It is missing, or an entry is missing or wrong (file:key).
    """
    try:
        raw = json.loads(path.read_text(encoding="utf-8"))
        truth = Truth(
            duration_s=float(raw["duration_s"]),
            announced=bool(raw["announced"]),
            segments=tuple(_segment(entry) for entry in raw["segments"]),
            sections=tuple(_section(entry, path) for entry in raw["sections"]),
            beats={name: _beats(entry) for name, entry in raw["beat_grids"].items()},
            seed=raw.get("seed"),
            raw=raw,
        )
    except OSError as error:
        raise ToolError(
            f"The truth file {path} cannot be read: {error.strerror}; it lies in the run folder."
        ) from error
    except KeyError as error:
        raise ToolError(f"The truth file lacks {error} ({path}).") from error
    except (TypeError, ValueError) as error:
        raise ToolError(f"The truth file is not right: {error} ({path}).") from error
    return truth


def _segment(entry: dict[str, Any]) -> Segment:
    return Segment(
        str(entry["track"]),
        float(entry["track_from_s"]),
        float(entry["start_s"]),
        float(entry["end_s"]),
    )


def _section(entry: dict[str, Any], path: Path) -> Section:
    boundary = entry["boundary"]
    if boundary not in BOUNDARIES:
        raise ToolError(
            f"Boundary '{boundary}' is unknown; valid are {one_of(BOUNDARIES)}"
            f" ({path}: sections.boundary)."
        )
    return Section(
        float(entry["start_s"]),
        float(entry["end_s"]),
        str(entry["skill"]),
        str(entry.get("track", "")),
        boundary,
    )


def _beats(entry: dict[str, Any]) -> TrueBeats:
    if "beat_times_s" in entry:
        times = np.asarray(entry["beat_times_s"], dtype=np.float64)
        if times.size < 2 or np.any(np.diff(times) <= 0.0):
            raise ValueError("beat_times_s must be two or more increasing times")
        return TrueBeats(times)
    return TrueBeats.constant(float(entry["tempo_bpm"]), float(entry["first_beat_s"]))
