"""The beat grid of any recording, offline, when a catalogue is built.

librosa finds beats; a smooth grid is made of them, because a dance cannot follow their jitter.
"""

from __future__ import annotations

import numpy as np

from downbeat.catalog.beatgrid import BeatGrid
from downbeat.perception.features import F32

ANALYSIS_RATE_HZ = 22_050
HOP = 256
CONSTANT_WITHIN_S = 0.035
"""Beats this close (median) to an even grid are taken for one played to a click."""
SMOOTH_BEATS = 8
FALLBACK_BPM = 120.0


def estimate_grid(samples: F32, sample_rate_hz: int) -> BeatGrid:
    """Return a beat grid; an even 120 BPM where no beat is found.

    Args:
        samples: (n,) mono.
        sample_rate_hz: [Hz].
    """
    import librosa  # heavy, and only needed when a catalogue is built
    import soxr

    sound = soxr.resample(samples, sample_rate_hz, ANALYSIS_RATE_HZ)
    onset = librosa.onset.onset_strength(y=sound, sr=ANALYSIS_RATE_HZ, hop_length=HOP)
    _, beats = librosa.beat.beat_track(
        onset_envelope=onset, sr=ANALYSIS_RATE_HZ, hop_length=HOP, units="time", trim=False
    )
    return grid_from_beats(np.asarray(beats, np.float64))


def grid_from_beats(beats: np.ndarray) -> BeatGrid:
    """Return an even grid when it explains the beats, else smoothed beat times.

    Args:
        beats: (n,) detected beat times [s], rising.
    """
    if len(beats) < 8:
        return BeatGrid(FALLBACK_BPM)
    period = float(np.median(np.diff(beats)))
    numbers = np.round((beats - beats[0]) / period)
    for _ in range(3):  # number the beats again as the period gets better
        period, first = np.polyfit(numbers, beats, 1)
        numbers = np.round((beats - first) / period)
    error_s = np.abs(beats - (first + numbers * period))
    if float(np.median(error_s)) <= CONSTANT_WITHIN_S and float(np.diff(numbers).max()) < 8:
        first_beat_s = float(first % period)
        return BeatGrid(float(60.0 / period), first_beat_s)
    kernel = np.hanning(SMOOTH_BEATS + 3)[1:-1]
    gaps = np.clip(np.diff(beats), 0.7 * period, 1.4 * period)
    padded = np.pad(gaps, SMOOTH_BEATS // 2, mode="edge")
    smooth = np.convolve(padded, kernel / kernel.sum(), "valid")[: len(gaps)]
    times = beats[0] + np.concatenate([[0.0], np.cumsum(smooth)])
    return BeatGrid(
        float(60.0 / np.mean(smooth)), beat_times_s=tuple(float(round(t, 4)) for t in times)
    )
