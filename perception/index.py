"""The index of reference tracks: what a query is compared with. On disk: index_file.py."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
import numpy.typing as npt

from downbeat.perception import features as ft
from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32
from downbeat.perception.passages import Passage, shared_among

if TYPE_CHECKING:
    from downbeat.perception.codes import CodeTable

PAD_FRAMES = 16
"""Zero frames (of 40 ms) around a track, so that a window may hang over its ends."""
QUANTUM = 127.0 / 3.0
"""int8 scale of features, which lie in -1.5 .. 3."""
COARSE_FRAMES, COARSE_BANDS = 2, 3
"""Averaged for the coarse scan: 160 ms, 1/8 octave."""
FINE_PER_COARSE = 2 * COARSE_FRAMES
MIN_TRACK_S = 2.0
SILENT_PEAK = 1e-3
DECOY_PLACES = 3_000
"""Eight minutes of what is not in the catalogue, so that a small one knows chance from likeness."""
DECOY_SHIFT, DECOY_STEP = 10, 7
"""Bands by which decoys are transposed; 24 are an octave, which would be too like the original."""

Fine = npt.NDArray[np.int8]
Coarse = npt.NDArray[np.int8]
Power = npt.NDArray[np.int32]
Landmarks = npt.NDArray[np.uint32]
Array = npt.NDArray[Any]


class Parts(Sequence[Array]):
    """Tracks that lie one after the other in one array."""

    def __init__(self, whole: Array, lengths: Sequence[int]) -> None:
        """Take the array and the number of rows of each track."""
        self.whole = whole
        self._bounds = [0, *np.cumsum(np.asarray(lengths, np.int64)).tolist()]

    def __len__(self) -> int:
        """Return the number of tracks."""
        return len(self._bounds) - 1

    @overload
    def __getitem__(self, number: int) -> Array: ...

    @overload
    def __getitem__(self, number: slice) -> list[Array]: ...

    def __getitem__(self, number: int | slice) -> Array | list[Array]:
        """Return the rows of a track."""
        if isinstance(number, slice):
            return [self[i] for i in range(*number.indices(len(self)))]
        if not -len(self) <= number < len(self):
            raise IndexError(number)
        number %= len(self)
        return self.whole[self._bounds[number] : self._bounds[number + 1]]


def joined(tracks: Sequence[Array]) -> Array:
    """Return the rows of all tracks as one array, without copying where they lie in one."""
    return tracks.whole if isinstance(tracks, Parts) else np.concatenate(tracks)


def coarse(values: F32) -> F32:
    """Average 2 frames x 3 bands, (n // 2, cells): tolerant of +-4 % tempo and +-2 % pitch."""
    frames = len(values) // COARSE_FRAMES
    bands = ft.NUM_BANDS // COARSE_BANDS
    cut = values[: frames * COARSE_FRAMES, : bands * COARSE_BANDS]
    cells = cut.reshape(frames, COARSE_FRAMES, bands, COARSE_BANDS)
    return cells.mean((1, 3), dtype=np.float32)


def coarse_of_fine(fine: Fine) -> Coarse:
    """Return the coarse features of a track, (n // 4, cells), on the same int8 scale."""
    frames = len(fine) // FINE_PER_COARSE
    bands = ft.NUM_BANDS // COARSE_BANDS
    cut = fine[: frames * FINE_PER_COARSE, : bands * COARSE_BANDS]
    total = np.add(cut[::4], cut[2::4], dtype=np.int16)  # (n // 4, 147): the frames on the grid
    cells = total[:, ::3] + total[:, 1::3] + total[:, 2::3]
    return np.rint(cells / np.float32(COARSE_FRAMES * COARSE_BANDS)).astype(np.int8)


def power_of_fine(fine: Fine) -> Power:
    """Return the sum of squares of every frame, (n,)."""
    values = fine.astype(np.float32)  # exact: 200 squares of 127 stay below 2 ** 24
    return np.einsum("ij,ij->i", values, values).astype(np.int32)


def make_decoys(tracks: Sequence[Fine]) -> list[Fine]:
    """Return the tracks backwards and transposed, again and again, until there are enough places.

    They sound like the catalogue and are not in it: what a query reaches there is chance.
    """
    decoys: list[Fine] = []
    places = 0
    while places < DECOY_PLACES:
        number = len(decoys)
        turn = number // len(tracks)
        shift = (DECOY_SHIFT + DECOY_STEP * turn) % ft.NUM_BANDS
        source = tracks[number % len(tracks)]
        decoys.append(np.ascontiguousarray(np.roll(source[::-1], shift, axis=1)))
        places += len(source) // FINE_PER_COARSE
    return decoys


@dataclass
class Index:
    """Reference features; arrays of a loaded index lie in its file.

    Attributes:
        names: Track names.
        fine: Per track (n, NUM_BANDS) int8, one frame every 40 ms, padded.
        coarse: Per track (n // 4, cells) int8, one every 160 ms.
        power: Per track (n,) int32, sum of squares of the frames of `fine`.
        sources: Per track the digest of the file that it was made of; empty: not of a file.
        landmarks: Per track (m, 2) uint32 (landmarks.py); of the last tracks perhaps not made yet.
        codes: Inverted index of all tracks, for large catalogues; None: not made yet.
        shared: Passages that two tracks share; None: nobody looked.
    """

    names: list[str] = field(default_factory=list)
    fine: Sequence[Fine] = field(default_factory=list)
    coarse: Sequence[Coarse] = field(default_factory=list)
    power: Sequence[Power] = field(default_factory=list)
    sources: list[str] = field(default_factory=list)
    landmarks: Sequence[Landmarks] = field(default_factory=list)
    codes: CodeTable | None = None
    shared: tuple[Passage, ...] | None = None

    def add(self, name: str, samples: F32, sample_rate_hz: int, source: str = "") -> None:
        """Index one track.

        Raises:
            PerceptionError: The name is taken, or the track is silent or shorter than 2 s.
        """
        if name in self.names:
            raise PerceptionError(f"Track '{name}' is indexed already; names must be unique.")
        fine = track_features(name, samples, sample_rate_hz)
        self.names.append(name)
        self.fine = [*self.fine, fine]
        self.coarse = [*self.coarse, coarse_of_fine(fine)]
        self.power = [*self.power, power_of_fine(fine)]
        self.sources.append(source)
        self.codes = None

    def subset(self, numbers: Sequence[int]) -> Index:
        """Return an index of some of the tracks, sharing their arrays."""
        return Index(
            [self.names[i] for i in numbers],
            [self.fine[i] for i in numbers],
            [self.coarse[i] for i in numbers],
            [self.power[i] for i in numbers],
            [self.sources[i] for i in numbers],
            [self.landmarks[i] for i in numbers] if len(self.landmarks) == len(self.names) else [],
            shared=self._shared_among([self.names[i] for i in numbers]),
        )

    def _shared_among(self, names: Sequence[str]) -> tuple[Passage, ...] | None:
        return None if self.shared is None else shared_among(self.shared, names)

    def all_landmarks(self) -> Sequence[Landmarks]:
        """Return the landmarks of all tracks; those that are missing are made."""
        from downbeat.perception.landmarks import landmarks_of

        if missing := range(len(self.landmarks), len(self.names)):
            self.landmarks = [*self.landmarks, *(landmarks_of(self.fine[i]) for i in missing)]
        return self.landmarks

    def save(self, path: Path) -> None:
        """Write the index; a reader sees the old file or the new one, never a part."""
        from downbeat.perception.index_file import write_index

        write_index(self, path)

    @classmethod
    def load(cls, path: Path) -> Index:
        """Map an index into memory.

        Raises:
            PerceptionError: The file is missing, foreign, of another version or damaged.
        """
        from downbeat.perception.index_file import read_index

        return read_index(path)


def track_features(name: str, samples: F32, sample_rate_hz: int) -> Fine:
    """Return the fine features of a track, padded, (n, NUM_BANDS); n is a multiple of 4.

    Raises:
        PerceptionError: It is silent or shorter than 2 s.
    """
    sound = ft.to_matcher_rate(samples, sample_rate_hz)
    peak = float(np.abs(sound).max()) if len(sound) else 0.0
    if len(sound) < MIN_TRACK_S * ft.SAMPLE_RATE_HZ or not peak >= SILENT_PEAK:
        raise PerceptionError(
            f"Track '{name}' cannot be indexed: it is silent or shorter than {MIN_TRACK_S:g} s."
        )
    even, odd = ft.features(sound), ft.features(sound[ft.HOP // 2 :])
    frames = len(odd)
    both = np.zeros((2 * frames, ft.NUM_BANDS), np.float32)
    both[::2], both[1::2] = even[:frames], odd
    tail = PAD_FRAMES + (-(2 * frames + 2 * PAD_FRAMES)) % FINE_PER_COARSE
    both = np.pad(both, ((PAD_FRAMES, tail), (0, 0)))
    return np.round(both * QUANTUM).astype(np.int8)
