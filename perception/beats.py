"""The beat grid of any recording, offline, when a catalogue is built.

A beat tracker finds the beats roughly; a sharp onset curve then says where they stand. Music played
to a click gets an even grid, because a dance cannot follow a tracker's jitter; music that breathes
gets smoothed beat times.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
from scipy.ndimage import gaussian_filter1d, median_filter

from downbeat.catalog.beatgrid import BeatGrid
from downbeat.perception.features import F32

F64 = np.ndarray

GRID_FORMAT = 2
"""Grows when the same sound would get another grid: caches are keyed by it."""
ANALYSIS_RATE_HZ = 22_050
HOP = 128
HOP_S = HOP / ANALYSIS_RATE_HZ
WINDOW = 1024
NUM_BANDS = 36
LOW_BANDS = 6
"""Below about 150 Hz: the bass drum and the bass."""
ONSET_EARLY_S = 0.008
"""The curve peaks this much before a beat: log energy grows as soon as the window touches it
(measured on the bundled pieces, whose beats are known)."""
TRACKER_STEP = 2
"""The tracker works on every second value: 86 values a second."""
SHARPNESS_S = 0.010
MIN_BEATS = 8
FALLBACK_BPM = 120.0
BEATS_PER_BAR = 4

CONSTANT_WITHIN_S = 0.020
"""An even grid must stay this close to the local beats..."""
CONSTANT_SHARE = 0.8
"""...in this share of the windows; in the rest a solo or a break may say something else."""
EVEN_SCORE = 0.6
"""An even grid must collect this share of the onsets that freely placed beats collect."""
LOCAL_BEATS = 16
SMOOTH_BEATS = 8


@dataclass(frozen=True)
class Onsets:
    """How much begins to sound at each moment.

    Attributes:
        all: (frames,) all bands together, at HOP.
        low: (frames,) the bass only.
        bands: (frames, NUM_BANDS) log band energies.
    """

    all: F64
    low: F64
    bands: F64

    def at(self, curve: F64, times_s: F64) -> F64:
        """Return a curve's values at times [s], 0 outside."""
        places = (times_s - ONSET_EARLY_S) / HOP_S
        return np.interp(places, np.arange(len(curve)), curve, 0.0, 0.0)


def estimate_grid(samples: F32, sample_rate_hz: int) -> BeatGrid:
    """Return a beat grid whose beat 0 is a downbeat; an even 120 BPM where no beat is found.

    Args:
        samples: (n,) mono.
        sample_rate_hz: [Hz].
    """
    import librosa  # heavy, and only needed when a catalogue is built
    import soxr

    sound = soxr.resample(samples, sample_rate_hz, ANALYSIS_RATE_HZ)
    onsets = find_onsets(np.asarray(sound, np.float32))
    _, beats = librosa.beat.beat_track(
        onset_envelope=onsets.all[::TRACKER_STEP],
        sr=ANALYSIS_RATE_HZ,
        hop_length=HOP * TRACKER_STEP,
        units="time",
        trim=False,
    )
    beats = np.asarray(beats, np.float64) + ONSET_EARLY_S
    if len(beats) < MIN_BEATS:
        return BeatGrid(FALLBACK_BPM)
    period, first = even_fit(beats)
    period, first = sharpen(onsets, period, first, len(sound) / ANALYSIS_RATE_HZ)
    snapped = snap(onsets, beats)
    if is_even(onsets, period, first, snapped):
        grid = BeatGrid(float(60.0 / period), float(first % period))
    else:
        grid = grid_from_beats(snapped)
    return from_downbeat(grid, onsets)


