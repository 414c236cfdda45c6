"""Locally whitened log spectrum: what the alignment matcher compares.

Subtracting the local mean over time and frequency and dividing by the local deviation removes the
room, the microphone and the volume; unrelated music then correlates by about 0.1 at its best place.
What that takes away as well is a chord that lasts: of the mean over time comes back, at less
weight, what stands out of its neighbours in frequency. A room or a microphone has no such lines.
Nothing is learned. Constants: measured in the project's matcher study (docs/matcher.md).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt
import scipy.fft
import soxr
from scipy.ndimage import uniform_filter1d

F32 = npt.NDArray[np.float32]

SAMPLE_RATE_HZ = 16_000
"""That of the ring: what the robot hears needs no resampling."""
HOP = 1_280
"""80 ms."""
HOP_S = HOP / SAMPLE_RATE_HZ
WINDOW = 3_072
"""192 ms."""
BANDS_PER_OCTAVE = 24
MIN_HZ, MAX_HZ = 60.0, 7000.0
"""Voices leave the top free: with 4.4 kHz, babble at 0 dB costs 3 s windows five points more."""
NUM_BANDS = int(np.floor(BANDS_PER_OCTAVE * np.log2(MAX_HZ / MIN_HZ)))
WHITEN_TIME_FRAMES = 19
"""1.5 s."""
WHITEN_BANDS = 73
"""3 octaves."""
LASTING_BANDS = 13
"""Half an octave: lines that last stand out of so much."""
LASTING_WEIGHT, LASTING_LOW, LASTING_HIGH = 0.4, -2.0, 3.0
"""Any piece in the same key shares some of them, so that they count less than what changes. With
none of it, 1.3 to 2.5 times as many windows in noise are found at a wrong place."""
FLOOR = 0.2
"""The log floor stands 14 dB under the mean band power: what is quieter than that is not music."""
LEVEL_FRAMES = 63
"""5 s. The mean is that of the surroundings, not of the whole track: a window of a quiet beginning
does not know how loud the track becomes."""
PRE_EMPHASIS = 0.5
VARIANCE_FLOOR = 0.1
CLIP_LOW, CLIP_HIGH = -1.5, 3.0


@lru_cache(maxsize=1)
def band_weights() -> F32:
    """Return triangular bands on a log axis, never narrower than one bin, (1537, NUM_BANDS)."""
    bin_hz = SAMPLE_RATE_HZ / WINDOW
    centres = MIN_HZ * 2.0 ** (np.arange(-1, NUM_BANDS + 1) / BANDS_PER_OCTAVE)
    frequency = np.arange(WINDOW // 2 + 1) * bin_hz  # (1537,)
    weights = np.zeros((len(frequency), NUM_BANDS), np.float32)
    for band in range(NUM_BANDS):
        middle = centres[band + 1]
        low = min(centres[band], middle - bin_hz)
        high = max(centres[band + 2], middle + bin_hz)
        rising = (frequency - low) / (middle - low)
        falling = (high - frequency) / (high - middle)
        shape = np.maximum(0.0, np.minimum(rising, falling))
        weights[:, band] = shape / shape.sum() * (middle / 1000.0) ** PRE_EMPHASIS
    return weights


@lru_cache(maxsize=1)
def _octaves() -> tuple[tuple[slice, F32], ...]:
    """Return per octave of bands which bins they take, and their weights, (bins, bands).

    Most of `band_weights` is zero: as a whole it costs four times as much.
    """
    weights = band_weights()
    parts = []
    for first in range(0, NUM_BANDS, BANDS_PER_OCTAVE):
        part = weights[:, first : first + BANDS_PER_OCTAVE]
        bins = np.flatnonzero(part.any(1))
        taken = slice(int(bins[0]), int(bins[-1]) + 1)
        parts.append((taken, np.ascontiguousarray(part[taken])))
    return tuple(parts)


@lru_cache(maxsize=1)
def _hann() -> F32:
    return np.hanning(WINDOW + 1)[:-1].astype(np.float32)


def to_matcher_rate(samples: F32, sample_rate_hz: int) -> F32:
    """Resample mono samples to 16 kHz, (n,)."""
    samples = np.asarray(samples, np.float32)
    if sample_rate_hz == SAMPLE_RATE_HZ:
        return samples
    return np.asarray(soxr.resample(samples, sample_rate_hz, SAMPLE_RATE_HZ, quality="MQ"))


def log_bands(samples: F32) -> F32:
    """Return band powers, (frames, NUM_BANDS); frame j is centred on sample j * HOP."""
    frames = len(samples) // HOP
    padded = np.pad(samples, (WINDOW // 2, WINDOW))
    windows = np.lib.stride_tricks.sliding_window_view(padded, WINDOW)[::HOP][:frames]
    spectrum = scipy.fft.rfft(windows * _hann(), axis=1)  # (frames, 1537)
    power = spectrum.real**2 + spectrum.imag**2
    bands = [power[:, bins] @ weights for bins, weights in _octaves()]
    return np.concatenate(bands, axis=1, dtype=np.float32)  # (frames, NUM_BANDS)


def whiten(power: F32) -> F32:
    """Return the locally whitened log of band powers, same shape."""
    if len(power) == 0:
        return power
    level = _local_mean(power.mean(1, keepdims=True), LEVEL_FRAMES, 0)  # (frames, 1)
    log_power = np.log(power + FLOOR**2 * level + 1e-9)
    lasting = _local_mean(log_power, WHITEN_TIME_FRAMES, 0)
    centred = log_power - lasting
    centred = centred - _local_mean(centred, WHITEN_BANDS, 1)
    variance = _local_mean(_local_mean(centred**2, WHITEN_TIME_FRAMES, 0), WHITEN_BANDS, 1)
    white = centred / np.sqrt(variance + VARIANCE_FLOOR) + LASTING_WEIGHT * _lines(lasting)
    return np.clip(white, CLIP_LOW, CLIP_HIGH).astype(np.float32)


def _lines(lasting: F32) -> F32:
    """Return by how many deviations each band stands out of those around it, (frames, bands)."""
    out = lasting - _local_mean(lasting, LASTING_BANDS, 1)
    deviation = np.sqrt(_local_mean(out**2, LASTING_BANDS, 1) + VARIANCE_FLOOR)
    return np.clip(out / deviation, LASTING_LOW, LASTING_HIGH)


def _local_mean(values: F32, size: int, axis: int) -> F32:
    size = min(size, 2 * values.shape[axis] - 1)
    return np.asarray(uniform_filter1d(values, size, axis=axis, mode="nearest"))


def features(samples: F32) -> F32:
    """Return features of 16 kHz samples, (frames, NUM_BANDS), 80 ms per frame."""
    return whiten(log_bands(samples))


def shift_pitch(values: F32, ratio: float) -> F32:
    """Return what the features would have been, had the sound not been `ratio` times too high."""
    position = np.arange(NUM_BANDS) + BANDS_PER_OCTAVE * np.log2(ratio)
    low = np.floor(position).astype(int)
    share = (position - low).astype(np.float32)
    left = values[:, np.clip(low, 0, NUM_BANDS - 1)]
    right = values[:, np.clip(low + 1, 0, NUM_BANDS - 1)]
    return left * (1.0 - share) + right * share
