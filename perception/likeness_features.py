"""What music sounds like, in numbers: timbre, harmony, rhythm and dynamics of a window of sound.

None of them knows the volume, the key (chroma enters by the size of its Fourier coefficients, which
a transposition does not change) or where in the window a beat falls. Nothing is learned here; which
of them tell pieces apart, and survive a room and a microphone, is learned (likeness_embedded.py).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import scipy.fft
import soxr

from downbeat.perception.features import F32

SAMPLE_RATE_HZ = 16_000
HOP = 320
"""20 ms."""
WINDOW = 1024
MEL_BANDS = 40
MEL_RANGE_HZ = (60.0, 7200.0)
MFCC = 20
CONTRAST_EDGES_HZ = (60.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 7200.0)
CONTRAST_SHARE = 0.2
LONG_WINDOW, LONG_HOP = 4096, 1600
"""256 ms every 100 ms: fine enough for semitones from 110 Hz up."""
CHROMA_RANGE_HZ = (110.0, 2000.0)
LAGS_S = np.geomspace(0.1, 2.5, 33)
"""Of the onsets' autocorrelation: quarter notes of 24 to 600 BPM."""
RHYTHM_BANDS, MODULATION_BANDS = 4, 8
MODULATION_EDGES_HZ = np.geomspace(0.4, 16.0, 9)
FLOOR = 1e-4
"""Of the mean power: 40 dB under it is silence."""


def describe(samples: F32) -> F32:
    """Return the descriptor of one window of sound, (n,).

    Args:
        samples: (m,) mono at 16 kHz, at least three seconds.
    """
    sound = samples - samples.mean()
    sound = sound / (np.sqrt(np.mean(sound**2)) + 1e-9)
    power = _power(sound, WINDOW, HOP)  # (T, 513)
    mel = np.log(power @ _mel_weights() + FLOOR)  # (T, 40)
    parts = [_timbre(mel), _contrast(power), _harmony(sound), _rhythm(mel), _dynamics(power, sound)]
    return np.concatenate(parts).astype(np.float32)


def to_descriptor_rate(samples: F32, sample_rate_hz: int) -> F32:
    """Resample mono samples to 16 kHz, (n,)."""
    samples = np.asarray(samples, np.float32)
    if sample_rate_hz == SAMPLE_RATE_HZ:
        return samples
    return np.asarray(soxr.resample(samples, sample_rate_hz, SAMPLE_RATE_HZ, quality="MQ"))


def _power(sound: F32, window: int, hop: int) -> F32:
    """Return the power spectrum, (frames, window // 2 + 1), per bin about 1 for white noise."""
    frames = np.lib.stride_tricks.sliding_window_view(sound, window)[::hop]
    taper = np.hanning(window + 1)[:-1].astype(np.float32)
    spectrum = scipy.fft.rfft(frames * taper, axis=1)
    return (spectrum.real**2 + spectrum.imag**2) / np.float32(np.sum(taper**2))


