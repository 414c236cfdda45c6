"""Where else in its track a window may lie: the coarse scan of one track, twice as dense.

The scan of everything stands on a grid of 160 ms, and a window between two of its places loses
more than the difference of two repeats of a riff: the true one may be behind a dozen others.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.lib.stride_tricks import as_strided

from downbeat.perception.alignment import MAX_WIDTH, QUIET_SHARE, Fit
from downbeat.perception.best_places import I64
from downbeat.perception.features import F32
from downbeat.perception.index import FINE_PER_COARSE, QUANTUM, Coarse
from downbeat.perception.index import coarse as coarse_of

FINE_PER_FRAME = 2
"""Frames of the reference per frame of a query."""
LIKE = 0.75
"""Places below this share of the best one of the track are no repeats."""
REPEAT_SHARE, REPEAT_APART_S = 0.95, 0.25
"""A place counts as a repeat if it reaches this share of the best similarity."""


def like_places(rows: Coarse, values: F32, count: int) -> I64:
    """Return places of a track that are like a query, best first.

    Args:
        rows: (n, cells) coarse features of the track.
        values: (w, NUM_BANDS) features of the query.
        count: Places wanted, at most.

    Returns:
        Frames of the reference (40 ms) where the query may start; peaks that reach LIKE of the
        highest. Perhaps none, where the track is shorter than the query.
    """
    track = rows.astype(np.float32) / np.float32(QUANTUM)
    first, second = _scores(track, coarse_of(values)), _scores(track, coarse_of(values[1:]))
    if not len(first) or not len(second):
        return np.zeros(0, np.int64)
    # The second begins a frame (80 ms) later, so its place is half a place earlier.
    both = np.full(2 * max(len(first), len(second)) + 1, -1.0, np.float32)
    both[1 : 2 * len(first) : 2] = first
    both[0 : 2 * len(second) : 2] = second
    inner = both[1:-1]
    peaks = np.flatnonzero((inner >= both[:-2]) & (inner > both[2:])) + 1
    peaks = peaks[both[peaks] >= LIKE * both.max()]
    peaks = peaks[np.argsort(-both[peaks], kind="stable")][:count]
    return (peaks - 1) * (FINE_PER_COARSE // FINE_PER_FRAME)


def repeats_of(best: Fit, fits: Iterable[Fit]) -> tuple[float, ...]:
    """Return where else in its track the best fit is nearly reached [s], in the order of `fits`."""
    found: list[float] = []
    for fit in fits:
        is_near = any(abs(fit.tau_s - tau_s) < REPEAT_APART_S for tau_s in (best.tau_s, *found))
        if fit.track == best.track and fit.similarity >= REPEAT_SHARE * best.similarity:
            found += [] if is_near else [fit.tau_s]
    return tuple(found)


def _scores(track: F32, query: F32) -> F32:
    """Return the normalised correlation of a query with each place of a track, (n - w + 1,)."""
    query = query[:MAX_WIDTH]
    count, width = len(track) - len(query) + 1, len(query)
    if count < 1 or not width:
        return np.zeros(0, np.float32)
    products = np.ascontiguousarray(track @ query.T)  # (n, w)
    down, along = products.strides
    sums = as_strided(products, (count, width), (down, down + along)).sum(1)
    power = np.concatenate([[0.0], np.cumsum(np.einsum("ij,ij->i", track, track))])
    energy = power[width:] - power[:-width]
    floor = QUIET_SHARE * float(np.median(energy)) + 1e-9
    scale = np.sqrt(np.maximum(energy, floor) * (float((query**2).sum()) + 1e-9))
    return np.asarray(sums / scale, np.float32)
