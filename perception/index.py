"""The index of reference tracks: features of each, on disk one .npz file."""

from __future__ import annotations

import hashlib
import zipfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from downbeat.perception import features as ft
from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32

FORMAT = "downbeat-alignment-index-1"
PAD_FRAMES = 16
"""Zero frames (of 40 ms) around a track, so that a window may hang over its ends."""
QUANTUM = 127.0 / 3.0
"""int8 scale of features, which lie in -1.5 .. 3."""
COARSE_FRAMES, COARSE_BANDS = 2, 3
"""Averaged for the coarse scan: 160 ms, 1/8 octave."""


def coarse(values: F32) -> F32:
    """Average 2 frames x 3 bands, (n // 2, 49): tolerant of +-4 % tempo and +-2 % pitch."""
    frames = len(values) // COARSE_FRAMES
    bands = ft.NUM_BANDS // COARSE_BANDS
    cut = values[: frames * COARSE_FRAMES, : bands * COARSE_BANDS]
    cells = cut.reshape(frames, COARSE_FRAMES, bands, COARSE_BANDS)
    return cells.mean((1, 3), dtype=np.float32)


@dataclass
class Index:
    """Reference features.

    Attributes:
        names: Track names.
        fine: Per track (n, NUM_BANDS) int8, one frame every 40 ms, padded.
        coarse: Per track (n // 4, 49) float32, one frame every 160 ms.
    """

    names: list[str] = field(default_factory=list)
    fine: list[npt.NDArray[np.int8]] = field(default_factory=list)
    coarse: list[F32] = field(default_factory=list)

    def add(self, name: str, samples: F32, sample_rate_hz: int) -> None:
        """Index one track.

        Raises:
            PerceptionError: The name is taken, or the track is silent or shorter than 2 s.
        """
        if name in self.names:
            raise PerceptionError(f"Track '{name}' is indexed already; names must be unique.")
        sound = ft.to_matcher_rate(samples, sample_rate_hz)
        if len(sound) < 2 * ft.SAMPLE_RATE_HZ or float(np.abs(sound).max()) < 1e-3:
            raise PerceptionError(
                f"Track '{name}' cannot be indexed: it is silent or shorter than 2 s."
            )
        even, odd = ft.features(sound), ft.features(sound[ft.HOP // 2 :])
        frames = len(odd)
        both = np.zeros((2 * frames, ft.NUM_BANDS), np.float32)
        both[::2], both[1::2] = even[:frames], odd
        tail = PAD_FRAMES + (-(2 * frames + 2 * PAD_FRAMES)) % 4
        both = np.pad(both, ((PAD_FRAMES, tail), (0, 0)))
        self.names.append(name)
        self.fine.append(np.round(both * QUANTUM).astype(np.int8))
        self.coarse.append(coarse(both[::2]))

    def digest(self) -> str:
        """Return a hash of the content."""
        state = hashlib.sha256(FORMAT.encode())
        for name, fine in zip(self.names, self.fine):
            state.update(name.encode() + b"\0" + fine.tobytes())
        return state.hexdigest()

    def save(self, path: Path) -> None:
        """Write the index as .npz."""
        arrays = {f"fine_{i}": fine for i, fine in enumerate(self.fine)}
        arrays |= {f"coarse_{i}": values for i, values in enumerate(self.coarse)}
        header = np.array([FORMAT, self.digest(), *self.names])
        with path.open("wb") as file:
            np.savez_compressed(file, header=header, **arrays)

    @classmethod
    def load(cls, path: Path) -> Index:
        """Read an index.

        Raises:
            PerceptionError: The file is missing, foreign or damaged.
        """
        if not path.is_file():
            raise PerceptionError(
                f"Index {path} does not exist; `downbeat catalog build` makes one."
            )
        try:
            with np.load(path, allow_pickle=False) as data:
                head = [str(entry) for entry in data["header"]]
                count = len(head) - 2
                index = cls(
                    head[2:],
                    [data[f"fine_{i}"] for i in range(count)],
                    [data[f"coarse_{i}"] for i in range(count)],
                )
        except (ValueError, KeyError, OSError, EOFError, zipfile.BadZipFile) as error:
            raise PerceptionError(
                f"{path} is not an index of this version; `downbeat catalog build` makes one."
            ) from error
        if head[0] != FORMAT or head[1] != index.digest():
            raise PerceptionError(f"{path} is damaged; `downbeat catalog build` makes it again.")
        return index
