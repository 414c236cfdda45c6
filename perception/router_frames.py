"""What the embedded router measures of every 16 ms: mel bands, level, pitch, fine structure."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np
import scipy.fft
from scipy.ndimage import uniform_filter1d

from downbeat.perception.features import F32

SAMPLE_RATE_HZ = 16_000
WINDOW, HOP = 1024, 256
"""64 ms and 16 ms: long enough to resolve a low voice's harmonics, short enough for syllables."""
FRAME_RATE_HZ = SAMPLE_RATE_HZ / HOP
NUM_MELS = 32
MIN_HZ, MAX_HZ = 50.0, 7600.0
PITCH_HZ = (80.0, 500.0)
PITCH_MAX_HZ = 2500.0
"""Harmonics above this say nothing about the pitch and much about the noise."""
FINE_HZ = (200.0, 4000.0)
FINE_WIDTH = 15
"""Bins (230 Hz) of the local mean that is taken off the fine structure: what stays are partials."""
_EPSILON = 1e-9


@dataclass(frozen=True, slots=True)
class Frames:
    """A run of frames; every array has one row per frame.

    Attributes:
        mels: (n, NUM_MELS) power.
        level: (n,) power of the frame above 24 Hz: an offset of the microphone is no sound.
        flatness: (n,) mean log power minus log mean power of 200 to 4000 Hz; 0: noise, low: tones.
        harmonicity: (n,) 0..1, autocorrelation at the best pitch period.
        pitch: (n,) that pitch, log2 of Hz.
        fine: (n, bins) log spectrum of 200 to 4000 Hz without its envelope.
    """

    mels: F32
    level: F32
    flatness: F32
    harmonicity: F32
    pitch: F32
    fine: F32

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.level)

    def last(self, count: int) -> Frames:
        """Return the newest frames."""
        return Frames(*(getattr(self, f.name)[-count:] for f in fields(self)))

    def part(self, first: int, end: int) -> Frames:
        """Return frames first..end-1."""
        return Frames(*(getattr(self, f.name)[first:end] for f in fields(self)))

    def followed_by(self, other: Frames) -> Frames:
        """Return both, one after the other."""
        return Frames(
            *(np.concatenate((getattr(self, f.name), getattr(other, f.name))) for f in fields(self))
        )


class FrameStream:
    """Sound in pieces of any length; the same frames as in one piece."""

    def __init__(self) -> None:
        """Begin with nothing heard."""
        self.reset()

    def reset(self) -> None:
        """Forget what waits for the next frame."""
        self._rest = np.zeros(0, np.float32)

    def push(self, samples: F32) -> Frames:
        """Return the frames that these samples complete.

        Args:
            samples: (n,) mono, 16 kHz, full scale 1, directly after those before.
        """
        heard = np.concatenate((self._rest, np.asarray(samples, np.float32)))
        count = max(0, (len(heard) - WINDOW) // HOP + 1)
        self._rest = heard[count * HOP :]
        if count == 0:
            return NO_FRAMES
        windows = np.lib.stride_tricks.sliding_window_view(heard, WINDOW)[: count * HOP : HOP]
        return analyse(windows)


def analyse(windows: F32) -> Frames:
    """Measure frames.

    Args:
        windows: (n, WINDOW) samples.
    """
    spectrum = scipy.fft.rfft(windows * _window(), axis=1)  # (n, 513)
    power = spectrum.real**2 + spectrum.imag**2
    low, high = (_bin(hertz) for hertz in FINE_HZ)
    log_power = np.log(power[:, low:high] + _EPSILON)  # (n, bins)
    mean_power = power[:, low:high].mean(axis=1)
    fine = log_power - uniform_filter1d(log_power, FINE_WIDTH, axis=1, mode="nearest")
    harmonicity, pitch = _pitch(power)
    return Frames(
        mels=np.asarray(power @ mel_weights(), np.float32),
        level=power[:, 2:].sum(axis=1).astype(np.float32),
        flatness=(log_power.mean(axis=1) - np.log(mean_power + _EPSILON)).astype(np.float32),
        harmonicity=harmonicity,
        pitch=pitch,
        fine=np.clip(fine, -4.0, 4.0).astype(np.float32),
    )


def _pitch(power: F32) -> tuple[F32, F32]:
    """Return (harmonicity, log2 pitch) of power spectra, (n,) each."""
    limited = power[:, : _bin(PITCH_MAX_HZ)]
    correlation = scipy.fft.irfft(limited, WINDOW, axis=1)
    first, end = (round(SAMPLE_RATE_HZ / hertz) for hertz in reversed(PITCH_HZ))
    # The window itself makes long periods look weak.
    scaled = correlation[:, first:end] / (correlation[:, :1] + _EPSILON) / _window_lags()[first:end]
    best = scaled.argmax(axis=1)
    peak = np.clip(scaled[np.arange(len(scaled)), best], 0.0, 1.0)
    pitch = np.log2(SAMPLE_RATE_HZ / (best + first))
    return peak.astype(np.float32), pitch.astype(np.float32)


def _bin(hertz: float) -> int:
    return round(hertz * WINDOW / SAMPLE_RATE_HZ)


@lru_cache(maxsize=1)
def _window() -> F32:
    return np.hanning(WINDOW + 1)[:-1].astype(np.float32)


@lru_cache(maxsize=1)
def _window_lags() -> F32:
    """Return the normalised autocorrelation of the window, (WINDOW,)."""
    power = np.abs(np.fft.rfft(_window(), 2 * WINDOW)) ** 2
    lags = np.fft.irfft(power)[:WINDOW]
    return np.maximum(lags / lags[0], 0.05).astype(np.float32)


@lru_cache(maxsize=1)
def mel_weights() -> F32:
    """Return triangular mel bands, (513, NUM_MELS)."""

    def mel(hertz: float) -> float:
        return float(2595.0 * np.log10(1.0 + hertz / 700.0))

    edges = 700.0 * (
        10.0 ** (np.linspace(mel(MIN_HZ), mel(MAX_HZ), NUM_MELS + 2) / 2595.0) - 1.0
    )  # (NUM_MELS + 2,)
    frequency = np.arange(WINDOW // 2 + 1) * SAMPLE_RATE_HZ / WINDOW
    rising = (frequency[:, None] - edges[:-2]) / (edges[1:-1] - edges[:-2])
    falling = (edges[2:] - frequency[:, None]) / (edges[2:] - edges[1:-1])
    return np.maximum(0.0, np.minimum(rising, falling)).astype(np.float32)


NO_FRAMES = analyse(np.zeros((0, WINDOW), np.float32))
"""Nothing heard."""
