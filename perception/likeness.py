"""Which catalogue track does unknown music resemble most? Cosine search, whatever embeds the sound.

An embedder makes a unit vector of a few seconds of sound: `likeness_embedded.py` without any
download, `clap_model.py` with an exported CLAP, which understands words, too. The vectors of a
catalogue stand in one file beside its index; they belong to one embedder, another refuses them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32
from downbeat.perception.likeness_store import LikenessTable

SILENT_RMS = 1e-3
"""-60 dB of full scale: nothing is playing."""
MAX_WINDOWS = 4
"""The newest windows of a query are averaged; more would be of another piece."""


@dataclass(frozen=True, slots=True)
class Similar:
    """The catalogue track that sounds most like what is heard.

    Attributes:
        track: Its name.
        similarity: Cosine, -1..1; 1: the same sound.
        margin: By how much it is ahead of the best other track; 2 at most.
        runner_up: That other track; "": the catalogue has only one.
    """

    track: str
    similarity: float
    margin: float
    runner_up: str


class Embedder(Protocol):
    """Sound -> unit vector; perhaps words -> unit vector of the same space.

    Attributes:
        name: As in configuration files.
        digest: Of weights and method: vectors of another digest cannot be compared.
        window_s: Length of sound that it hears at once [s].
    """

    name: str
    digest: str
    window_s: float

    def embed(self, samples: F32, sample_rate_hz: int) -> F32:
        """Return the unit vector of one window of sound, (dim,)."""
        ...

    def embed_texts(self, texts: Sequence[str]) -> F32:
        """Return unit vectors, (n, dim).

        Raises:
            PerceptionError: It has no words.
        """
        ...


class Likeness(Protocol):
    """What the listener asks while nothing is locked."""

    name: str

    def nearest(self, samples: F32, sample_rate_hz: int) -> Similar | None:
        """Return the most similar track of the newest sound, or None if it is short or silent."""
        ...


class CatalogLikeness:
    """Cosine search over the vectors of a catalogue."""

    def __init__(
        self,
        table: LikenessTable,
        embedder: Embedder,
        skills: Mapping[str, Sequence[str]] | None = None,
    ) -> None:
        """Bind a catalogue's vectors to what made them.

        Args:
            table: Vectors of the catalogue.
            embedder: Of the same digest.
            skills: Sentences that describe each skill, for `skills_by_text`.

        Raises:
            PerceptionError: The vectors come from another embedder, or the embedder has no words.
        """
        if table.embedder != embedder.digest:
            raise PerceptionError(
                f"The likeness table was made by embedder {table.embedder}, not by "
                f"{embedder.digest} ('{embedder.name}'); `downbeat catalog build` makes it anew."
            )
        self.name = embedder.name
        self._table = table
        self._embedder = embedder
        self._skills = list(skills or ())
        self._words = _skill_vectors(embedder, skills or {})

    def nearest(self, samples: F32, sample_rate_hz: int) -> Similar | None:
        """Return the most similar track of the newest sound.

        Args:
            samples: (n,) mono; the newest windows of it are heard.
            sample_rate_hz: [Hz].

        Returns:
            None if there is no whole window, if it is silent, or if the catalogue is empty.
        """
        heard = self._heard(samples, sample_rate_hz)
        if heard is None or not self._table.names:
            return None
        scores = self._table.scores(heard)  # (tracks,)
        order = np.argsort(-scores, kind="stable")
        best, other = int(order[0]), int(order[1]) if len(order) > 1 else None
        rest = float(scores[other]) if other is not None else -1.0
        runner_up = self._table.names[other] if other is not None else ""
        found = float(scores[best])
        return Similar(self._table.names[best], found, found - rest, runner_up)

    def skills_by_text(self, samples: F32, sample_rate_hz: int) -> list[tuple[str, float]]:
        """Return skills with the cosine of their descriptions to the newest sound, best first.

        Raises:
            PerceptionError: The embedder has no words.
        """
        if not self._skills:
            self._embedder.embed_texts(["music"])  # says so if it has no words
            raise PerceptionError("No skill was described in words; give `skills` at loading.")
        heard = self._heard(samples, sample_rate_hz)
        if heard is None:
            return []
        cosines = self._words @ heard
        order = np.argsort(-cosines, kind="stable")
        return [(self._skills[i], float(cosines[i])) for i in order]

    def _heard(self, samples: F32, sample_rate_hz: int) -> F32 | None:
        """Return the unit vector of the newest sound, or None if there is none."""
        vectors = embed_newest(self._embedder, samples, sample_rate_hz)
        return None if vectors is None else unit(vectors.mean(axis=0))


def embed_newest(embedder: Embedder, samples: F32, sample_rate_hz: int) -> F32 | None:
    """Return the vectors of the newest windows that are not silent, (1..4, dim), or None."""
    window = round(embedder.window_s * sample_rate_hz)
    count = min(MAX_WINDOWS, len(samples) // window)
    vectors = []
    for number in range(count):
        end = len(samples) - number * window
        piece = np.asarray(samples[end - window : end], np.float32)
        if is_sounding(piece):
            vectors.append(embedder.embed(piece, sample_rate_hz))
    return np.array(vectors, np.float32) if vectors else None


def is_sounding(samples: F32) -> bool:
    """Whether there is sound at all, and every sample is a number."""
    if len(samples) == 0 or not np.isfinite(samples).all():
        return False
    return float(np.std(samples)) >= SILENT_RMS


def unit(vectors: F32) -> F32:
    """Return vectors of length 1 along the last axis, same shape."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(length, 1e-9), np.float32)


def _skill_vectors(embedder: Embedder, skills: Mapping[str, Sequence[str]]) -> F32:
    """Return one vector per skill, the mean of its sentences, (skills, dim)."""
    if not skills:
        return np.zeros((0, 0), np.float32)
    for name, sentences in skills.items():
        if not sentences:
            raise PerceptionError(f"Skill '{name}' has no sentence that describes it.")
    rows = [embedder.embed_texts(list(sentences)).mean(axis=0) for sentences in skills.values()]
    return unit(np.array(rows, np.float32))
