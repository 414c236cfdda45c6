"""What a moment of music sounds like, for telling one piece from the next: a stream of frames.

Each frame is computed from its own samples alone, so any splitting into blocks gives the same.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import scipy.fft

from downbeat.perception.features import F32

RATE_HZ = 16_000
HOP = 800
"""50 ms."""
HOP_US = 50_000
WINDOW = 2048
"""128 ms."""
NUM_BANDS, LOW_BANDS = 32, 6
BAND_HZ = (60.0, 7500.0)
NUM_SHAPE = 16
"""Cosine coefficients of the log spectrum: its shape without its level."""
CHROMA_HZ = (110.0, 1760.0)
FLOOR = 1e-3
"""The log's floor, as a share of the power heard lately."""
SMOOTH = 0.01
"""Per frame: power heard lately is that of about 5 s."""
SILENT_POWER = 1e-9
SHORT, SHORT_HOP, SHORT_BANDS, LAG = 512, 160, 24, 4
"""Short windows of 32 ms every 10 ms, compared over 40 ms: at a cut what sounded is gone."""
NUM_VALUES = NUM_SHAPE + 1 + 12 + 2 + 2
SHAPE, LEVEL, CHROMA, FLUX = slice(0, 16), slice(16, 17), slice(17, 29), slice(29, 31)
EXCHANGE = slice(31, 33)


class FrameStream:
    """Turns samples into frames, NUM_VALUES each, one every 50 ms."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        self._buffer = np.zeros(0, np.float32)
        self._lately = 0.0
        self._before: F32 | None = None

    def push(self, samples: F32) -> list[F32]:
        """Return the frames that samples complete; frame k spans samples k HOP .. k HOP + WINDOW.

        Args:
            samples: (n,) at 16 kHz.
        """
        self._buffer = np.concatenate([self._buffer, samples])
        frames = []
        used = 0
        while used + WINDOW <= len(self._buffer):
            frames.append(self._frame(self._buffer[used : used + WINDOW]))
            used += HOP
        self._buffer = self._buffer[used:]
        return frames

    def _frame(self, window: F32) -> F32:
        spectrum = scipy.fft.rfft(window * _hann())  # (1025,)
        power = (spectrum.real**2 + spectrum.imag**2) / WINDOW
        bands = power @ _bands()  # (32,)
        mean = float(bands.mean())
        if mean > SILENT_POWER:
            share = SMOOTH if self._lately else 1.0
            self._lately += share * (mean - self._lately)
        log_bands = np.log(bands + FLOOR * self._lately + SILENT_POWER)
        growth = np.zeros(NUM_BANDS) if self._before is None else log_bands - self._before
        self._before = log_bands
        growth = np.maximum(growth, 0.0)
        chroma = np.sqrt(power) @ _chroma()  # (12,)
        chroma = chroma / (float(np.sqrt((chroma**2).sum())) + 1e-6)
        return np.concatenate(
            [
                (log_bands @ _cosines()),
                [log_bands.mean()],
                chroma,
                [growth.mean(), growth[:LOW_BANDS].mean()],
                self._exchange(window),
            ]
        ).astype(np.float32)

    def _exchange(self, window: F32) -> tuple[float, float]:
        """Return how much fell silent at once, and how much of it was replaced by other sound."""
        short = np.lib.stride_tricks.sliding_window_view(window, SHORT)[::SHORT_HOP]  # (10, 512)
        spectrum = scipy.fft.rfft(short * _short_hann(), axis=1)
        bands = ((spectrum.real**2 + spectrum.imag**2) / SHORT) @ _short_bands()  # (10, 24)
        log_bands = np.log(bands + FLOOR * self._lately + SILENT_POWER)
        change = (log_bands[LAG:] - log_bands[:-LAG])[: HOP // SHORT_HOP]  # (5, 24)
        fallen = np.maximum(-change, 0.0).mean(1)
        risen = np.maximum(change, 0.0).mean(1)
        return float(fallen.max()), float(np.minimum(fallen, risen).max())


@lru_cache(maxsize=1)
def _short_hann() -> F32:
    return np.hanning(SHORT + 1)[:-1].astype(np.float32)


@lru_cache(maxsize=1)
def _short_bands() -> np.ndarray:
    return _triangles(SHORT, SHORT_BANDS)


@lru_cache(maxsize=1)
def _hann() -> F32:
    return np.hanning(WINDOW + 1)[:-1].astype(np.float32)


@lru_cache(maxsize=1)
def _bands() -> np.ndarray:
    return _triangles(WINDOW, NUM_BANDS)


def _triangles(window: int, count: int) -> np.ndarray:
    """Return triangular mel bands, (window // 2 + 1, count), each of weight 1."""
    mel = np.linspace(*(2595.0 * np.log10(1.0 + np.array(BAND_HZ) / 700.0)), count + 2)
    edges = 700.0 * (10.0 ** (mel / 2595.0) - 1.0)
    hertz = np.arange(window // 2 + 1) * RATE_HZ / window
    rising = (hertz[:, None] - edges[:-2]) / (edges[1:-1] - edges[:-2])
    falling = (edges[2:] - hertz[:, None]) / (edges[2:] - edges[1:-1])
    weights = np.maximum(0.0, np.minimum(rising, falling))
    return weights / np.maximum(weights.sum(0), 1e-9)


@lru_cache(maxsize=1)
def _cosines() -> np.ndarray:
    """Return the cosine transform without its constant, (NUM_BANDS, NUM_SHAPE)."""
    at = (np.arange(NUM_BANDS) + 0.5) * np.pi / NUM_BANDS
    return np.cos(np.outer(at, np.arange(1, NUM_SHAPE + 1))) * np.sqrt(2.0 / NUM_BANDS)


@lru_cache(maxsize=1)
def _chroma() -> np.ndarray:
    """Return which pitch class each bin belongs to, (1025, 12)."""
    hertz = np.arange(WINDOW // 2 + 1) * RATE_HZ / WINDOW
    inside = (hertz >= CHROMA_HZ[0]) & (hertz <= CHROMA_HZ[1])
    tone = 12.0 * np.log2(np.maximum(hertz, 1.0) / 440.0)
    distance = (tone[:, None] - np.arange(12) + 6.0) % 12.0 - 6.0
    return np.where(inside[:, None], np.exp(-0.5 * (distance / 0.5) ** 2), 0.0)
