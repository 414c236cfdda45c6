"""Where the beats of a recording are, by two offline analyses that hear all of it.

The project's own grid (perception/beats.py) is the reference; librosa's tracker with its own onset
curve is the witness. A recording counts as one with a steady beat when the grid is even and the
witness agrees with it, at the same tempo, half or double. Whoever follows causally has no say.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import soxr

from downbeat.catalog.beatgrid import BeatGrid
from downbeat.perception.beats import ANALYSIS_RATE_HZ, GRID_FORMAT, estimate_grid
from downbeat.perception.onset_stream import F64
from downbeat.perception.source import Recording
from downbeat.tools.rundir import CACHE_DIR

MIN_AGREEMENT = 0.8
MIN_SECONDS = 25.0
TOLERANCE_S = 0.07
"""The usual window of the F-measure."""


@dataclass(frozen=True)
class Reference:
    """Beats of a recording.

    Attributes:
        grid: The reference.
        witness_s: (n,) beats of the second analysis [s]; empty: the grid is known to be true.
        duration_s: [s].
    """

    grid: BeatGrid
    witness_s: F64
    duration_s: float

    @property
    def beats_s(self) -> F64:
        """All beats of the grid within the recording, (n,)."""
        last = int(self.grid.beats_at(self.duration_s))
        first = int(np.ceil(self.grid.beats_at(0.0)))
        return np.array([self.grid.time_of(float(k)) for k in range(first, last + 1)])

    @property
    def agreement(self) -> float:
        """F-measure between both, at the octave that fits best; 1 where the grid is known."""
        if len(self.witness_s) == 0:
            return 1.0
        grid, witness = self.beats_s, self.witness_s
        pairs = [(g, witness) for g in octaves(grid)] + [(grid, halved_gaps(witness))]
        return max(f_measure(a, b) for a, b in pairs)

    @property
    def is_steady(self) -> bool:
        """Whether it has a steady beat."""
        even = not self.grid.beat_times_s
        return even and self.duration_s >= MIN_SECONDS and self.agreement >= MIN_AGREEMENT

    def moved(self, start_s: float) -> Reference:
        """Return the reference of what is left from a place on; even grids only."""
        grid = replace(self.grid, first_beat_s=self.grid.first_beat_s - start_s)
        return Reference(grid, self.witness_s - start_s, self.duration_s - start_s)

    def stretched(self, factor: float) -> Reference:
        """Return the reference of the same recording, `factor` times as long; even grids only."""
        grid = replace(
            self.grid,
            tempo_bpm=self.grid.tempo_bpm / factor,
            first_beat_s=self.grid.first_beat_s * factor,
        )
        return Reference(grid, self.witness_s * factor, self.duration_s * factor)


def octaves(beats_s: F64) -> list[F64]:
    """Return beats, beats with their middles, and every other beat from the first or second on."""
    return [beats_s, halved_gaps(beats_s), beats_s[::2], beats_s[1::2]]


def halved_gaps(beats_s: F64) -> F64:
    """Return beats and the middles between them."""
    return np.sort(np.concatenate([beats_s, 0.5 * (beats_s[1:] + beats_s[:-1])]))


def f_measure(found_s: F64, true_s: F64) -> float:
    """Return the F-measure of beats within TOLERANCE_S, each used once; 0 if either has none."""
    if len(found_s) == 0 or len(true_s) == 0:
        return 0.0
    hits = used = 0
    for beat in found_s:
        while used < len(true_s) and true_s[used] < beat - TOLERANCE_S:
            used += 1
        if used < len(true_s) and true_s[used] <= beat + TOLERANCE_S:
            hits += 1
            used += 1
    return 2.0 * hits / (len(found_s) + len(true_s))


def find_reference(recording: Recording, cache: Path = CACHE_DIR / "follow") -> Reference:
    """Analyse a recording; takes seconds, so the result is cached by content."""
    digest = hashlib.sha256(recording.samples.tobytes() + bytes([GRID_FORMAT]))
    file = cache / f"{digest.hexdigest()[:24]}.npz"
    if not file.is_file():
        grid = estimate_grid(recording.samples, recording.sample_rate_hz)
        cache.mkdir(parents=True, exist_ok=True)
        np.savez(
            file,
            tempo=[grid.tempo_bpm, grid.first_beat_s],
            times=np.array(grid.beat_times_s),
            witness=_witness(recording),
        )
    with np.load(file) as data:
        bpm, first = (float(v) for v in data["tempo"])
        grid = BeatGrid(bpm, first, beat_times_s=tuple(float(t) for t in data["times"]))
        return Reference(grid, data["witness"], recording.duration_s)


def _witness(recording: Recording) -> F64:
    import librosa  # heavy, and only needed to measure

    sound = soxr.resample(recording.samples, recording.sample_rate_hz, ANALYSIS_RATE_HZ)
    _, beats = librosa.beat.beat_track(y=sound, sr=ANALYSIS_RATE_HZ, units="time", trim=False)
    return np.asarray(beats, np.float64)
