"""Pieces of single sounds and of bare drums, as we make them: what can be mistaken for anything.

Few real pieces are like that, and those few are where a listener hears voices and clicks as music:
a click and a pause fit any other click and pause, and a drum machine any other at its tempo.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from downbeat.perception.features import F32
from downbeat.perception.source import Recording
from downbeat.perception.verdict import F64

NAME = "sparse"
"""Begins the names of pieces."""
PIECE_S = 40.0
SOUNDS = (1, 6)
"""So many different sounds make a piece, fewest and most."""
PAUSES_S = (0.25, 3.0)
FLOOR_DB = (-110.0, -45.0)
"""Between the sounds is noise of this level, or nothing."""
FLOOR_SHARE = 0.7
"""Of pieces that have noise at all."""
LEVEL = 0.3
STEPS, STEPS_PER_BEAT = 16, 4
"""Of a drum machine's bar."""
TEMPI_BPM = (80.0, 170.0)
PART_BARS = (1, 4)
"""A pattern lasts so many bars before it repeats, fewest and most."""
PARTS = (2, 4)
"""A loop has so many patterns, one after the other."""
PART_S = 8.0
SWING = 0.02
"""Hits differ in loudness by so much of it, as a drum machine's do: hardly."""

Rng = np.random.Generator


def sparse_pieces(count: int, seed: int, sample_rate_hz: int) -> list[Recording]:
    """Return pieces of a few sounds each, every second one a drum machine's.

    In time or at random, over noise or over nothing.

    Args:
        count: Of pieces.
        seed: Of all of them.
        sample_rate_hz: Of the recordings.
    """
    return [
        Recording(
            f"{NAME} {seed} {number}",
            _piece(np.random.default_rng([seed, number]), sample_rate_hz, is_loop=number % 2 == 1),
            sample_rate_hz,
        )
        for number in range(count)
    ]


def _piece(rng: Rng, rate: int, is_loop: bool) -> F32:
    count = round(PIECE_S * rate)
    piece = np.zeros(count)
    (_loop if is_loop else _singles)(piece, rng, rate)
    if rng.random() < FLOOR_SHARE:
        level = np.abs(piece).max() * 10.0 ** (rng.uniform(*FLOOR_DB) / 20.0)
        piece += level * rng.standard_normal(count)
    return np.asarray(LEVEL * piece / np.abs(piece).max(), np.float32)


def _singles(piece: F64, rng: Rng, rate: int) -> None:
    """Put sounds and pauses into a piece."""
    sounds = [_sound(rng, rate) for _ in range(int(rng.integers(SOUNDS[0], SOUNDS[1] + 1)))]
    beat_s = float(rng.uniform(*PAUSES_S))
    is_in_time, is_ever_new = rng.random() < 0.5, rng.random() < 0.3
    now_s = float(rng.uniform(0.0, 1.0))
    while now_s < PIECE_S:
        sound = _sound(rng, rate) if is_ever_new else sounds[int(rng.integers(len(sounds)))]
        _put(piece, now_s, float(rng.uniform(0.3, 1.0)) * sound, rate)
        now_s += beat_s if is_in_time else float(rng.uniform(PAUSES_S[0], 2.0 * beat_s))


def _loop(piece: F64, rng: Rng, rate: int) -> None:
    """Put a drum machine into a piece: few sounds, patterns of some bars over and over."""
    drums = [_kick(rng, rate), _snare(rng, rate), _hat(rng, rate), _sound(rng, rate)]
    step_s = 60.0 / float(rng.uniform(*TEMPI_BPM)) / STEPS_PER_BEAT
    patterns = [
        _pattern(rng, int(rng.integers(PART_BARS[0], PART_BARS[1] + 1)))
        for _ in range(int(rng.integers(PARTS[0], PARTS[1] + 1)))
    ]
    for step in range(int(PIECE_S / step_s)):
        pattern = patterns[int(step * step_s / PART_S) % len(patterns)]
        for drum, hits in zip(drums, pattern, strict=True):
            loud = hits[step % len(hits)]
            if loud > 0.0:
                _put(piece, step * step_s, loud * (1.0 + SWING * rng.normal()) * drum, rate)


