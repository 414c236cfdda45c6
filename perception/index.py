"""The index of reference tracks: features of each, on disk one .npz file."""

from __future__ import annotations

import hashlib
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from downbeat.perception import features as ft
from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32

FORMAT = "downbeat-alignment-index-2"
PAD_FRAMES = 16
"""Zero frames (of 40 ms) around a track, so that a window may hang over its ends."""
QUANTUM = 127.0 / 3.0
"""int8 scale of features, which lie in -1.5 .. 3."""
COARSE_FRAMES, COARSE_BANDS = 2, 3
"""Averaged for the coarse scan: 160 ms, 1/8 octave."""
MIN_TRACK_S = 2.0
SILENT_PEAK = 1e-3
DECOY_PLACES = 3_000
"""Eight minutes of what is not in the catalogue, so that a small one knows chance from likeness."""
DECOY_SHIFT, DECOY_STEP = 10, 7
"""Bands by which decoys are transposed; 24 are an octave, which would be too like the original."""

Fine = npt.NDArray[np.int8]


def coarse(values: F32) -> F32:
    """Average 2 frames x 3 bands, (n // 2, 49): tolerant of +-4 % tempo and +-2 % pitch."""
    frames = len(values) // COARSE_FRAMES
    bands = ft.NUM_BANDS // COARSE_BANDS
    cut = values[: frames * COARSE_FRAMES, : bands * COARSE_BANDS]
    cells = cut.reshape(frames, COARSE_FRAMES, bands, COARSE_BANDS)
    return cells.mean((1, 3), dtype=np.float32)


def coarse_of_fine(fine: Fine) -> F32:
    """Return the coarse features of a track, (n // 4, 49)."""
    return coarse(fine[::2].astype(np.float32) / np.float32(QUANTUM))


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
        places += len(source) // (2 * COARSE_FRAMES)
    return decoys


@dataclass
class Index:
    """Reference features.

    Attributes:
        names: Track names.
        fine: Per track (n, NUM_BANDS) int8, one frame every 40 ms, padded.
    """

    names: list[str] = field(default_factory=list)
    fine: list[Fine] = field(default_factory=list)

    def add(self, name: str, samples: F32, sample_rate_hz: int) -> None:
        """Index one track.

        Raises:
            PerceptionError: The name is taken, or the track is silent or shorter than 2 s.
        """
        if name in self.names:
            raise PerceptionError(f"Track '{name}' is indexed already; names must be unique.")
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
        tail = PAD_FRAMES + (-(2 * frames + 2 * PAD_FRAMES)) % 4
        both = np.pad(both, ((PAD_FRAMES, tail), (0, 0)))
        self.names.append(name)
        self.fine.append(np.round(both * QUANTUM).astype(np.int8))

    def subset(self, numbers: Sequence[int]) -> Index:
        """Return an index of some of the tracks, sharing their arrays."""
        return Index([self.names[i] for i in numbers], [self.fine[i] for i in numbers])

    def digest(self) -> str:
        """Return a hash of the content."""
        state = hashlib.sha256(FORMAT.encode())
        for name, fine in zip(self.names, self.fine):
            state.update(f"{name}\0{fine.shape}".encode() + fine.tobytes())
        return state.hexdigest()

    def save(self, path: Path) -> None:
        """Write the index as .npz."""
        arrays = {f"fine_{i}": fine for i, fine in enumerate(self.fine)}
        header = np.array([FORMAT, self.digest(), *self.names])
        with path.open("wb") as file:
            np.savez_compressed(file, header=header, **arrays)

    @classmethod
    def load(cls, path: Path) -> Index:
        """Read an index.

        Raises:
            PerceptionError: The file is missing, foreign, of another version or damaged.
        """
        remedy = "`downbeat catalog build` makes one"
        if not path.is_file():
            raise PerceptionError(f"Index {path} does not exist; {remedy}.")
        try:
            with np.load(path, allow_pickle=False) as data:
                head = [str(entry) for entry in data["header"]]
                if head[0] != FORMAT:
                    raise PerceptionError(f"{path} is not a {FORMAT}; {remedy}.")
                index = cls(head[2:], [data[f"fine_{i}"] for i in range(len(head) - 2)])
        except (
            ValueError, KeyError, IndexError, TypeError, OSError, EOFError,
            zipfile.BadZipFile, zlib.error, NotImplementedError,
        ) as error:  # fmt: skip
            raise PerceptionError(f"{path} is not a {FORMAT}, or is damaged; {remedy}.") from error
        if head[1] != index.digest():
            raise PerceptionError(f"{path} is damaged; {remedy}.")
        return index
