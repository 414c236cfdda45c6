"""Where a query may lie: every place is compared, or an inverted index proposes some."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from downbeat.perception.alignment import QUIET_SHARE, CoarseScan, FineAligner
from downbeat.perception.best_places import best_places
from downbeat.perception.codes import CodeTable, make_code_table, query_codes
from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32, NUM_BANDS
from downbeat.perception.index import (
    QUANTUM,
    Coarse,
    Fine,
    Index,
    Power,
    coarse,
    coarse_of_fine,
    joined,
    make_decoys,
    power_of_fine,
)

I64 = npt.NDArray[np.int64]
I32 = npt.NDArray[np.int32]

MAX_SCANNED_TRACKS = 1_000
"""Every place of a larger catalogue is no longer compared with a query: 16 ms at this size."""
LOOKED_UP = 400_000
"""Places looked at per query, those of rare and likely codes first: bounds the time it takes."""
VOTED = 1_000
"""Places compared after the vote, each with its neighbours."""
SAMPLED, SAMPLED_ROWS = 1_500, 64
"""Places drawn once for the spread of chance, and their length: 10 s."""


class Scan(Protocol):
    """The first stage of the search."""

    starts: I64
    """First place of each track."""

    @property
    def track_of(self) -> I64 | I32:
        """Track of each place."""

    def search(self, values: F32, count: int) -> tuple[I64, float]:
        """Return at most `count` places like a query, best first, and the spread of chance."""


class ProposedScan:
    """Compares a query only with the places that its codes propose."""

    def __init__(self, tracks: Sequence[Coarse], table: CodeTable) -> None:
        """Take the coarse features of each track, (n_i, CELLS), and where their codes are."""
        lengths = np.array([len(values) for values in tracks])
        self._coarse = joined(tracks)  # (n, CELLS)
        self._table = table
        self.starts: I64 = np.concatenate([[0], np.cumsum(lengths)[:-1]])
        self.track_of: I32 = np.repeat(np.arange(len(lengths), dtype=np.int32), lengths)
        self._ends: I64 = self.starts + lengths
        rng = np.random.default_rng(0)
        places = rng.integers(0, max(len(self._coarse) - SAMPLED_ROWS, 1), SAMPLED)
        places.sort()
        self._room = self._ends[self.track_of[places]] - places  # rows left in the track
        rows = np.minimum(places[:, None] + np.arange(SAMPLED_ROWS), len(self._coarse) - 1)
        self._sample = self._coarse[rows].astype(np.float32) / np.float32(QUANTUM)

    def search(self, values: F32, count: int) -> tuple[I64, float]:
        """Find the places most like a query.

        Args:
            values: (w, NUM_BANDS) features of the query.
            count: Places wanted.

        Returns:
            At least one and at most `count` places, best first; the chance spread of the scores.
        """
        query = coarse(values)[:SAMPLED_ROWS]
        sample = self._sample[self._room >= len(query), : len(query)]
        scores, energy = correlate(sample, query)
        floor = QUIET_SHARE * float(np.median(energy)) + 1e-9 if len(energy) else 1e-9
        scores = normalise(scores, energy, query, floor)
        chance = float(scores.std()) if len(scores) else 1.0
        places = self.propose(values)
        places = places[places + len(query) <= self._ends[self.track_of[places]]]
        if not len(places):  # an answer is expected; this one will not be accepted
            return np.zeros(1, np.int64), chance
        rows = self._coarse[places[:, None] + np.arange(len(query))]  # (k, w, CELLS)
        scores, energy = correlate(rows.astype(np.float32) / np.float32(QUANTUM), query)
        scores = normalise(scores, energy, query, floor)
        return places[best_places(scores, count)], chance

    def propose(self, values: F32) -> I64:
        """Return places that share codes with a query, in order of place.

        Args:
            values: (w, NUM_BANDS) features of the query.
        """
        keys, rows, costs = query_codes(values)
        first = self._table.starts[keys].astype(np.int64)
        counts = self._table.starts[keys + 1] - first
        some = np.flatnonzero(counts)
        order = some[np.argsort(costs[some] + np.log(counts[some]), kind="stable")]
        order = order[: np.searchsorted(np.cumsum(counts[order]), LOOKED_UP, side="right")]
        counts = counts[order]
        shift = first[order] - (np.cumsum(counts) - counts)
        found = self._table.places[np.repeat(shift, counts) + np.arange(counts.sum())]
        starts = found.astype(np.int32) - np.repeat(rows[order].astype(np.int32), counts)
        return most_voted(starts[starts >= 0], VOTED, len(self._coarse))


def most_voted(starts: I32, count: int, total: int) -> I64:
    """Return the `count` places with most votes, each with its neighbours, in order of place.

    Args:
        starts: (m,) places voted for.
        count: Places wanted.
        total: Number of places.
    """
    if not len(starts):
        return np.zeros(0, np.int64)
    starts.sort()
    edges = np.flatnonzero(np.diff(starts, prepend=-1))
    places = starts[edges].astype(np.int64)
    votes = np.diff(edges, append=len(starts))
    beside = np.flatnonzero(np.diff(places) == 1)
    both = votes.copy()
    both[beside] += votes[beside + 1]
    both[beside + 1] += votes[beside]
    several = both >= 3  # most places have a vote or two, by chance
    if np.count_nonzero(several) >= count:
        places, both = places[several], both[several]
    best = places[best_places(both.astype(np.float32), count)]
    near = np.unique(best[:, None] + np.arange(-1, 2))
    return near[(near >= 0) & (near < total)]


def correlate(rows: F32, query: F32) -> tuple[F32, F32]:
    """Return products of places with a query, and the energy of the places.

    Args:
        rows: (k, w, CELLS) coarse features at the places.
        query: (w, CELLS).
    """
    flat = rows.reshape(len(rows), -1)
    return flat @ query.ravel(), np.einsum("ij,ij->i", flat, flat)


def normalise(scores: F32, energy: F32, query: F32, floor: float) -> F32:
    """Return normalised correlations, (k,), as CoarseScan does."""
    power = float((query**2).sum()) + 1e-9
    return np.asarray(scores / np.sqrt(np.maximum(energy, floor) * power), np.float32)


class SilentIfDamaged(Sequence[Fine]):
    """Tracks that are checked when first used: a damaged one is silence, which is said once.

    A listener that plays a show goes on with the other tracks.
    """

    def __init__(self, tracks: Sequence[Fine], power: Sequence[Power]) -> None:
        """Take the features of each track, (n_i, NUM_BANDS), and their power, (n_i,)."""
        self._tracks, self._power = tracks, power
        self._silence: dict[int, Fine] = {}

    def __len__(self) -> int:
        """Return the number of tracks."""
        return len(self._tracks)

    def __getitem__(self, number: Any) -> Any:
        """Return the features of a track, (n, NUM_BANDS)."""
        if number in self._silence:
            return self._silence[number]
        try:
            return self._tracks[number]
        except PerceptionError as error:
            print(f"A track is not recognised any more: {error}", file=sys.stderr)
            silence = np.zeros((len(self._power[number]), NUM_BANDS), np.int8)
            self._silence[number] = silence
            return silence


def prepare(index: Index, max_scanned_tracks: int = MAX_SCANNED_TRACKS) -> tuple[Scan, FineAligner]:
    """Return both stages of the search over an index; decoys belong to a small one.

    Args:
        index: At least one track.
        max_scanned_tracks: Above it an inverted index proposes places.
    """
    if len(index.names) > max_scanned_tracks:
        table = index.codes or make_code_table(index.coarse)
        fine = SilentIfDamaged(index.fine, index.power)
        return ProposedScan(index.coarse, table), FineAligner(fine, index.power)
    decoys = make_decoys(index.fine)
    scan = CoarseScan([*index.coarse, *(coarse_of_fine(d) for d in decoys)])
    power = [*index.power, *(power_of_fine(d) for d in decoys)]
    return scan, FineAligner([*index.fine, *decoys], power)