def find_onsets(sound: F32) -> Onsets:
    """Return the onset curves: rectified growth of log band energies.

    Args:
        sound: (n,) at ANALYSIS_RATE_HZ.
    """
    frames = max(1, len(sound) // HOP)
    padded = np.pad(sound, (WINDOW // 2, WINDOW))
    windows = np.lib.stride_tricks.sliding_window_view(padded, WINDOW)[::HOP][:frames]
    hann = np.hanning(WINDOW + 1)[:-1].astype(np.float32)
    magnitude = np.abs(scipy.fft.rfft(windows * hann, axis=1))  # (frames, 513)
    edges = np.unique(np.geomspace(2, WINDOW // 2, NUM_BANDS + 10).astype(int))[: NUM_BANDS + 1]
    bands = np.add.reduceat(magnitude, edges[:-1], axis=1) / np.diff(edges)
    floor = 1e-4 + 0.03 * bands.mean(axis=0)
    bands = np.log(bands + floor)  # (frames, NUM_BANDS)
    growth = np.maximum(bands[2:] - bands[:-2], 0.0)
    growth = np.pad(growth, ((1, 1), (0, 0)))
    return Onsets(_lively(growth), _lively(growth[:, :LOW_BANDS]), bands)


def _lively(growth: F64) -> F64:
    """Return the mean over bands, freed of its slow part, with a maximum near 1."""
    curve = growth.mean(axis=1)
    curve = np.maximum(curve - gaussian_filter1d(curve, 0.4 / HOP_S), 0.0)
    return curve / (np.percentile(curve, 99.5) + 1e-9)


def even_fit(beats: F64) -> tuple[float, float]:
    """Return (period, first beat) [s] of the even grid nearest to rough beats, by least squares."""
    period = float(np.median(np.diff(beats)))
    numbers = np.concatenate([[0.0], np.cumsum(np.round(np.diff(beats) / period))])
    period, first = np.polyfit(numbers, beats, 1)
    for _ in range(3):  # number the beats again as the period gets better
        numbers = np.round((beats - first) / period)
        period, first = np.polyfit(numbers, beats, 1)
    return float(period), float(first)


def sharpen(onsets: Onsets, period: float, first: float, duration_s: float) -> tuple[float, float]:
    """Move an even grid to where it collects most onsets.

    All phases are tried, and tempos within 1 %, fine enough to keep the last beat within 4 ms.
    """
    curve = gaussian_filter1d(onsets.all, SHARPNESS_S / HOP_S)
    count = int(duration_s / period)
    numbers = np.arange(count) - count // 2
    middle = first + period * (count // 2)
    step = 0.008 / max(count, 1)
    best = (-1.0, period, middle)
    for candidate in np.arange(0.99 * period, 1.01 * period, step):
        phases = middle + np.arange(-0.5 * candidate, 0.5 * candidate, 0.004)
        times = phases[:, None] + candidate * numbers  # (phases, beats)
        score = onsets.at(curve, times).sum(axis=1)
        index = int(score.argmax())
        if score[index] > best[0]:
            best = (float(score[index]), float(candidate), float(phases[index]))
    _, period, middle = best
    return period, middle - period * (count // 2)


def is_even(onsets: Onsets, period: float, first: float, beats: F64) -> bool:
    """Whether an even grid explains the onsets as well as tracked beats do, window by window."""
    curve = gaussian_filter1d(onsets.all, SHARPNESS_S / HOP_S)
    numbers = np.arange(np.ceil((beats[0] - first) / period), (beats[-1] - first) / period)
    even = first + period * numbers
    if onsets.at(curve, even).mean() < EVEN_SCORE * onsets.at(curve, beats).mean():
        return False
    shifts = np.arange(-0.08, 0.0801, 0.004)
    found = []
    for start in range(0, len(even) - LOCAL_BEATS, LOCAL_BEATS // 2):
        score = onsets.at(curve, shifts[:, None] + even[start : start + LOCAL_BEATS]).sum(axis=1)
        if score.max() > 1.5 * score.mean():
            found.append(float(shifts[score.argmax()]))
    if not found:
        return False
    near = np.abs(np.array(found) - np.median(found)) <= CONSTANT_WITHIN_S
    return bool(near.mean() >= CONSTANT_SHARE)


def snap(onsets: Onsets, beats: F64, reach_s: float = 0.035) -> F64:
    """Move each beat to the strongest onset near it."""
    curve = gaussian_filter1d(onsets.all, 0.5 * SHARPNESS_S / HOP_S)
    shifts = np.arange(-reach_s, reach_s + 1e-9, 0.002)
    values = onsets.at(curve, beats[:, None] + shifts)  # (beats, shifts)
    moved = beats + shifts[values.argmax(axis=1)]
    return np.where(values.max(axis=1) > 0.05, moved, beats)


def grid_from_beats(beats: F64) -> BeatGrid:
    """Return an even grid when it explains the beats, else smoothed beat times.

    Args:
        beats: (n,) beat times [s], rising; some may be missing.
    """
    if len(beats) < MIN_BEATS:
        return BeatGrid(FALLBACK_BPM)
    period, first = even_fit(beats)
    numbers = np.round((beats - first) / period)
    error_s = np.abs(beats - (first + numbers * period))
    if float(np.percentile(error_s, 90)) <= CONSTANT_WITHIN_S:
        return BeatGrid(60.0 / period, first % period)
    return _breathing(beats)


def _breathing(beats: F64) -> BeatGrid:
    """Number the beats by their local period, and smooth their distance from an even grid."""
    gaps = np.diff(beats)
    local = median_filter(gaps, SMOOTH_BEATS + 1, mode="nearest")
    numbers = np.concatenate([[0.0], np.cumsum(np.maximum(np.round(gaps / local), 1.0))])
    every = np.arange(numbers[-1] + 1.0)
    times = np.interp(every, numbers, beats)
    slope = (times[-1] - times[0]) / every[-1]
    distance = times - slope * every
    reach = min(2 * SMOOTH_BEATS, len(distance) - 1)
    padded = np.pad(distance, reach, mode="reflect", reflect_type="odd")
    smooth = slope * every + gaussian_filter1d(padded, SMOOTH_BEATS / 4.0)[reach:-reach]
    smooth = np.maximum.accumulate(smooth + 1e-4 * every) - 1e-4 * every
    tempo_bpm = 60.0 * (len(smooth) - 1) / float(smooth[-1] - smooth[0])
    return BeatGrid(tempo_bpm, beat_times_s=tuple(round(float(t), 4) for t in smooth))


def from_downbeat(grid: BeatGrid, onsets: Onsets) -> BeatGrid:
    """Number the beats anew so that beat 0 is a downbeat.

    Harmony changes and the bass enters on downbeats more often than elsewhere.
    """
    last_s = len(onsets.all) * HOP_S
    beats = np.arange(1, max(2, int(grid.beats_at(last_s)) - 1))
    times = np.array([grid.time_of(float(b)) for b in beats])
    places = np.clip((times / HOP_S).astype(int), 0, len(onsets.bands) - 1)
    if len(places) < 4 * BEATS_PER_BAR:
        return grid
    reach = max(2, int(0.8 * np.median(np.diff(places))))
    total = np.cumsum(np.vstack([np.zeros(NUM_BANDS), onsets.bands]), axis=0)
    after = total[np.minimum(places + reach, len(total) - 1)] - total[places]
    before = total[places] - total[np.maximum(places - reach, 0)]
    change = np.linalg.norm(after - before, axis=1)  # (beats,)
    bass = onsets.at(gaussian_filter1d(onsets.low, SHARPNESS_S / HOP_S), times)
    evidence = _standard(change) + _standard(bass)
    scores = [evidence[beats % BEATS_PER_BAR == k].mean() for k in range(BEATS_PER_BAR)]
    return _renumbered(grid, int(np.argmax(scores)))


def _standard(values: F64) -> F64:
    return (values - values.mean()) / (values.std() + 1e-9)


def _renumbered(grid: BeatGrid, shift: int) -> BeatGrid:
    """Return the grid whose beat 0 is now beat `shift`."""
    if shift == 0:
        return grid
    if grid.beat_times_s:
        return BeatGrid(grid.tempo_bpm, beat_times_s=grid.beat_times_s[shift:])
    bar_s = BEATS_PER_BAR * 60.0 / grid.tempo_bpm
    return BeatGrid(grid.tempo_bpm, (grid.first_beat_s + shift * bar_s / BEATS_PER_BAR) % bar_s)
