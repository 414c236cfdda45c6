"""Catalogues of any size for the scale bench: a few real tracks among thousands that are made.

Made tracks are made of features, not of sound: pieces of 4 to 16 s of the real ones, at another
pitch (4 to 9 bands off: no pitch that a query is tried at), at 0.8 to 1.25 of their tempo, half of
them backwards, put together anew. They have the statistics of music and are none of the real ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, overload

import numpy as np

from downbeat.perception import features as ft
from downbeat.perception.index import (
    FINE_PER_COARSE,
    Fine,
    Index,
    Landmarks,
    coarse_of_fine,
    power_of_fine,
)

PIECE_FRAMES = (100, 400)
SHIFTS = (-9, -7, -5, -4, 4, 5, 7, 9)
TEMPI = (0.8, 0.87, 1.15, 1.25)


class MadeTracks(Sequence[Fine]):
    """Real tracks, then made ones, each made when it is asked for, always the same."""

    def __init__(self, real: Sequence[Fine], count: int, frames: int) -> None:
        """Take the real ones, how many there are in all, and the length of those made [40 ms]."""
        self._real, self._count = real, max(count, len(real))
        self._frames = frames // FINE_PER_COARSE * FINE_PER_COARSE

    def __len__(self) -> int:
        """Return the number of tracks."""
        return self._count

    @overload
    def __getitem__(self, number: int) -> Fine: ...

    @overload
    def __getitem__(self, number: slice) -> list[Fine]: ...

    def __getitem__(self, number: int | slice) -> Fine | list[Fine]:
        """Return the features of a track, (n, NUM_BANDS)."""
        if isinstance(number, slice):
            return [self[i] for i in range(*number.indices(self._count))]
        if number >= self._count:
            raise IndexError(number)
        return self._real[number] if number < len(self._real) else self._make(number)

    def _make(self, number: int) -> Fine:
        rng = np.random.default_rng([3, number])
        shift, tempo = int(rng.choice(SHIFTS)), float(rng.choice(TEMPI))
        out = np.zeros((self._frames, ft.NUM_BANDS), np.int8)
        done = 0
        while done < self._frames:
            source = self._real[int(rng.integers(len(self._real)))]
            length = min(int(rng.integers(*PIECE_FRAMES)), len(source))
            first = int(rng.integers(len(source) - length + 1))
            rows = first + (np.arange(int(length / tempo)) * tempo).astype(np.int64)
            piece = source[rows[: self._frames - done]]
            if rng.random() < 0.5:
                piece = piece[::-1]
            out[done : done + len(piece)] = np.roll(piece, shift + int(rng.integers(-1, 2)), axis=1)
            done += len(piece)
        return out


def make_index(real: Index, count: int, seconds: float, with_landmarks: bool) -> Index:
    """Return an index of `count` tracks, those of `real` first.

    Args:
        real: Real tracks.
        count: Tracks in all.
        seconds: Length of the tracks that are made.
        with_landmarks: Also for the constellation matcher; else made tracks have none.
    """
    fine = MadeTracks(real.fine, count, round(seconds / ft.HOP_S * 2.0))
    coarse: list[Any] = list(real.coarse)
    power: list[Any] = list(real.power)
    for number in range(len(real.names), len(fine)):
        track = fine[number]
        coarse.append(coarse_of_fine(track))
        power.append(power_of_fine(track))
    names = [*real.names, *(f"made {i}" for i in range(len(real.names), len(fine)))]
    none: list[Landmarks] = [np.zeros((0, 2), np.uint32)] * (len(fine) - len(real.names))
    landmarks = [] if with_landmarks else [*real.all_landmarks(), *none]
    return Index(names, fine, coarse, power, [""] * len(names), landmarks)
