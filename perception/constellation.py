"""The constellation matcher: the paper's, as a second opinion and to compare with.

Landmarks of the query (landmarks.py) are looked up in those of the catalogue; each in common votes
for where the query would start. The tallest column of the histogram of starts is the answer, the
tallest of another track its rival.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from downbeat.perception import features as ft
from downbeat.perception.alignment import FINE_S
from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32
from downbeat.perception.index import PAD_FRAMES, QUANTUM, SILENT_PEAK, Index
from downbeat.perception.landmarks import I64, Postings, query_landmarks
from downbeat.perception.match import MatchResult, check_rate

COLUMN = 3
"""Frames of 40 ms of one column of the histogram; beside each other they are counted together."""
LOOKED_UP = 2_000_000
MIN_VOTES, MIN_CONFIDENCE = 6, 0.35
"""Accepted are at least so many votes with at least this confidence. Of 417 windows of 2, 3 and 5 s
of music that the catalogue lacked (development set), 2 passed: another mix of a track it held."""
CHANCE_VOTES = 4.0
"""Votes that any query gets somewhere, added to those of the rival."""
AGREEMENT_FRAMES = 6
"""Landmarks may lie so far from a known place."""


class ConstellationMatcher:
    """Wang's matcher over an index."""

    def __init__(self, index: Index | None = None) -> None:
        self.index = index or Index()
        self._is_ready = False
        if self.index.names:
            self.finish()

    @property
    def names(self) -> list[str]:
        """Track names."""
        return self.index.names

    def add(self, name: str, samples: F32, sample_rate_hz: int) -> None:
        """Index one track; call `finish` after the last.

        Raises:
            PerceptionError: The name is taken, or the track is silent or too short.
        """
        check_rate(sample_rate_hz)
        self.index.add(name, samples, sample_rate_hz)
        self._is_ready = False

    def finish(self) -> None:
        """Prepare for queries.

        Raises:
            PerceptionError: Nothing was added.
        """
        if not self.index.names:
            raise PerceptionError("The index holds no track; `add` at least one before a query.")
        lengths = [len(power) for power in self.index.power]
        self._begins = np.concatenate([[0], np.cumsum(lengths)])
        self._postings = Postings(self.index.all_landmarks(), lengths)
        self._is_ready = True

    def save(self, path: Path) -> None:
        """Write the index."""
        self.index.save(path)

    @classmethod
    def load(cls, path: Path) -> ConstellationMatcher:
        """Read an index written by `save`; it is the same file as the alignment matcher's.

        Raises:
            PerceptionError: The file is missing, foreign, of another version or damaged.
        """
        return cls(Index.load(path))

    def query(self, samples: F32, sample_rate_hz: int) -> MatchResult:
        """Match a window; silence, and what is not finite, matches nothing.

        Args:
            samples: (n,) mono; 1 to 10 s.
            sample_rate_hz: At least 8 kHz.

        Returns:
            The rate is 1: votes do not tell it. The confidence is 0 to 1: the share that the votes
            for the place have in its votes, its rival's, and what chance gives.

        Raises:
            PerceptionError: The rate is too low, or the index is empty.
        """
        starts, _ = self._votes(samples, sample_rate_hz)
        if not len(starts):
            return MatchResult()
        columns, votes = _histogram(starts)
        frame = columns * COLUMN + COLUMN
        track = np.clip(np.searchsorted(self._begins, frame, side="right") - 1, 0, None)
        track = np.minimum(track, len(self.names) - 1)
        best = int(votes.argmax())
        others = np.flatnonzero(track != track[best])
        other = int(others[votes[others].argmax()]) if len(others) else None
        rival = 0.0 if other is None else float(votes[other])
        found = float(votes[best])
        confidence = (found - rival) / (found + CHANCE_VOTES) if found > rival else 0.0
        number = int(track[best])
        near = np.abs(starts - frame[best]) <= COLUMN
        place = float(np.median(starts[near])) - self._begins[number] - PAD_FRAMES
        return MatchResult(
            track=self.names[number],
            tau_s=float(place) * FINE_S,
            confidence=confidence,
            accepted=found >= MIN_VOTES and confidence >= MIN_CONFIDENCE,
            similarity=confidence,
            runner_up="" if other is None else self.names[int(track[other])],
            runner_up_confidence=rival / (found + CHANCE_VOTES),
            votes=int(found),
        )

    def agreement(
        self, samples: F32, sample_rate_hz: int, track: str, tau_s: float
    ) -> tuple[float, float]:
        """Compare a window with a known place.

        Returns:
            Share of the landmarks found there, and how far they lie after `tau_s` [s].
        """
        if track not in self.names:
            return 0.0, 0.0
        starts, asked = self._votes(samples, sample_rate_hz)
        begin = self._begins[self.names.index(track)]
        away = starts - (begin + PAD_FRAMES + tau_s / FINE_S)
        near = away[np.abs(away) <= AGREEMENT_FRAMES]
        if not len(near):
            return 0.0, 0.0
        return min(1.0, len(near) / asked), float(np.median(near)) * FINE_S

    def _votes(self, samples: F32, sample_rate_hz: int) -> tuple[I64, int]:
        """Return a start for each landmark in common, and the number of landmarks.

        Starts are frames counted through all tracks.
        """
        check_rate(sample_rate_hz)
        if not self._is_ready:
            self.finish()
        peak = float(np.abs(samples).max()) if len(samples) else 0.0
        if not SILENT_PEAK <= peak < np.inf:  # NaN fails too
            return np.zeros(0, np.int64), 1
        landmarks = query_landmarks(ft.to_matcher_rate(samples, sample_rate_hz), QUANTUM)
        # Each landmark is looked up at three pitches.
        return self._postings.look_up(landmarks, LOOKED_UP), max(1, len(landmarks) // 3)


def _histogram(starts: I64) -> tuple[I64, I64]:
    """Return columns that have votes, and the votes of each and its right neighbour."""
    columns = np.sort(starts // COLUMN)
    edges = np.flatnonzero(np.diff(columns, prepend=columns[0] - 1))
    places, votes = columns[edges], np.diff(edges, append=len(columns))
    both = votes.copy()
    beside = np.flatnonzero(np.diff(places) == 1)
    both[beside] += votes[beside + 1]
    return places, both
