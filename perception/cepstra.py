"""Mel cepstra as the acoustic model of pocketsphinx was trained on them."""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray

from downbeat.perception.features import F32

SAMPLE_RATE_HZ = 16_000
FRAME_SAMPLES = 160
"""Ten milliseconds from a frame to the next."""

_WINDOW_SAMPLES, _FFT = 410, 512
_FILTERS, _CEPSTRA, _LIFTER = 25, 13, 22
_LOW_HZ, _HIGH_HZ = 130.0, 6800.0
_FULL_SCALE = 32768.0
_FLOOR = 1e-4
_DITHER = 10 ** (-40 / 20)
"""Of the loud third of the sound."""
_LEAST_DITHER = 1e-5
_QUIET, _QUIET_FRAMES = 0.2, 8
_CARRY = 0.9
_LEAST_GAIN = 10 ** (-12 / 20)
_UNDER = 10 ** (-30 / 10)
"""Of the mean energy: the floor."""


def dithered(sound: F32) -> F32:
    """Return the sound with a little white noise, the same at every call.

    Digital silence and very clean sound are unlike everything that the model was trained on.

    Args:
        sound: (n,) full scale 1.
    """
    loud = np.sort(sound.astype(np.float64) ** 2)[-max(len(sound) // 3, 1) :]
    level = max(math.sqrt(float(loud.mean())) * _DITHER, _LEAST_DITHER)
    noise = np.random.default_rng(1).standard_normal(len(sound))
    return (sound + level * noise).astype(np.float32)


def mel_spectrum(sound: F32, warp: float = 1.0) -> F32:
    """Return (t, 25) energies in mel bands, of samples of sixteen bits.

    Args:
        sound: (n,) mono, 16 kHz, full scale 1.
        warp: The bands are moved up by this factor: for a shorter vocal tract.
    """
    x = sound.astype(np.float64) * _FULL_SCALE
    x = np.append(x[0] * (1 - 0.97), x[1:] - 0.97 * x[:-1])
    count = max((len(x) - _WINDOW_SAMPLES) // FRAME_SAMPLES + 1, 1)
    x = np.pad(x, (0, max(_WINDOW_SAMPLES - len(x), 0)))
    frames = np.lib.stride_tricks.sliding_window_view(x, _WINDOW_SAMPLES)[::FRAME_SAMPLES][:count]
    power = np.abs(np.fft.rfft(frames * np.hamming(_WINDOW_SAMPLES), _FFT)) ** 2
    return (power @ _filterbank(warp).T).astype(np.float32)


def without_noise(mel: F32) -> F32:
    """Return mel energies with steady noise attenuated, so that fricatives keep their shape.

    A Wiener filter per band; the noise is what the quietest fifth of the frames has, and what is
    speech is carried on from frame to frame (decision-directed), or the gain would flicker. A floor
    far below the speech stays.

    Args:
        mel: (t, 25) energies of one utterance with a little of what is around it.
    """
    quiet = np.argsort(np.log(mel + _FLOOR).mean(axis=1))
    quiet = quiet[: max(round(_QUIET * len(mel)), _QUIET_FRAMES)]
    noisy = mel / (mel[quiet].mean(axis=0) + _FLOOR)  # ratio to the noise
    gain = np.empty_like(mel)
    before = np.maximum(noisy[0] - 1, 0)
    for frame, ratio in enumerate(noisy):
        likely = _CARRY * before + (1 - _CARRY) * np.maximum(ratio - 1, 0)
        gain[frame] = np.maximum(likely / (1 + likely), _LEAST_GAIN)
        before = gain[frame] ** 2 * ratio
    clean = mel * gain**2
    return (clean + _UNDER * mel.mean()).astype(np.float32)


def cepstra(mel: F32) -> F32:
    """Return (t, 13) cepstra with their mean removed from (t, 25) mel energies."""
    logs = np.log(mel + _FLOOR)
    found = logs @ _transform().T
    return (found - found.mean(axis=0)).astype(np.float32)


def streams(cepstrum: F32) -> F32:
    """Return (t, 3, 13): cepstra, first and second differences, as the codebooks want them."""
    x = np.pad(cepstrum, ((3, 3), (0, 0)), mode="edge")
    count = len(cepstrum)

    def at(shift: int) -> F32:
        return x[3 + shift : 3 + shift + count]

    first = at(2) - at(-2)
    second = (at(3) - at(-1)) - (at(1) - at(-3))
    return np.stack((cepstrum, first, second), axis=1)


@functools.lru_cache(maxsize=16)
def _filterbank(warp: float) -> NDArray[np.float64]:
    """Return (25, 257) triangles of equal area."""

    def mel(hertz: float) -> float:
        return 2595.0 * math.log10(1.0 + hertz / 700.0)

    step = SAMPLE_RATE_HZ / _FFT
    marks = np.linspace(mel(_LOW_HZ), mel(_HIGH_HZ), _FILTERS + 2)
    edges = np.round((700.0 * (10 ** (marks / 2595.0) - 1)) * warp / step) * step
    hertz = np.arange(_FFT // 2 + 1) * step
    low, middle, high = (edges[k : k + _FILTERS, None] for k in range(3))
    rising = (hertz - low) / (middle - low)
    falling = (high - hertz) / (high - middle)
    return np.clip(np.minimum(rising, falling), 0, None) * 2.0 / (high - low)


@functools.lru_cache(maxsize=1)
def _transform() -> NDArray[np.float64]:
    """Return (13, 25): cosine transform and lifter."""
    order = np.arange(_CEPSTRA)[:, None]
    cosine = np.cos(math.pi * order * (np.arange(_FILTERS) + 0.5) / _FILTERS)
    scale = np.where(order == 0, math.sqrt(1 / _FILTERS), math.sqrt(2 / _FILTERS))
    lifter = 1 + _LIFTER / 2 * np.sin(math.pi * order / _LIFTER)
    return cosine * scale * lifter
