"""The highest of many scores: which places of the catalogue are worth a closer look."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from downbeat.perception.features import F32

I64 = npt.NDArray[np.int64]


def best_places(scores: F32, count: int) -> I64:
    """Return the places of the `count` highest scores, best first."""
    count = min(count, len(scores))
    best = np.argpartition(scores, len(scores) - count)[len(scores) - count :]
    return best[np.argsort(-scores[best], kind="stable")]


def spread_out(ranked: I64, track_of: I64, count: int, per_track: int) -> I64:
    """Return the first `count` places, at most `per_track` of a track, no two adjacent."""
    kept: list[int] = []
    used: dict[int, int] = {}
    for place in ranked.tolist():
        track = int(track_of[place])
        if used.get(track, 0) >= per_track or any(abs(place - k) <= 1 for k in kept):
            continue
        kept.append(place)
        used[track] = used.get(track, 0) + 1
        if len(kept) == count:
            break
    return np.array(kept, np.int64)
