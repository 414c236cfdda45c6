"""Effects: filters, room, echo, drive, ducking, compressor, limiter; offline and vectorised."""

from __future__ import annotations

import numpy as np
import scipy.fft
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.signal import butter, lfilter, sosfilt

from downbeat.tools.composer.waves import F64, RATE_HZ, count, noise, seconds_axis

SWEEP_BLOCK = 512
CONTROL_BLOCK = 64
"""Levels are followed at 689 Hz: fast enough for a compressor, cheap enough for a loop."""


def lowpass(sound: F64, hz: float, order: int = 2) -> F64:
    """Keep what lies below `hz`."""
    return np.asarray(sosfilt(butter(order, hz, "low", fs=RATE_HZ, output="sos"), sound))


def highpass(sound: F64, hz: float, order: int = 2) -> F64:
    """Keep what lies above `hz`."""
    return np.asarray(sosfilt(butter(order, hz, "high", fs=RATE_HZ, output="sos"), sound))


def bandpass(sound: F64, low_hz: float, high_hz: float, order: int = 2) -> F64:
    """Keep what lies between."""
    sections = butter(order, (low_hz, high_hz), "band", fs=RATE_HZ, output="sos")
    return np.asarray(sosfilt(sections, sound))


def peak(sound: F64, hz: float, gain: float, quality: float = 3.0) -> F64:
    """Add `gain` times a resonance around `hz` (a formant, a boost)."""
    half = hz / (2.0 * quality)
    return sound + gain * bandpass(sound, hz - half, hz + half, order=1)


def swept_lowpass(sound: F64, cutoff_hz: F64) -> F64:
    """Low-pass with a moving cutoff; the state is carried from block to block.

    Args:
        sound: (n,).
        cutoff_hz: (blocks,) one value per 512 samples; the last one is held.
    """
    out = np.empty_like(sound)
    state = np.zeros((1, 2))
    for block, first in enumerate(range(0, len(sound), SWEEP_BLOCK)):
        hz = float(cutoff_hz[min(block, len(cutoff_hz) - 1)])
        part = slice(first, first + SWEEP_BLOCK)
        out[part], state = sosfilt(_lowpass_sos(hz), sound[part], zi=state)
    return out


def _lowpass_sos(hz: float) -> F64:
    """Return one biquad low-pass, (1, 6): `butter` itself would cost more than the filtering."""
    turn = np.tan(np.pi * min(hz, 0.45 * RATE_HZ) / RATE_HZ)
    scale = 1.0 / (1.0 + np.sqrt(2.0) * turn + turn * turn)
    b = turn * turn * scale
    a1 = 2.0 * (turn * turn - 1.0) * scale
    a2 = (1.0 - np.sqrt(2.0) * turn + turn * turn) * scale
    return np.array([[b, 2.0 * b, b, 1.0, a1, a2]])


def drive(sound: F64, amount: float) -> F64:
    """Saturate softly; small signals keep their level."""
    return np.tanh(amount * sound) / amount


def room(
    decay_s: float, seed: int, brightness_hz: float = 5_000.0, pre_delay_s: float = 0.012
) -> F64:
    """Return a synthetic impulse response: noise whose treble dies three times faster."""
    length_s = 1.6 * decay_s
    times = seconds_axis(length_s)
    tail = noise(length_s, seed)
    dark = lowpass(tail, brightness_hz, order=1)
    response = dark * np.exp(-6.9 * times / decay_s)
    response += 0.5 * (tail - dark) * np.exp(-20.0 * times / decay_s)
    response *= np.minimum(times / 0.01, 1.0)
    response = np.concatenate([np.zeros(count(pre_delay_s)), response])
    return response / np.sqrt(np.sum(response**2))


def spring(decay_s: float, seed: int) -> F64:
    """Return the response of a spring tank: dull, with chirping echoes."""
    times = seconds_axis(1.4 * decay_s)
    response = np.zeros_like(times)
    for number, period_s in enumerate((0.033, 0.041, 0.0515)):
        for turn in range(1, int(decay_s / period_s)):
            first = count(turn * period_s)
            chirp_s = 0.012 + 0.004 * turn
            local = seconds_axis(min(chirp_s, 0.06))
            span = slice(first, first + len(local))
            sweep = np.sin(2.0 * np.pi * (3_800.0 * local - 22_000.0 * local**2) + number)
            level = np.exp(-6.9 * turn * period_s / decay_s) * (-1.0) ** (turn + number)
            response[span] += (level * sweep * np.hanning(len(local)))[: len(response[span])]
    response += 0.15 * noise(1.4 * decay_s, seed) * np.exp(-6.9 * times / decay_s)
    response = bandpass(response, 120.0, 4_200.0)
    return response / np.sqrt(np.sum(response**2))


