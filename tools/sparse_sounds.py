"""Pieces of single sounds and pauses, as we make them: what can be mistaken for anything.

Few real pieces are like that, and those few are where a listener hears voices and clicks as music:
a click and a pause fit any other click and pause.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from downbeat.perception.features import F32
from downbeat.perception.source import Recording

NAME = "sparse"
"""Begins the names of pieces."""
PIECE_S = 40.0
SOUNDS = (1, 6)
"""So many different sounds make a piece, fewest and most."""
PAUSES_S = (0.25, 3.0)
FLOOR_DB = (-110.0, -45.0)
"""Between the sounds is noise of this level, or nothing."""
LEVEL = 0.3

Rng = np.random.Generator


def sparse_pieces(count: int, seed: int, sample_rate_hz: int) -> list[Recording]:
    """Return pieces of a few sounds each, in time or at random, over noise or over nothing.

    Args:
        count: Of pieces.
        seed: Of all of them.
        sample_rate_hz: Of the recordings.
    """
    return [
        Recording(
            f"{NAME} {seed} {number}",
            _piece(np.random.default_rng([seed, number]), sample_rate_hz),
            sample_rate_hz,
        )
        for number in range(count)
    ]


def _piece(rng: Rng, rate: int) -> F32:
    count = round(PIECE_S * rate)
    piece = np.zeros(count)
    if rng.random() < 0.7:
        level = LEVEL * 10.0 ** (rng.uniform(*FLOOR_DB) / 20.0)
        piece += level * rng.standard_normal(count)
    sounds = [_sound(rng, rate) for _ in range(int(rng.integers(SOUNDS[0], SOUNDS[1] + 1)))]
    beat_s = float(rng.uniform(*PAUSES_S))
    is_in_time, is_ever_new = rng.random() < 0.5, rng.random() < 0.3
    now_s = float(rng.uniform(0.0, 1.0))
    while now_s < PIECE_S:
        sound = _sound(rng, rate) if is_ever_new else sounds[int(rng.integers(len(sounds)))]
        part = piece[round(now_s * rate) :][: len(sound)]
        part += float(rng.uniform(0.3, 1.0)) * sound[: len(part)]
        now_s += beat_s if is_in_time else float(rng.uniform(PAUSES_S[0], 2.0 * beat_s))
    return (LEVEL * piece / np.abs(piece).max()).astype(np.float32)


def _sound(rng: Rng, rate: int) -> F32:
    """Return one sound: a tone, a pluck, a click, a knock, a hiss or a glide."""
    t = np.arange(round(rng.uniform(0.05, 0.8) * rate)) / rate
    hertz = float(np.exp(rng.uniform(np.log(100.0), np.log(3_000.0))))
    tone = 2.0 * np.pi * hertz * t
    kinds: tuple[Callable[[], F32], ...] = (
        lambda: np.sin(tone),
        lambda: sum(np.sin(n * tone) / n for n in range(1, 8)),
        lambda: rng.standard_normal(len(t)) * np.exp(-t * 300.0),
        lambda: np.sin(tone) * np.exp(-t * 60.0) + 0.3 * rng.standard_normal(len(t)),
        lambda: np.diff(rng.standard_normal(len(t) + 1)),
        lambda: np.sin(tone * (1.0 + float(rng.uniform(-0.5, 0.5)) * t)),
    )
    fade = np.minimum(1.0, np.minimum(t, t[::-1]) / 0.003)
    decay = np.exp(-t * float(rng.uniform(0.0, 30.0)))
    sound = kinds[int(rng.integers(len(kinds)))]() * fade * decay
    return np.asarray(sound / (np.abs(sound).max() + 1e-9), np.float32)
