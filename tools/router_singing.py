"""Songs out of speech: words on the notes of a made-up melody, for songs with clear vocals.

A voice activity detector hears some singers and not others. A router that has only met those it
does not hear takes the others for talkers. So the router learns from sung speech, too: vowels
drawn out, a buzz at the notes of a scale with vibrato, shaped by the spectrum of what was said.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from downbeat.perception.features import F32
from downbeat.perception.router_frames import SAMPLE_RATE_HZ
from downbeat.tools.conditions import stretch

ORDER = 18
HOP, FRAME = 160, 400
"""10 ms and 25 ms."""
STRETCH = (1.2, 2.2)
NOTE_S = (0.2, 0.9)
LOWEST_HZ = (100.0, 240.0)
SCALE = (0, 2, 4, 5, 7, 9, 11, 12)
"""Semitones."""
VIBRATO_HZ, VIBRATO_SEMITONES = (4.5, 6.5), 0.5
GLIDE_S = 0.06


def sing(speech: F32, rng: np.random.Generator) -> F32:
    """Return speech sung, as long as it was.

    Args:
        speech: (n,) 16 kHz.
        rng: Draws the melody.
    """
    count = len(speech)
    drawn = stretch(speech, rng.uniform(*STRETCH), SAMPLE_RATE_HZ)[:count]
    drawn = np.pad(drawn, (0, count - len(drawn)))
    excitation = _melody(count, rng)
    window = np.hanning(2 * HOP + 1)[:-1]
    padded = np.pad(drawn, (FRAME // 2, FRAME)).astype(np.float64)
    out = np.zeros(count + 2 * HOP)
    for first in range(0, count - 2 * HOP, HOP):
        frame = padded[first + HOP : first + HOP + FRAME] * np.hanning(FRAME)
        power = float((frame**2).mean())
        if power < 1e-8:
            continue
        correlation = np.correlate(frame, frame, "full")[FRAME - 1 : FRAME + ORDER]
        correlation[0] *= 1.0001  # keeps the filter stable where the frame is one tone
        shape = solve_toeplitz(correlation[:-1], correlation[1:])
        begin = max(0, first - FRAME)
        sung = lfilter([1.0], np.concatenate(([1.0], -shape)), excitation[begin : first + 2 * HOP])
        sung = sung[-2 * HOP :]
        gain = np.sqrt(power / ((sung**2).mean() + 1e-12))
        out[first : first + 2 * HOP] += sung * gain * window
    return out[:count].astype(np.float32)


def _melody(count: int, rng: np.random.Generator) -> F32:
    """Return a buzz on the notes of a scale, with a little breath."""
    base = np.log2(rng.uniform(*LOWEST_HZ))
    pitch = np.empty(count)
    degree, first = int(rng.integers(len(SCALE))), 0
    while first < count:
        length = round(rng.uniform(*NOTE_S) * SAMPLE_RATE_HZ)
        pitch[first : first + length] = base + SCALE[degree] / 12.0
        degree = int(np.clip(degree + rng.integers(-3, 4), 0, len(SCALE) - 1))
        first += length
    glide = 1.0 / (GLIDE_S * SAMPLE_RATE_HZ)
    pitch = lfilter([glide], [1.0, glide - 1.0], pitch - pitch[0]) + pitch[0]
    t = np.arange(count) / SAMPLE_RATE_HZ
    swing = np.sin(2 * np.pi * rng.uniform(*VIBRATO_HZ) * t)
    pitch = pitch + rng.uniform(0.0, VIBRATO_SEMITONES) / 12.0 * swing
    phase = np.cumsum(2.0**pitch) / SAMPLE_RATE_HZ
    pulses = np.diff(np.floor(phase), prepend=0.0)
    breath = rng.uniform(0.01, 0.1) * rng.standard_normal(count)
    return np.asarray(lfilter([1.0], [1.0, -0.7], pulses) + breath)