def convolve(sound: F64, response: F64) -> F64:
    """Return the sound in the room, as long as the dry one."""
    size = scipy.fft.next_fast_len(len(sound) + len(response), real=True)
    spectrum = scipy.fft.rfft(sound.astype(np.float32), size)
    spectrum *= scipy.fft.rfft(response.astype(np.float32), size)
    return np.asarray(scipy.fft.irfft(spectrum, size)[: len(sound)], np.float64)


def echo(sound: F64, delay_s: float, feedback: float, damp_hz: float = 3_500.0) -> F64:
    """Return repeats only (no dry sound), each duller than the one before."""
    total = np.zeros_like(sound)
    repeat = sound
    level = 1.0
    shift = count(delay_s)
    while level > 0.02 and shift < len(sound):
        repeat = np.concatenate([np.zeros(shift), lowpass(repeat, damp_hz, order=1)[:-shift]])
        level *= feedback
        total += level * repeat
    return total


def tremolo(sound: F64, hz: float, depth: float) -> F64:
    """Move the level up and down."""
    times = np.arange(len(sound)) / RATE_HZ
    return sound * (1.0 - depth * (0.5 + 0.5 * np.sin(2.0 * np.pi * hz * times)))


def ducking(length: int, onsets_s: list[float], depth: float, recover_s: float) -> F64:
    """Return the gain curve of a side chain: down at every onset, back in `recover_s`, (n,)."""
    gain = np.ones(length)
    shape_s = seconds_axis(recover_s)
    shape = 1.0 - depth * 0.5 * (1.0 + np.cos(np.pi * shape_s / recover_s))
    rise = np.linspace(1.0, float(shape[0]), count(0.004))
    for onset_s in onsets_s:
        first = count(onset_s)
        lead = max(0, first - len(rise))
        gain[lead:first] = np.minimum(gain[lead:first], rise[len(rise) - (first - lead) :])
        span = slice(first, min(first + len(shape), length))
        gain[span] = np.minimum(gain[span], shape[: span.stop - span.start])
    return gain


def compress(sound: F64, threshold_db: float, ratio: float, release_s: float = 0.12) -> F64:
    """Hold loud passages back, following the level at control rate."""
    blocks = -(-len(sound) // CONTROL_BLOCK)
    padded = np.pad(sound, (0, blocks * CONTROL_BLOCK - len(sound)))
    power = (padded.reshape(blocks, CONTROL_BLOCK) ** 2).mean(axis=1)
    level_db = 10.0 * np.log10(power + 1e-12)
    attack = 1.0 - np.exp(-CONTROL_BLOCK / (0.010 * RATE_HZ))
    release = 1.0 - np.exp(-CONTROL_BLOCK / (release_s * RATE_HZ))
    followed = np.empty(blocks)
    state = -60.0
    for index, value in enumerate(level_db.tolist()):
        state += (attack if value > state else release) * (value - state)
        followed[index] = state
    gain_db = -np.maximum(followed - threshold_db, 0.0) * (1.0 - 1.0 / ratio)
    places = (np.arange(blocks) + 0.5) * CONTROL_BLOCK
    curve = np.interp(np.arange(len(sound)), places, 10.0 ** (gain_db / 20.0))
    return sound * curve


def limit(sound: F64, ceiling: float) -> F64:
    """Keep every sample below `ceiling`: looks ahead, so that no wave form is clipped."""
    window = count(0.004) | 1
    loudest = maximum_filter1d(np.abs(sound), 2 * window + 1)
    gain = ceiling / np.maximum(loudest, ceiling)
    release = np.exp(-1.0 / (0.05 * RATE_HZ))
    gain = np.minimum(gain, 1.0 - lfilter([1.0 - release], [1.0, -release], 1.0 - gain))
    return sound * uniform_filter1d(gain, window)
