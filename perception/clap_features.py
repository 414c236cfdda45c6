"""The front end of CLAP in numpy: ten seconds of sound at 48 kHz as a log-mel picture.

Both families of checkpoints, laion-clap and transformers' ClapModel, use the same picture (Hann
window, reflected edges, Slaney's mel scale, decibel); they differ in what is written down in
`FrontEnd`. The tests compare it with either of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import scipy.fft
import soxr

from downbeat.perception.features import F32

SLANEY_BREAK_HZ, SLANEY_LINEAR = 1000.0, 200.0 / 3.0
SLANEY_LOG_STEP = np.log(6.4) / 27.0
"""Slaney's mel scale: 66.7 Hz per mel up to 1 kHz, then 27 mel per factor 6.4."""
POWER_FLOOR = 1e-10
INT16_SCALE = 32_767.0


@dataclass(frozen=True)
class FrontEnd:
    """What a checkpoint was trained to see.

    Attributes:
        sample_rate_hz: [Hz].
        window: Samples per frame.
        hop: Samples from frame to frame.
        mel_bands: Rows of the picture.
        min_hz: Lowest edge of the bands [Hz].
        max_hz: Highest edge [Hz].
        clip_samples: Sound is repeated, or cut, to this length.
        is_quantised: Samples are rounded to 16 bit first, as laion-clap does.
    """

    sample_rate_hz: int = 48_000
    window: int = 1024
    hop: int = 480
    mel_bands: int = 64
    min_hz: float = 50.0
    max_hz: float = 14_000.0
    clip_samples: int = 480_000
    is_quantised: bool = False

    @property
    def frames(self) -> int:
        """Columns of the picture."""
        return self.clip_samples // self.hop + 1

    @property
    def clip_s(self) -> float:
        """Length of the sound it sees [s]."""
        return self.clip_samples / self.sample_rate_hz


def clap_picture(samples: F32, sample_rate_hz: int, front: FrontEnd) -> F32:
    """Return the log-mel picture, (frames, mel_bands) [dB].

    Args:
        samples: (n,) mono; the newest `clip_s` are seen; what is shorter is repeated as often as
            it fits whole, then followed by silence, as in training.
        sample_rate_hz: [Hz].
        front: Of the checkpoint.
    """
    sound = np.asarray(samples, np.float32)
    if sample_rate_hz != front.sample_rate_hz:
        sound = np.asarray(soxr.resample(sound, sample_rate_hz, front.sample_rate_hz, "HQ"))
    sound = sound[-front.clip_samples :]
    if front.is_quantised:
        sound = (np.clip(sound, -1.0, 1.0) * INT16_SCALE).astype(np.int16) / np.float32(INT16_SCALE)
    sound = np.tile(sound, front.clip_samples // len(sound))
    sound = np.pad(sound, (0, front.clip_samples - len(sound)))
    sound = np.pad(sound, front.window // 2, mode="reflect").astype(np.float32)
    frames = np.lib.stride_tricks.sliding_window_view(sound, front.window)[:: front.hop]
    taper = np.hanning(front.window + 1)[:-1].astype(np.float32)
    spectrum = scipy.fft.rfft(frames * taper, axis=1)
    power = spectrum.real**2 + spectrum.imag**2  # (frames, window // 2 + 1)
    mel = np.maximum(power @ slaney_weights(front), POWER_FLOOR)
    return np.asarray(10.0 * np.log10(mel), np.float32)


@lru_cache(maxsize=4)
def slaney_weights(front: FrontEnd) -> F32:
    """Return triangles of equal area on Slaney's mel scale, (window // 2 + 1, mel_bands)."""
    low, high = (_mel(hz) for hz in (front.min_hz, front.max_hz))
    corners = _hz(np.linspace(low, high, front.mel_bands + 2))
    hz = np.arange(front.window // 2 + 1) * front.sample_rate_hz / front.window
    rising = (hz[:, None] - corners[:-2]) / np.diff(corners)[:-1]
    falling = (corners[2:] - hz[:, None]) / np.diff(corners)[1:]
    weights = np.maximum(0.0, np.minimum(rising, falling))
    return (weights * 2.0 / (corners[2:] - corners[:-2])).astype(np.float32)


def _mel(hz: float) -> float:
    if hz < SLANEY_BREAK_HZ:
        return hz / SLANEY_LINEAR
    above = np.log(hz / SLANEY_BREAK_HZ) / SLANEY_LOG_STEP
    return float(SLANEY_BREAK_HZ / SLANEY_LINEAR + above)


def _hz(mel: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    above = mel - SLANEY_BREAK_HZ / SLANEY_LINEAR
    return np.where(
        above < 0.0, mel * SLANEY_LINEAR, SLANEY_BREAK_HZ * np.exp(SLANEY_LOG_STEP * above)
    )
