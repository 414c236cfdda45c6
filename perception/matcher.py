"""Which track is this, and where in it: exhaustive alignment in two stages.

1. Coarse: normalised correlation of the query with every place of every track (160 ms, 1/8 octave).
2. Fine: for the best places one Gram matrix query x reference; every (offset, rate) hypothesis is a
   line through it. Sub-frame position by a parabola.
Accepted is what stands far enough above the best *other* track, in units of the query's own chance
spread. Silence, tones and unknown music do not.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from downbeat.perception import features as ft
from downbeat.perception.features import F32
from downbeat.perception.index import PAD_FRAMES, Index, coarse

RATES = np.array([1.0, 0.99, 1.01, 0.98, 1.02, 0.97, 1.03, 0.96, 1.04, 0.95, 1.05])
"""Time stretch; 1 first, so that ties go to it."""
PITCHES = (1.02, 0.98)
CANDIDATES, PER_TRACK, PITCHED, MORE_PLACES = 24, 4, 6, 12
SEARCH = 6
"""Fine search +-6 frames of 40 ms around a coarse place."""
RUNNER_UP_SHARE = 0.8
INFORMATION = 0.5
"""Mean square of a query rich in notes; poorer queries correlate by chance and must pay."""
RATE_PENALTY = 0.15
MIN_PEAK = 1e-3
THRESHOLDS = ((1.2, 4.2), (1.5, 3.8), (2.0, 3.2), (3.0, 2.6), (5.0, 2.0))
"""(window [s], score): shorter windows meet more chance and must stand higher."""


def threshold(seconds: float) -> float:
    """Return the acceptance score that a window of this length needs."""
    lengths, scores = zip(*THRESHOLDS)
    return float(np.interp(seconds, lengths, scores))


@dataclass(frozen=True, slots=True)
class MatchResult:
    """The answer to one query.

    Attributes:
        track: Best track, empty if nothing was heard.
        tau_s: Position of the window's start in it [s].
        rate: Track seconds per real second.
        confidence: Acceptance score.
        accepted: The score passes the threshold of the window's length.
        similarity: Best raw correlation, -1..1.
        runner_up: Best other track.
        runner_up_confidence: Its raw correlation.
        votes: Frames compared.
    """

    track: str = ""
    tau_s: float = 0.0
    rate: float = 1.0
    confidence: float = 0.0
    accepted: bool = False
    similarity: float = 0.0
    runner_up: str = ""
    runner_up_confidence: float = 0.0
    votes: int = 0


class MusicMatcher(Protocol):
    """What the listener needs; constellation and embedding matchers implement it too."""

    names: list[str]

    def query(self, samples: F32, sample_rate_hz: int) -> MatchResult:
        """Match a window of 1.2 to 10 s."""
        ...

    def agreement(
        self, samples: F32, sample_rate_hz: int, track: str, tau_s: float
    ) -> tuple[float, float]:
        """Return (similarity, correction [s]) of a window against a known place."""
        ...


class AlignmentMatcher:
    """The two-stage matcher over an index."""

    def __init__(self, index: Index | None = None) -> None:
        self.index = index or Index()
        self._ready = False
        if self.index.names:
            self.finish()

    @property
    def names(self) -> list[str]:
        """Track names."""
        return self.index.names

    def add(self, name: str, samples: F32, sample_rate_hz: int) -> None:
        """Index one track; call `finish` after the last."""
        self.index.add(name, samples, sample_rate_hz)
        self._ready = False

    def finish(self) -> None:
        """Prepare for queries."""
        lengths = np.array([len(values) for values in self.index.coarse])
        self._starts = np.concatenate([[0], np.cumsum(lengths)[:-1]])
        self._all = np.concatenate(self.index.coarse).astype(np.float32)  # (n, 49)
        self._track_of = np.repeat(np.arange(len(lengths)), lengths)  # (n,)
        self._ends = (self._starts + lengths)[self._track_of]  # (n,)
        power = (self._all.astype(np.float64) ** 2).sum(1)
        self._energy = np.concatenate([[0.0], np.cumsum(power)])
        self._fine_energy = [
            np.concatenate([[0.0], np.cumsum((fine.astype(np.float64) ** 2).sum(1))]) / 2.0
            for fine in self.index.fine
        ]
        self._ready = True

    def save(self, path: Path) -> None:
        """Write the index."""
        self.index.save(path)

    @classmethod
    def load(cls, path: Path) -> AlignmentMatcher:
        """Read an index written by `save`."""
        return cls(Index.load(path))

    # ------------------------------------------------------------------ queries

    def query(self, samples: F32, sample_rate_hz: int) -> MatchResult:
        """Match a window of 1.2 to 10 s; silence matches nothing."""
        if not self._ready:
            self.finish()
        if len(samples) == 0 or float(np.abs(samples).max()) < MIN_PEAK:
            return MatchResult()
        values = ft.features(ft.to_matcher_rate(samples, sample_rate_hz))
        values = values[: len(values) // 2 * 2]
        if len(values) < 8:
            return MatchResult()
        fits, spread = self._search(values)
        return self._decide(values, fits, spread)

    def _search(self, values: F32) -> tuple[list[_Fit], float]:
        scores = self._coarse_scores(values)  # (n,)
        spread = float(scores[::4].std())
        ranked = _top(scores, min(400, len(scores)))
        places = _pick(ranked, self._track_of, CANDIDATES, PER_TRACK)
        energy = float((values**2).sum()) + 1e-9
        fits = [self._fit(values, energy, int(place)) for place in places]
        for ratio in PITCHES:
            shifted = ft.shift_pitch(values, ratio)
            shifted_energy = float((shifted**2).sum()) + 1e-9
            for i, place in enumerate(places[:PITCHED]):
                fits[i] = max(fits[i], self._fit(shifted, shifted_energy, int(place)))
        # Repeats inside the winning track: look at more of its places to find the best one.
        winner = max(fits).track
        own = ranked[self._track_of[ranked] == winner]
        more = _pick(own, self._track_of, MORE_PLACES + PER_TRACK, MORE_PLACES + PER_TRACK)
        seen = set(places.tolist())
        fits += [self._fit(values, energy, int(p)) for p in more if int(p) not in seen]
        return sorted(fits, reverse=True), spread

    def _coarse_scores(self, values: F32) -> F32:
        """Return the normalised correlation at every place of the catalogue, (n,)."""
        query = coarse(values)  # (w, 49)
        width, total = len(query), len(self._all)
        padded = np.concatenate([self._all, np.zeros((width, self._all.shape[1]), np.float32)])
        gram = query @ padded.T  # (w, n + w)
        scores = np.zeros(total, np.float32)
        for row in range(width):  # the sum along diagonals, one vector addition per query frame
            scores += gram[row, row : row + total]
        energy = self._energy[np.minimum(np.arange(total) + width, total)] - self._energy[:-1]
        floor = 0.25 * float(np.median(energy))  # quiet places are not blown up
        norm = np.sqrt(np.maximum(energy, floor) * (float((query**2).sum()) + 1e-9))
        scores = (scores / norm).astype(np.float32)
        scores[np.arange(total) + width > self._ends] = 0.0  # windows across two tracks
        return scores

    def _fit(self, values: F32, energy: float, place: int) -> _Fit:
        """Align finely around one coarse place."""
        track = int(self._track_of[place])
        first = 4 * (place - int(self._starts[track]))
        return self._align(values, energy, track, first, SEARCH, RATES)

    def _align(
        self, values: F32, energy: float, track: int, first: int, search: int, rates: F32
    ) -> _Fit:
        """Return the best (offset, rate) with the window starting near fine frame `first`."""
        fine = self.index.fine[track]
        frames = len(values)
        centre = (frames - 1) / 2.0
        margin = int(np.ceil(2 * centre * np.abs(rates - 1.0).max())) + search + 2
        begin, length = first - margin, 2 * frames + 2 * margin
        reference = np.zeros((length, ft.NUM_BANDS), np.float32)
        low, high = max(begin, 0), min(begin + length, len(fine))
        if high <= low:
            return _Fit(0.0, track, 0.0, 1.0)
        reference[low - begin : high - begin] = fine[low:high]
        gram = values @ reference.T  # (frames, length)
        rows = np.arange(frames)
        lines = np.round(2.0 * (centre + np.outer(rates, rows - centre))).astype(np.int64)
        offsets = np.arange(-search, search + 1)
        columns = lines[:, None, :] + margin + offsets[None, :, None]  # (rates, offsets, frames)
        scores = gram[rows[None, None, :], columns].sum(-1)  # (rates, offsets)
        r, d = np.unravel_index(int(scores.argmax()), scores.shape)
        nudge = _parabola(scores[r], int(d))
        begin_fine = max(0, first)
        stop = min(len(fine), begin_fine + 2 * frames)
        own = self._fine_energy[track]
        # A quiet reference must not blow a chance likeness up: at least a quarter of the usual.
        usual = own[-1] / len(fine) * 2 * frames
        reference_energy = max(own[stop] - own[min(begin_fine, len(fine))], 0.25 * usual, 1.0)
        similarity = min(float(scores[r, d]) / np.sqrt(reference_energy * energy), 1.0)
        rate = float(rates[r])
        # The line is centred on the window; at another rate the window starts elsewhere.
        start = first + float(offsets[d]) + nudge + 2.0 * centre * (1.0 - rate) - PAD_FRAMES
        return _Fit(float(similarity), track, start * ft.HOP_S / 2.0, rate)

    def _decide(self, values: F32, fits: list[_Fit], spread: float) -> MatchResult:
        best = fits[0]
        other = next((fit for fit in fits if fit.track != best.track), None)
        second = 0.0 if other is None else other.similarity
        information = min(1.0, float((values**2).mean()) / INFORMATION)
        score = (best.similarity - RUNNER_UP_SHARE * second) / (spread + 1e-3) * information
        score -= RATE_PENALTY * 100.0 * abs(best.rate - 1.0)
        return MatchResult(
            track=self.names[best.track],
            tau_s=best.tau_s,
            rate=best.rate,
            confidence=float(score),
            accepted=bool(score > threshold(len(values) * ft.HOP_S)),
            similarity=best.similarity,
            runner_up="" if other is None else self.names[other.track],
            runner_up_confidence=second,
            votes=len(values),
        )

    def agreement(
        self, samples: F32, sample_rate_hz: int, track: str, tau_s: float
    ) -> tuple[float, float]:
        """Return (similarity, correction [s]) of a window against a known place, rate 1."""
        values = ft.features(ft.to_matcher_rate(samples, sample_rate_hz))
        if len(values) < 2 or float(np.abs(samples).max()) < MIN_PEAK:
            return 0.0, 0.0
        first = round(tau_s / (ft.HOP_S / 2.0)) + PAD_FRAMES
        energy = float((values**2).sum()) + 1e-9
        fit = self._align(values, energy, self.names.index(track), first, 3, np.ones(1))
        return fit.similarity, fit.tau_s - tau_s


@dataclass(frozen=True, slots=True, order=True)
class _Fit:
    similarity: float
    track: int
    tau_s: float
    rate: float


def _parabola(scores: npt.NDArray[np.float32], peak: int) -> float:
    """Return the offset of the vertex through the peak and its neighbours, in frames."""
    if not 0 < peak < len(scores) - 1:
        return 0.0
    left, middle, right = (float(s) for s in scores[peak - 1 : peak + 2])
    curvature = left - 2.0 * middle + right
    return 0.5 * (left - right) / curvature if curvature < 0.0 else 0.0


def _top(scores: F32, count: int) -> npt.NDArray[np.int64]:
    """Return the places of the `count` highest scores, best first."""
    best = np.argpartition(scores, len(scores) - count)[len(scores) - count :]
    return best[np.argsort(-scores[best], kind="stable")]


def _pick(
    ranked: npt.NDArray[np.int64], track_of: npt.NDArray[np.int64], count: int, per_track: int
) -> npt.NDArray[np.int64]:
    """Return the best `count` places, at most `per_track` of a track, no two adjacent."""
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
