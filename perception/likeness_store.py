"""The likeness table: unit vectors of a catalogue's tracks, on disk one .npz file."""

from __future__ import annotations

import hashlib
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32

FORMAT = "downbeat-likeness-1"
BEST_WINDOWS = 4
"""A track is as similar as the mean of its windows that fit best: a piece has several sections."""


@dataclass
class LikenessTable:
    """Vectors of a catalogue.

    Attributes:
        embedder: Digest of what made them.
        names: Track names.
        sounds: Per track a digest of its samples, so that only changed ones are made anew.
        vectors: Per track (windows, dim) unit vectors.
    """

    embedder: str
    names: list[str] = field(default_factory=list)
    sounds: list[str] = field(default_factory=list)
    vectors: list[F32] = field(default_factory=list)

    def scores(self, query: F32) -> npt.NDArray[np.float64]:
        """Return the similarity of every track to a unit vector (dim,), (tracks,)."""
        return np.array([_best(vectors @ query) for vectors in self.vectors], np.float64)

    def subset(self, numbers: Sequence[int]) -> LikenessTable:
        """Return the table of some of the tracks, sharing their arrays."""
        return LikenessTable(
            self.embedder,
            [self.names[i] for i in numbers],
            [self.sounds[i] for i in numbers],
            [self.vectors[i] for i in numbers],
        )

    def digest(self) -> str:
        """Return a hash of the content."""
        state = hashlib.sha256(f"{FORMAT}\0{self.embedder}".encode())
        for name, sound, vectors in zip(self.names, self.sounds, self.vectors, strict=True):
            state.update(f"{name}\0{sound}\0{vectors.shape}".encode() + vectors.tobytes())
        return state.hexdigest()

    def save(self, path: Path) -> None:
        """Write the table; a reader sees the old file or the new one."""
        arrays = {f"vectors_{i}": vectors for i, vectors in enumerate(self.vectors)}
        header = np.array([FORMAT, self.digest(), self.embedder])
        names, sounds = np.array(self.names, np.str_), np.array(self.sounds, np.str_)
        temporary = path.with_name(f".{path.name}.part")
        with temporary.open("wb") as file:
            np.savez(file, header=header, names=names, sounds=sounds, **arrays)
        temporary.replace(path)

    @classmethod
    def load(cls, path: Path) -> LikenessTable:
        """Read a table.

        Raises:
            PerceptionError: The file is missing, foreign, of another version or damaged.
        """
        remedy = "`downbeat catalog build` makes one"
        if not path.is_file():
            raise PerceptionError(f"Likeness table {path} does not exist; {remedy}.")
        try:
            with np.load(path, allow_pickle=False) as data:
                kind, digest, embedder = (str(entry) for entry in data["header"])
                if kind != FORMAT:
                    raise PerceptionError(f"{path} is a {kind}, not a {FORMAT}; {remedy}.")
                names, sounds = [str(n) for n in data["names"]], [str(s) for s in data["sounds"]]
                table = cls(
                    embedder, names, sounds, [data[f"vectors_{i}"] for i in range(len(names))]
                )
            whole = digest == table.digest()
        except (
            ValueError, KeyError, IndexError, TypeError, OSError, EOFError,
            zipfile.BadZipFile, zlib.error, NotImplementedError,
        ) as error:  # fmt: skip
            raise PerceptionError(f"{path} is not a {FORMAT}, or is damaged; {remedy}.") from error
        if not whole:
            raise PerceptionError(f"{path} is damaged; {remedy}.")
        return table


def _best(cosines: F32) -> float:
    count = min(BEST_WINDOWS, len(cosines))
    return float(np.partition(cosines, len(cosines) - count)[-count:].mean())
