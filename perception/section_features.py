"""What a moment of music sounds like, for telling one piece from the next: a stream of frames.

Each frame is computed from its own samples and the loudness of those before, so any splitting
into blocks gives the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.fft

from downbeat.perception.features import F32

RATE_HZ = 16_000
HOP = 1600
"""100 ms."""
HOP_US = 100_000
WINDOW, MIDDLE = 4096, 2048
"""256 ms for pitch, and 128 ms in its middle for timbre."""
NUM_BANDS, NUM_PITCHES = 32, 48
BAND_HZ = (60.0, 7500.0)
LOWEST_HZ = 130.81
"""The first of the pitches, a semitone each."""
NUM_LONG = NUM_BANDS + NUM_PITCHES
SHORT, SHORT_HOP, NUM_SHORT, SHORT_BANDS = 512, 160, 10, 24
"""Ten windows of 32 ms, 10 ms apart, around a frame's middle: what stops or begins, and when."""
FINE_BINS = slice(12, 556)
"""47 to 2170 Hz, 3.9 Hz a bin; a margin of them is used up by the moving average."""
FINE_SPAN, NUM_FINE = 32, 512
FLOOR = 1e-3
"""The log's floor, as a share of the power heard lately."""
SMOOTH = 0.02
"""Per frame: power heard lately is that of about 5 s."""
SILENT_POWER = 1e-9


@dataclass(frozen=True)
class Frames:
    """Some frames in a row.

    Attributes:
        long: Log power of the bands, then of the pitches, (n, NUM_LONG).
        short: Log power of the short windows' bands, (n, NUM_SHORT, SHORT_BANDS).
        fine: Peaks of the spectrum, whatever its envelope, of length 1, (n, NUM_FINE).
    """

    long: F32
    short: F32
    fine: F32

    def __len__(self) -> int:
        """Return how many."""
        return len(self.long)


class FrameStream:
    """Turns samples into frames, ten a second."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        self._buffer = np.zeros(0, np.float32)
        self._lately = 0.0

    def push(self, samples: F32, together: bool = False) -> list[Frames]:
        """Return the frames that samples complete; frame k spans samples k HOP .. k HOP + WINDOW.

        Args:
            samples: (n,) at 16 kHz.
            together: Whether the frames are computed and returned as one, which is faster, and
                the same but for the rounding.
        """
        self._buffer = np.concatenate([self._buffer, samples])
        if len(self._buffer) < WINDOW:
            return []
        windows = np.lib.stride_tricks.sliding_window_view(self._buffer, WINDOW)[::HOP]
        step = len(windows) if together else 1
        found = [self._frames(windows[at : at + step]) for at in range(0, len(windows), step)]
        self._buffer = self._buffer[len(windows) * HOP :]
        return found

    def _frames(self, windows: F32) -> Frames:
        """Return frames of windows (n, WINDOW)."""
        power = _power(windows)  # (n, 2049)
        edge = (WINDOW - MIDDLE) // 2
        bands = _power(windows[:, edge : edge + MIDDLE]) @ _bands(MIDDLE, NUM_BANDS)
        first = WINDOW // 2 - (HOP + SHORT - SHORT_HOP) // 2
        span = windows[:, first : first + SHORT + (NUM_SHORT - 1) * SHORT_HOP]
        short = np.lib.stride_tricks.sliding_window_view(span, SHORT, axis=1)[:, ::SHORT_HOP]
        floor = np.array([self._floor(float(mean)) for mean in bands.mean(1)], np.float32)
        long = np.concatenate([bands, power @ _pitches()], 1)
        short_bands = _power(short) @ _bands(SHORT, SHORT_BANDS)
        return Frames(
            np.log(long + floor[:, None]),
            np.log(short_bands + floor[:, None, None]),
            _fine(power),
        )

    def _floor(self, mean: float) -> float:
        """Take a frame's power into account; returns what is added to powers before the log."""
        if mean > SILENT_POWER:
            share = SMOOTH if self._lately else 1.0
            self._lately += share * (mean - self._lately)
        return FLOOR * self._lately + SILENT_POWER


def _power(windows: F32) -> F32:
    """Return the power spectrum of windows (..., n), (..., n // 2 + 1)."""
    count = windows.shape[-1]
    spectrum = scipy.fft.rfft(windows * _hann(count), axis=-1)
    return (spectrum.real**2 + spectrum.imag**2) / np.float32(count)


def _fine(power: F32) -> F32:
    """Return what stands out of its surroundings in spectra (n, bins), (n, NUM_FINE)."""
    power = power[:, FINE_BINS]
    log = np.log(power + FLOOR * power.mean(1, keepdims=True) + SILENT_POWER)
    total = np.cumsum(log, 1, dtype=np.float64)
    around = (total[:, FINE_SPAN:] - total[:, :-FINE_SPAN]) / FINE_SPAN
    half = FINE_SPAN // 2 + 1
    peaks = np.maximum(log[:, half : half + NUM_FINE] - around[:, :NUM_FINE], 0.0)
    length = np.sqrt((peaks**2).sum(1, keepdims=True)) + 1e-6
    return (peaks / length).astype(np.float32)


@lru_cache(maxsize=4)
def _hann(count: int) -> F32:
    return np.hanning(count + 1)[:-1].astype(np.float32)


@lru_cache(maxsize=2)
def _bands(window: int, count: int) -> F32:
    """Return triangular mel bands, (window // 2 + 1, count), each of weight 1."""
    mel = np.linspace(*(2595.0 * np.log10(1.0 + np.array(BAND_HZ) / 700.0)), count + 2)
    edges = 700.0 * (10.0 ** (mel / 2595.0) - 1.0)
    hertz = np.arange(window // 2 + 1) * RATE_HZ / window
    rising = (hertz[:, None] - edges[:-2]) / (edges[1:-1] - edges[:-2])
    falling = (edges[2:] - hertz[:, None]) / (edges[2:] - edges[1:-1])
    weights = np.maximum(0.0, np.minimum(rising, falling))
    return (weights / np.maximum(weights.sum(0), 1e-9)).astype(np.float32)


@lru_cache(maxsize=1)
def _pitches() -> F32:
    """Return triangles a semitone apart, (WINDOW // 2 + 1, NUM_PITCHES), each of weight 1."""
    hertz = np.arange(WINDOW // 2 + 1) * RATE_HZ / WINDOW
    tone = 12.0 * np.log2(np.maximum(hertz, 1.0) / LOWEST_HZ)
    weights = np.maximum(0.0, 1.0 - np.abs(tone[:, None] - np.arange(NUM_PITCHES)))
    return (weights / np.maximum(weights.sum(0), 1e-9)).astype(np.float32)
