"""Recordings of a catalogue that nobody can tell apart: the same music under two names."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from downbeat.perception.alignment import FineAligner, Fit, Heard
from downbeat.perception.candidates import ProposedScan
from downbeat.perception.codes import make_code_table
from downbeat.perception.features import F32, HOP_S
from downbeat.perception.index import FINE_PER_COARSE, QUANTUM, Index

WINDOW_S = 6.0
SHARES = (0.3, 0.7)
"""Where in a track its two windows lie; both must be found, as far apart as they are."""
SIMILARITY = 0.6
APART_S = 0.5
PLACES, RANKED, SEARCH = 12, 200, 6


def find_duplicates(index: Index) -> list[tuple[str, str]]:
    """Return pairs of names that hold the same recording, however encoded or cut.

    Two windows of each track are asked of the others through the inverted index, so that the time
    grows with the number of tracks, not with its square.
    """
    if len(index.names) < 2:
        return []
    scan = ProposedScan(index.coarse, index.codes or make_code_table(index.coarse))
    aligner = FineAligner(index.fine, index.power)
    pairs: set[tuple[str, str]] = set()
    for number, name in enumerate(index.names):
        found = [_others(scan, aligner, index, number, share) for share in SHARES]
        for one in found[0]:
            for other in found[1]:
                is_same = one.track == other.track and abs(one.tau_s - other.tau_s) < APART_S
                if is_same:
                    rival = index.names[one.track]
                    pairs.add((min(name, rival), max(name, rival)))
    return sorted(pairs)


def _others(
    scan: ProposedScan, aligner: FineAligner, index: Index, number: int, share: float
) -> list[Fit]:
    """Return where in other tracks a window of a track sounds the same; tau is the difference."""
    fine = index.fine[number]
    count = min(round(WINDOW_S / HOP_S) * 2, len(fine) // 2 * 2)
    first = round(share * (len(fine) - count)) // FINE_PER_COARSE * FINE_PER_COARSE
    values: F32 = fine[first : first + count : 2].astype(np.float32) / np.float32(QUANTUM)
    places, _ = scan.search(values, RANKED)
    places = places[scan.track_of[places] != number][:PLACES]
    return [
        Fit(fit.similarity, fit.track, fit.tau_s - first * HOP_S / 2.0, fit.rate)
        for fit in _fits(scan, aligner, Heard(values), places.tolist())
        if fit.similarity > SIMILARITY
    ]


def _fits(
    scan: ProposedScan, aligner: FineAligner, heard: Heard, places: Iterable[int]
) -> Iterable[Fit]:
    for place in places:
        track = int(scan.track_of[place])
        first = FINE_PER_COARSE * (place - int(scan.starts[track]))
        yield aligner.align(heard, track, first, SEARCH, (1.0,))
