"""Beat grids: track seconds <-> beats, for constant tempo and for recordings that breathe."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from downbeat.catalog.errors import CatalogError

MIN_BPM, MAX_BPM = 30.0, 300.0


@dataclass(frozen=True)
class BeatGrid:
    """Beat n of a track stands at `time_of(n)`; beat 0 is a downbeat.

    Attributes:
        tempo_bpm: Constant tempo, or the mean one.
        first_beat_s: Where beat 0 stands [s].
        beats_per_bar: Beats of a bar.
        beat_times_s: Times of beats 0, 1, ... [s]; empty: constant tempo.
    """

    tempo_bpm: float
    first_beat_s: float = 0.0
    beats_per_bar: int = 4
    beat_times_s: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not MIN_BPM <= self.tempo_bpm <= MAX_BPM:
            raise CatalogError(
                f"tempo_bpm {self.tempo_bpm} is not a tempo; valid are {MIN_BPM} to {MAX_BPM}."
            )
        if self.beats_per_bar < 1:
            raise CatalogError(f"beats_per_bar {self.beats_per_bar} must be at least 1.")
        times = self._times
        if len(times) == 1 or (len(times) > 1 and float(np.diff(times).min()) <= 0.0):
            raise CatalogError("beat_times_s must hold two or more times in rising order.")

    @cached_property
    def _times(self) -> NDArray[np.float64]:
        return np.asarray(self.beat_times_s, np.float64)

    @cached_property
    def _edge_s(self) -> tuple[float, float]:
        """Beat length before the first and after the last known beat [s]."""
        gaps = np.diff(self._times)
        return float(gaps[0]), float(gaps[-1])

    def time_of(self, beats: float) -> float:
        """Return the track time of a (fractional) beat [s]."""
        times = self._times
        if len(times) == 0:
            return self.first_beat_s + beats * 60.0 / self.tempo_bpm
        last = len(times) - 1
        if beats < 0.0:
            return float(times[0]) + beats * self._edge_s[0]
        if beats >= last:
            return float(times[-1]) + (beats - last) * self._edge_s[1]
        return float(np.interp(beats, np.arange(last + 1), times))

    def beats_at(self, track_s: float) -> float:
        """Return the (fractional) beat at a track time; inverse of `time_of`."""
        times = self._times
        if len(times) == 0:
            return (track_s - self.first_beat_s) * self.tempo_bpm / 60.0
        if track_s < times[0]:
            return (track_s - float(times[0])) / self._edge_s[0]
        if track_s >= times[-1]:
            return len(times) - 1 + (track_s - float(times[-1])) / self._edge_s[1]
        return float(np.interp(track_s, times, np.arange(len(times))))

    def bpm_at(self, track_s: float, span_beats: float = 8.0) -> float:
        """Return the tempo around a track time, averaged over `span_beats`."""
        if not self.beat_times_s:
            return self.tempo_bpm
        middle = self.beats_at(track_s)
        half = 0.5 * span_beats
        return 60.0 * span_beats / (self.time_of(middle + half) - self.time_of(middle - half))
