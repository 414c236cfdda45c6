"""Queries of the chunk study: short windows of tracks, as they are and degraded, and what is none.

The protocol of the paper and of the peers' table: 5 s chunks on the grid k x 5 s and the same
shifted by 0.5, 1, 1.5 and 2 s, each alone, without memory of the last.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from downbeat.perception.features import F32
from downbeat.perception.source import Recording
from downbeat.tools.conditions import Degradation
from downbeat.tools.matcher_sounds import synthetic_sounds

CHUNK_S = 5.0
SHIFTS_S = (0.0, 0.5, 1.0, 1.5, 2.0)
MORE_SHIFTS_S = tuple(0.25 * k for k in range(20))
"""Every quarter second of a chunk, where five shifts give too few."""
BEFORE_S, SEGMENT_S = 1.0, 7.5
"""A condition is applied to more than the chunk, so that echoes and codecs have begun."""
PIECE_S = 0.9
"""Of music put together anew."""
SILENT_PEAK = 1e-3


@dataclass(frozen=True, slots=True)
class Query:
    """One window and the truth about it.

    Attributes:
        condition: Name of what was done to it.
        track: What plays.
        start_s: Where in the track the window starts.
        shift_s: Of the grid.
        samples: (n,).
        is_silent: There is nothing to recognise: it must be refused.
    """

    condition: str
    track: str
    start_s: float
    shift_s: float
    samples: F32
    is_silent: bool


def starts(duration_s: float, count: int, shift_s: float, chunk_s: float = CHUNK_S) -> list[float]:
    """Return starts of chunks on the shifted grid, at most `count`, spread over the track."""
    last = int((duration_s - shift_s - chunk_s) // chunk_s)
    grid = [chunk_s * k + shift_s for k in range(last + 1)]
    if len(grid) <= count:
        return grid
    if count == 1:
        return [grid[len(grid) // 2]]
    return [grid[round(k * (len(grid) - 1) / (count - 1))] for k in range(count)]


def clean_queries(recording: Recording, per_shift: int) -> Iterator[Query]:
    """Cut chunks of a track at all shifts."""
    for shift_s in SHIFTS_S:
        for start_s in starts(recording.duration_s, per_shift, shift_s):
            samples = _cut(recording, start_s, CHUNK_S)
            yield Query("clean", recording.name, start_s, shift_s, samples, is_silent(samples))


def degraded_queries(
    recording: Recording, degradation: Degradation, count: int, seed: int
) -> Iterator[Query]:
    """Cut chunks of a track as heard in a condition; the shift changes from chunk to chunk."""
    word = hashlib.sha256(f"{seed}:{degradation.name}:{recording.name}".encode()).digest()
    rng = np.random.default_rng(int.from_bytes(word[:8], "little"))
    rate = recording.sample_rate_hz
    for number, grid_s in enumerate(starts(recording.duration_s, count, 0.0)):
        shift_s = SHIFTS_S[(2 * number + word[8]) % len(SHIFTS_S)]
        if grid_s + shift_s + CHUNK_S > recording.duration_s:
            shift_s = 0.0
        start_s = grid_s + shift_s
        original = _cut(recording, start_s - BEFORE_S, SEGMENT_S)
        heard = degradation.apply(original, rate, rng)
        first = round(BEFORE_S / degradation.time_factor * rate)
        samples = _sized(heard[first:], round(CHUNK_S * rate))
        silent = is_silent(_cut(recording, start_s, CHUNK_S))
        yield Query(degradation.name, recording.name, start_s, shift_s, samples, silent)


def all_queries(
    recording: Recording,
    degradation: Degradation,
    seed: int,
    shifts_s: Sequence[float] = SHIFTS_S,
) -> Iterator[Query]:
    """Cut every chunk of a track at every shift, from the whole track as heard in a condition.

    The condition must not change the time of the music.
    """
    rng = np.random.default_rng([seed, len(recording.samples)])
    rate = recording.sample_rate_hz
    heard = degradation.apply(recording.samples, rate, rng)
    for shift_s in shifts_s:
        for start_s in starts(recording.duration_s, 100_000, shift_s):
            samples = _cut(Recording(recording.name, heard, rate), start_s, CHUNK_S)
            silent = is_silent(_cut(recording, start_s, CHUNK_S))
            yield Query(degradation.name, recording.name, start_s, shift_s, samples, silent)


def foreign_queries(others: Sequence[Recording], per_shift: int) -> Iterator[Query]:
    """Cut chunks of sounds that are no music: recordings, and tones, noise and silence we make."""
    for recording in [*others, *synthetic_sounds(10.0)]:
        length_s = max(recording.duration_s, CHUNK_S)
        for shift_s in SHIFTS_S:
            for start_s in starts(length_s, per_shift, shift_s):
                samples = _cut(recording, start_s, CHUNK_S)
                yield Query("foreign", recording.name, start_s, shift_s, samples, False)


def recombined(recording: Recording, seed: int) -> list[Recording]:
    """Return music that nobody knows, made of a track: its pieces in another order, and backwards.

    Args:
        recording: A track that the catalogue lacks.
        seed: Of the order.
    """
    rng = np.random.default_rng(seed)
    count = round(PIECE_S * recording.sample_rate_hz)
    pieces = [recording.samples[k : k + count] for k in range(0, len(recording.samples), count)]
    shuffled = np.concatenate([pieces[k] for k in rng.permutation(len(pieces))])
    backwards = np.ascontiguousarray(recording.samples[::-1])
    rate = recording.sample_rate_hz
    return [
        Recording(f"{recording.name}, shuffled", shuffled, rate),
        Recording(f"{recording.name}, backwards", backwards, rate),
    ]


def is_silent(samples: F32) -> bool:
    """Say whether a window holds nothing that a microphone would hear."""
    return float(np.abs(samples).max(initial=0.0)) < SILENT_PEAK


def _cut(recording: Recording, start_s: float, length_s: float) -> F32:
    """Return a part of a recording, zeros where it has not begun or is over."""
    rate = recording.sample_rate_hz
    first, count = round(start_s * rate), round(length_s * rate)
    low, high = max(first, 0), min(first + count, len(recording.samples))
    part = np.zeros(count, np.float32)
    if high > low:
        part[low - first : high - first] = recording.samples[low:high]
    return part


def _sized(samples: F32, count: int) -> F32:
    return np.pad(samples, (0, max(0, count - len(samples))))[:count].astype(np.float32)