def _pattern(rng: Rng, bars: int) -> F64:
    """Return how loud each drum is at each step of some bars, (4, steps): 0 where it is not hit."""
    steps = np.arange(bars * STEPS)
    in_bar = steps % STEPS
    kick = (in_bar % 8 == 0) | (rng.random(len(steps)) < rng.uniform(0.0, 0.2))
    snare = (in_bar % 8 == 4) | (rng.random(len(steps)) < rng.uniform(0.0, 0.1))
    hat = in_bar % int(rng.choice([1, 2, 4])) == 0
    more = rng.random(len(steps)) < rng.uniform(0.0, 0.15)
    plays = np.stack([kick, snare, hat, more]) & (rng.random(4) < 0.8)[:, None]
    if not plays.any():
        plays[0] = kick
    return plays * rng.uniform(0.3, 1.0, (4, 1))


def _kick(rng: Rng, rate: int) -> F32:
    t = _times(rng, rate, 0.15, 0.4)
    low, drop = rng.uniform(40.0, 80.0), rng.uniform(50.0, 200.0)
    fall = rng.uniform(20.0, 60.0)
    turns = low * t + drop / fall * (1.0 - np.exp(-fall * t))
    return _shaped(np.sin(2.0 * np.pi * turns), t, float(rng.uniform(8.0, 20.0)))


def _snare(rng: Rng, rate: int) -> F32:
    t = _times(rng, rate, 0.1, 0.3)
    skin = np.sin(2.0 * np.pi * rng.uniform(150.0, 260.0) * t)
    wires = rng.standard_normal(len(t))
    share = rng.uniform(0.2, 0.8)
    return _shaped(share * skin + (1.0 - share) * wires, t, float(rng.uniform(12.0, 30.0)))


def _hat(rng: Rng, rate: int) -> F32:
    t = _times(rng, rate, 0.03, 0.2)
    hiss = np.diff(rng.standard_normal(len(t) + 1))
    return _shaped(hiss, t, float(rng.uniform(30.0, 90.0)))


def _times(rng: Rng, rate: int, shortest_s: float, longest_s: float) -> F64:
    return np.arange(round(rng.uniform(shortest_s, longest_s) * rate)) / rate


def _put(piece: F64, at_s: float, sound: F32, rate: int) -> None:
    part = piece[round(at_s * rate) :][: len(sound)]
    part += sound[: len(part)]


def _shaped(wave: npt.NDArray[Any], t: F64, decay: float) -> F32:
    """Return a wave that dies away and ends without a click, its peak 1."""
    fade = np.minimum(1.0, np.minimum(t, t[::-1]) / 0.003)
    sound = wave * fade * np.exp(-t * decay)
    return np.asarray(sound / (np.abs(sound).max() + 1e-9), np.float32)


def _sound(rng: Rng, rate: int) -> F32:
    """Return one sound: a tone, a pluck, a click, a knock, a hiss or a glide."""
    t = _times(rng, rate, 0.05, 0.8)
    hertz = float(np.exp(rng.uniform(np.log(100.0), np.log(3_000.0))))
    tone = 2.0 * np.pi * hertz * t
    kinds: tuple[Callable[[], npt.NDArray[Any]], ...] = (
        lambda: np.sin(tone),
        lambda: np.sum([np.sin(n * tone) / n for n in range(1, 8)], axis=0),
        lambda: rng.standard_normal(len(t)) * np.exp(-t * 300.0),
        lambda: np.sin(tone) * np.exp(-t * 60.0) + 0.3 * rng.standard_normal(len(t)),
        lambda: np.diff(rng.standard_normal(len(t) + 1)),
        lambda: np.sin(tone * (1.0 + float(rng.uniform(-0.5, 0.5)) * t)),
    )
    decay = float(rng.uniform(0.0, 30.0))
    return _shaped(kinds[int(rng.integers(len(kinds)))](), t, decay)
