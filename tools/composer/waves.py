"""Oscillators and envelopes: arrays at the studio's rate, without aliasing and clicks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

RATE_HZ = 44_100
F64 = NDArray[np.float64]


def count(seconds: float) -> int:
    """Return the number of samples of a duration."""
    return round(seconds * RATE_HZ)


def seconds_axis(seconds: float) -> F64:
    """Return the times of a duration's samples [s], (n,)."""
    return np.arange(count(seconds)) / RATE_HZ


def phase_of(hz: float | F64, seconds: float, start: float = 0.0) -> F64:
    """Return the phase in turns, 0..1, of a constant or moving frequency, (n,)."""
    if isinstance(hz, float):
        return (start + hz * seconds_axis(seconds)) % 1.0
    return (start + np.concatenate([[0.0], np.cumsum(hz[:-1])]) / RATE_HZ) % 1.0


def sine(hz: float | F64, seconds: float, start: float = 0.0) -> F64:
    """Return a sine, (n,)."""
    return np.sin(2.0 * np.pi * phase_of(hz, seconds, start))


def saw(hz: float, seconds: float, start: float = 0.0) -> F64:
    """Return a saw whose step is rounded over one sample (PolyBLEP), (n,)."""
    phase = phase_of(hz, seconds, start)
    step = hz / RATE_HZ
    return 2.0 * phase - 1.0 - _rounded_step(phase, step)


def pulse(hz: float, seconds: float, width: float = 0.5, start: float = 0.0) -> F64:
    """Return a pulse wave of a duty cycle, free of a constant part, (n,)."""
    return saw(hz, seconds, start) - saw(hz, seconds, start + width)


def _rounded_step(phase: F64, step: float) -> F64:
    residual = np.zeros_like(phase)
    after = phase < step
    ratio = phase[after] / step
    residual[after] = 2.0 * ratio - ratio * ratio - 1.0
    before = phase > 1.0 - step
    ratio = (phase[before] - 1.0) / step
    residual[before] = ratio * ratio + 2.0 * ratio + 1.0
    return residual


def chorus_of_saws(hz: float, seconds: float, voices: int, detune_cents: float) -> F64:
    """Return a supersaw: saws spread over +-`detune_cents`, phases apart by the golden ratio."""
    spread = np.linspace(-1.0, 1.0, voices) if voices > 1 else np.zeros(1)
    total = np.zeros(count(seconds))
    for index, place in enumerate(spread):
        ratio = 2.0 ** (float(place) * detune_cents / 1200.0)
        total += saw(hz * ratio, seconds, 0.618034 * index)
    return total / np.sqrt(voices)


def noise(seconds: float, seed: int) -> F64:
    """Return white noise, (n,)."""
    return np.random.default_rng(seed).standard_normal(count(seconds))


def adsr(
    seconds: float,
    attack_s: float,
    decay_s: float = 0.0,
    sustain: float = 1.0,
    release_s: float = 0.02,
) -> F64:
    """Return an envelope over the whole duration, release included; it starts and ends at 0."""
    times = seconds_axis(seconds)
    release_s = min(release_s, 0.5 * seconds)
    attack_s = min(attack_s, 0.4 * seconds)
    level = np.minimum(times / max(attack_s, 1e-4), 1.0)
    if decay_s > 0.0:
        fallen = sustain + (1.0 - sustain) * np.exp(-(times - attack_s) / decay_s)
        level = np.where(times < attack_s, level, fallen)
    end = np.clip((seconds - times) / release_s, 0.0, 1.0)
    return level * end * end * (3.0 - 2.0 * end)


def fall(seconds: float, time_constant_s: float, attack_s: float = 0.001) -> F64:
    """Return an exponential fall with a short attack and a faded end."""
    times = seconds_axis(seconds)
    rise = np.minimum(times / attack_s, 1.0)
    end = np.clip((seconds - times) / min(0.02, 0.3 * seconds), 0.0, 1.0)
    return rise * np.exp(-times / time_constant_s) * end
