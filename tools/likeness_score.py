"""The figures of `downbeat eval likeness`, from vectors alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.stats import kendalltau

from downbeat.perception.features import F32
from downbeat.perception.likeness import unit
from downbeat.perception.likeness_store import LikenessTable

F64 = npt.NDArray[np.float64]
BOOTSTRAP = 2000


@dataclass(frozen=True)
class Heard:
    """What one embedder makes of a folder.

    Attributes:
        groups: Per track its group.
        tables: Of whole tracks, first halves, second halves; windows (n, dim) per track.
        queries: Unit vectors, (q, dim).
        owners: Per query the number of its track.
        query_ms: Per query the time of one core [ms].
    """

    groups: list[str]
    tables: tuple[LikenessTable, LikenessTable, LikenessTable]
    queries: F32
    owners: npt.NDArray[np.int64]
    query_ms: list[float]


def score(heard: Heard, seed: int) -> dict[str, Any]:
    """Return the report; shares are 0..1, `ci95` are bootstrap intervals over tracks."""
    rng = np.random.default_rng(seed)
    group = np.array(heard.groups)
    tracks = len(group)
    scores = np.array([heard.tables[0].scores(q) for q in heard.queries])  # (q, tracks)
    alone = np.array([np.sum(group == g) < 2 for g in group])
    top1, chance, order = _per_track(scores, heard.owners, group, alone)
    halves = _halves(heard)
    own = _own_half(heard)
    times = np.percentile(heard.query_ms, (50, 99))
    return {
        "tracks": tracks,
        "queries": len(heard.owners),
        "group_top1": _summary(top1, rng, float(np.mean(chance))),
        "group_top1_by_group": {
            str(g): round(float(np.mean(top1[group[~alone] == g])), 3)
            for g in np.unique(group[~alone])
        },
        "group_top1_above_chance": _summary(top1 - chance, rng, 0.0),
        "permutation_p": _permutation_p(scores, heard.owners, group, alone, rng),
        "group_rank": _summary(order, rng, 0.0),
        "halves_kendall": _summary(halves[0], rng, float(np.mean(halves[1]))),
        "halves_kendall_above_strangers": _summary(halves[0] - halves[1], rng, 0.0),
        "halves_same_choice": _summary(halves[2], rng, 1.0 / (tracks - 1)),
        "other_half_top1": _summary(own, rng, 1.0 / tracks),
        "query_ms": {"p50": round(times[0], 2), "p99": round(times[1], 2)},
    }


def _per_track(
    scores: F64,
    owners: npt.NDArray[np.int64],
    group: npt.NDArray[np.str_],
    alone: npt.NDArray[np.bool_],
) -> tuple[F64, F64, F64]:
    """Return per track with company: share of right groups, its chance, rank agreement (-1..1)."""
    rows = []
    for track in np.flatnonzero(~alone):
        others = np.arange(len(group)) != track
        same = others & (group == group[track])
        mine = scores[owners == track]
        if not len(mine):
            continue
        best = np.argmax(np.where(others, mine, -np.inf), axis=1)
        above = mine[:, same][:, :, None] > mine[:, group != group[track]][:, None, :]
        rows.append((same[best].mean(), same.sum() / others.sum(), 2.0 * above.mean() - 1.0))
    right, chance, order = np.array(rows).T
    return right, chance, order


def _permutation_p(
    scores: F64, owners: npt.NDArray[np.int64], group: npt.NDArray[np.str_],
    alone: npt.NDArray[np.bool_], rng: np.random.Generator,
) -> float:  # fmt: skip
    """Return how often groups dealt at random would fit as well."""
    best = np.argmax(np.where(owners[:, None] == np.arange(len(group)), -np.inf, scores), axis=1)
    asked = ~alone[owners]

    def share(names: npt.NDArray[np.str_]) -> float:
        return float(np.mean(names[best[asked]] == names[owners[asked]]))

    real = share(group)
    beaten = sum(share(rng.permutation(group)) >= real for _ in range(BOOTSTRAP))
    return (beaten + 1) / (BOOTSTRAP + 1)


def _halves(heard: Heard) -> tuple[F64, F64, F64]:
    """Return Kendall's tau of rankings by two halves, by halves of two tracks; same choice."""
    _, first, second = heard.tables
    count = len(first.names)
    asked = [[unit(v.mean(axis=0)) for v in t.vectors] for t in (first, second)]
    ranked = [np.array([heard.tables[0].scores(q) for q in half]) for half in asked]
    own, stranger, same = [], [], []
    for track in range(count):
        other = (track + count // 2) % count
        rest = [i for i in range(count) if i not in (track, other)]
        own.append(kendalltau(ranked[0][track, rest], ranked[1][track, rest])[0])
        stranger.append(kendalltau(ranked[0][track, rest], ranked[1][other, rest])[0])
        others = [i for i in range(count) if i != track]
        choices = [np.argmax(r[track, others]) for r in ranked]
        same.append(float(choices[0] == choices[1]))
    return np.array(own), np.array(stranger), np.array(same)


def _own_half(heard: Heard) -> F64:
    """Return whether the second half of a track finds its first half among all first halves."""
    _, first, second = heard.tables
    found = [np.argmax(first.scores(unit(v.mean(axis=0)))) for v in second.vectors]
    return np.array([float(f == i) for i, f in enumerate(found)])


def _summary(values: F64, rng: np.random.Generator, chance: float) -> dict[str, Any]:
    drawn = values[rng.integers(len(values), size=(BOOTSTRAP, len(values)))].mean(axis=1)
    low, high = np.percentile(drawn, (2.5, 97.5))
    return {
        "mean": round(float(values.mean()), 4),
        "ci95": [round(float(low), 4), round(float(high), 4)],
        "chance": round(chance, 4),
        "tracks": len(values),
    }