@lru_cache(maxsize=1)
def _mel_weights() -> F32:
    """Return triangles on the mel axis that sum to 1 each, (513, 40)."""
    low, high = (2595.0 * np.log10(1.0 + hz / 700.0) for hz in MEL_RANGE_HZ)
    corners = 700.0 * (10.0 ** (np.linspace(low, high, MEL_BANDS + 2) / 2595.0) - 1.0)
    hz = np.arange(WINDOW // 2 + 1) * SAMPLE_RATE_HZ / WINDOW
    rising = (hz[:, None] - corners[:-2]) / np.diff(corners)[:-1]
    falling = (corners[2:] - hz[:, None]) / np.diff(corners)[1:]
    weights = np.maximum(0.0, np.minimum(rising, falling))
    nearest = np.argmin(np.abs(hz[:, None] - corners[1:-1]), axis=0)
    weights[nearest, np.arange(MEL_BANDS)] += 1e-3  # low triangles may miss every bin
    return (weights / weights.sum(axis=0)).astype(np.float32)


def _timbre(mel: F32) -> F32:
    """Return mean (without loudness), deviation and mean change of MFCCs, (19 + 20 + 13,)."""
    mfcc = scipy.fft.dct(mel, axis=1, norm="ortho")[:, :MFCC]  # (T, 20)
    change = np.abs(np.diff(mfcc[:, :13], axis=0)).mean(axis=0)
    return np.concatenate([mfcc[:, 1:].mean(axis=0), mfcc.std(axis=0), change])


def _contrast(power: F32) -> F32:
    """Return peaks over valleys per octave, mean and deviation over time, (12,)."""
    bins = np.searchsorted(_bin_hz(), CONTRAST_EDGES_HZ)
    rows = []
    for low, high in zip(bins[:-1], bins[1:]):
        octave = np.log(power[::2, low:high] + FLOOR)
        count = max(1, round(CONTRAST_SHARE * (high - low)))
        octave = np.partition(octave, (count - 1, high - low - count), axis=1)
        rows.append(octave[:, -count:].mean(axis=1) - octave[:, :count].mean(axis=1))
    contrast = np.array(rows)  # (6, T / 2)
    return np.concatenate([contrast.mean(axis=1), contrast.std(axis=1)])


def _bin_hz() -> F32:
    return (np.arange(WINDOW // 2 + 1) * (SAMPLE_RATE_HZ / WINDOW)).astype(np.float32)


@lru_cache(maxsize=1)
def _chroma_weights() -> F32:
    """Return which bin sounds which semitone, (2049, 12)."""
    hz = np.arange(LONG_WINDOW // 2 + 1) * SAMPLE_RATE_HZ / LONG_WINDOW
    weights = np.zeros((len(hz), 12), np.float32)
    usable = np.flatnonzero((hz >= CHROMA_RANGE_HZ[0]) & (hz <= CHROMA_RANGE_HZ[1]))
    position = 12.0 * np.log2(hz[usable] / 440.0)
    low = np.floor(position).astype(int)
    share = position - low
    weights[usable, low % 12] = 1.0 - share
    weights[usable, (low + 1) % 12] = share
    return weights


def _harmony(sound: F32) -> F32:
    """Return what a transposition does not change, (6 + 6 + 6 + 3 + 8,)."""
    power = _power(sound, LONG_WINDOW, LONG_HOP)  # (T', 2049)
    tone = np.log1p(power)
    chroma = tone @ _chroma_weights()
    chroma = chroma / (chroma.sum(axis=1, keepdims=True) + 1e-6)  # (T', 12)
    intervals = np.abs(scipy.fft.rfft(chroma, axis=1))[:, 1:]  # (T', 6)
    mean = chroma.mean(axis=0)
    entropy = -(chroma * np.log(chroma + 1e-6)).sum(axis=1)
    change = np.abs(np.diff(chroma, axis=0)).sum(axis=1).mean()
    flatness = []
    for low, high in zip((15, 64, 256, 1024), (64, 256, 1024, 1843)):
        part = power[:, low:high] + 1e-7
        flat = np.log(part).mean(axis=1) - np.log(part.mean(axis=1))
        flatness += [flat.mean(), flat.std()]
    return np.concatenate([
        intervals.mean(axis=0), intervals.std(axis=0), np.abs(scipy.fft.rfft(mean))[1:],
        [entropy.mean(), entropy.std(), change], flatness,
    ])  # fmt: skip


def _rhythm(mel: F32) -> F32:
    """Return beat spectra of four bands, peakiness of onsets, and modulations, (132 + 8 + 64,)."""
    rate_hz = SAMPLE_RATE_HZ / HOP
    rises = np.maximum(0.0, np.diff(mel, axis=0))
    onsets = rises.reshape(len(rises), RHYTHM_BANDS, -1).mean(axis=2)  # (T, 4)
    peaks = np.sort(onsets, axis=0)
    mean = onsets.mean(axis=0) + 1e-6
    shape = np.concatenate([mean, np.log((peaks[-len(peaks) // 20 :].mean(axis=0) + 1e-6) / mean)])
    centred = onsets - mean
    size = 2 * len(centred)
    spectrum = np.abs(scipy.fft.rfft(centred, size, axis=0)) ** 2
    echo = scipy.fft.irfft(spectrum, size, axis=0)[: len(centred)]
    echo = echo / (echo[:1] + 1e-6)  # (T, 4)
    lags = np.minimum(LAGS_S * rate_hz, len(echo) - 2)
    low = lags.astype(int)
    share = (lags - low)[:, None]
    beat = echo[low] * (1.0 - share) + echo[low + 1] * share  # (33, 4)
    bands = mel.reshape(len(mel), MODULATION_BANDS, -1).mean(axis=2)
    waves = np.abs(scipy.fft.rfft(bands - bands.mean(axis=0), axis=0)) ** 2 / len(bands)
    edges = np.round(MODULATION_EDGES_HZ * len(bands) / rate_hz).astype(int)
    grouped = [
        waves[a : max(b, a + 1)].mean(axis=0)
        for a, b in zip(edges[:-1], edges[1:])
    ]  # fmt: skip
    return np.concatenate([beat.ravel(), shape, np.log(np.array(grouped) + 1e-3).ravel()])


def _dynamics(power: F32, sound: F32) -> F32:
    """Return spread of loudness, brightness, noisiness and their changes, (15,)."""
    loud = 10.0 * np.log10(power.mean(axis=1) + FLOOR)  # (T,) [dB]
    spread = np.diff(np.percentile(loud, (5, 25, 50, 75, 95)))
    total = power.sum(axis=1) + 1e-6
    centre = np.log((power @ _bin_hz()) / total + 50.0)
    rolled = np.argmax(np.cumsum(power, axis=1) >= 0.85 * total[:, None], axis=1)
    rolled = np.log(rolled + 1.0)
    crossings = np.abs(np.diff(np.signbit(sound))).mean()
    share = np.sqrt(power / total[:, None])
    change = np.sqrt(np.square(np.diff(share, axis=0)).sum(axis=1))
    crest = np.log(np.abs(sound).max() + 1e-6)
    rows = [centre.mean(), centre.std(), rolled.mean(), rolled.std(), change.mean(), change.std()]
    quiet = np.mean(loud < loud.mean() - 6.0)
    return np.array(
        [*spread, loud.std(), *rows, crossings, crest, quiet, np.abs(np.diff(loud)).mean()]
    )
