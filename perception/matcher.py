"""Which track is this, and where in it: exhaustive alignment in two stages (alignment.py).

Accepted is what speaks for itself, cell by cell, and stands above the best *other* track and the
query's own chance (verdict.py). Decoys, the catalogue backwards and transposed, compete like any
other track and never win. Measured in docs/matcher.md.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from downbeat.perception import features as ft
from downbeat.perception.alignment import FINE_S, RATES, Fit, Heard
from downbeat.perception.best_places import I64, spread_out
from downbeat.perception.candidates import MAX_SCANNED_TRACKS, prepare
from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32
from downbeat.perception.index import FINE_PER_COARSE, PAD_FRAMES, SILENT_PEAK, Fine, Index
from downbeat.perception.match import MatchResult, MusicMatcher, check_rate
from downbeat.perception.passages import Twins
from downbeat.perception.repeats import REPEAT_APART_S, like_places, repeats_of
from downbeat.perception.verdict import Numbers, agreement, is_bare, learned, measure

__all__ = ["AlignmentMatcher", "MatchResult", "MusicMatcher"]

PITCHES, PLAIN_SIMILARITY = (1.02, 0.98), 0.7
"""No other pitch is tried where this one fits so well."""
CANDIDATES, PER_TRACK, PITCHED, REPEATS = 24, 4, 6, 12
"""Places aligned finely: in all, of one track, also at other pitches, more of the winner."""
RANKED = 400
DEEP_CANDIDATES, DEEP_FRAMES, DEEP_RATES = 48, 30, (1.0, 0.98, 1.02)
"""Where that accepts nothing, a window of 2.4 s or more is worth a look at more places, also from
its second frame on, as it may lie between two places of the scan: under loud voices the right one
was behind two hundred others, and first at the other phase."""
SEARCH = 6
"""Fine search +-6 frames of 40 ms around a coarse place."""
CHECK_SEARCH = REPEAT_SEARCH = 3
REPEAT_RATES_OFF = (0.0, -0.01, 0.01)
"""From that of the winner, whose repeats are played at the same speed; a wrong one may have met it
at another, so that 1 is tried too."""
TWIN_SHARE = 0.95
"""A track that shares the passage and reaches this share is its twin: the same recording reaches
0.97 in any noise. What fits less is a rival like any other."""
SPEED_FRAMES, NEAR_SPEED, OWN_SPEED_SHARE = 30, 0.02, 0.9
"""A window shorter than 2.4 s hardly tells the speed. Half of those of 1.25 s that are right fit
best at another than the track's own, but nearly as well at that: 0.92 of the similarity or more in
99 of 100. Loops of a drum machine that meet one of another tempo mostly reach less: made ones 0.7
to 0.8 where they are played faster or slower, 0.87 and more where only the tempo differs."""
MIN_WINDOW_FRAMES = 8


class AlignmentMatcher:
    """The two-stage matcher over an index."""

    def __init__(
        self, index: Index | None = None, max_scanned_tracks: int = MAX_SCANNED_TRACKS
    ) -> None:
        self.index = index or Index()
        self._max_scanned_tracks = max_scanned_tracks
        self._ready = False
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
        self._ready = False

    def finish(self) -> None:
        """Prepare for queries.

        Raises:
            PerceptionError: Nothing was added.
        """
        if not self.index.names:
            raise PerceptionError("The index holds no track; `add` at least one before a query.")
        self._scan, self._aligner = prepare(self.index, self._max_scanned_tracks)
        self._twins = Twins(self.index.names, self.index.shared or ())
        self._ready = True

    def save(self, path: Path) -> None:
        """Write the index."""
        self.index.save(path)

    @classmethod
    def load(cls, path: Path) -> AlignmentMatcher:
        """Read an index written by `save`.

        Raises:
            PerceptionError: The file is missing, foreign, of another version or damaged.
        """
        return cls(Index.load(path))

    def query(self, samples: F32, sample_rate_hz: int) -> MatchResult:
        """Match a window; silence, and what is not finite, matches nothing.

        Args:
            samples: (n,) mono; 1 to 10 s.
            sample_rate_hz: At least 8 kHz.

        Raises:
            PerceptionError: The rate is too low, or the index is empty.
        """
        values = self._heard(samples, sample_rate_hz)
        if values is None:
            return MatchResult()
        found, ranked, chance = self._look(values)
        result = self._decide(values, _sorted(found), chance)
        if result.accepted or len(values) < DEEP_FRAMES:
            return result
        self._look_deeper(values, found, ranked)
        return self._decide(values, _sorted(found), chance)

    def weigh(
        self, samples: F32, sample_rate_hz: int
    ) -> tuple[MatchResult, npt.NDArray[np.float64]] | None:
        """Match a window, looking everywhere, and say what the answer was made of.

        Returns:
            The answer, and its measures (verdict.py); None of silence and of what is one of twins.
        """
        values = self._heard(samples, sample_rate_hz)
        if values is None:
            return None
        found, ranked, chance = self._look(values)
        if len(values) >= DEEP_FRAMES:
            self._look_deeper(values, found, ranked)
        fits = _sorted(found)
        best, others, twins = self._compare(values, fits)
        if best is None or twins:
            return None
        result = self._decide(values, fits, chance)
        return result, measure(*self._evidence(values, best, others, chance))

    def agreement(
        self, samples: F32, sample_rate_hz: int, track: str, tau_s: float
    ) -> tuple[float, float]:
        """Compare a window with a known place, at rate 1.

        Args:
            samples: (n,) mono.
            sample_rate_hz: At least 8 kHz.
            track: A name of the index.
            tau_s: Where the window should start [s].

        Returns:
            Similarity, and how far the best place nearby lies after `tau_s` [s].
        """
        values = _audible_features(samples, sample_rate_hz)
        if len(values) < 2 or track not in self.names:
            return 0.0, 0.0
        first = round(tau_s / FINE_S) + PAD_FRAMES
        number = self.names.index(track)
        fit = self._aligner.align(Heard(values), number, first, CHECK_SEARCH, (1.0,))
        return fit.similarity, fit.tau_s - tau_s

    def _heard(self, samples: F32, sample_rate_hz: int) -> F32 | None:
        """Return the features of a window, an even number; None: too little to be matched."""
        check_rate(sample_rate_hz)
        if not self._ready:
            self.finish()
        values = _audible_features(samples, sample_rate_hz)
        return values[: len(values) // 2 * 2] if len(values) >= MIN_WINDOW_FRAMES else None

    def _look(self, values: F32) -> tuple[dict[int, Fit], I64, float]:
        """Return fits by place of the scan, the places it ranked, and the spread of its scores."""
        ranked, chance = self._scan.search(values, RANKED)
        places = spread_out(ranked, self._scan.track_of, CANDIDATES, PER_TRACK).tolist()
        heard = Heard(values)
        found = {place: self._fit(heard, place) for place in places}
        is_plain = bool(found) and max(found.values()).similarity > PLAIN_SIMILARITY
        for pitch in () if is_plain else PITCHES:
            heard = Heard(ft.shift_pitch(values, pitch), pitch)
            for place in places[:PITCHED]:
                found[place] = max(found[place], self._fit(heard, place))
        self._look_at_repeats(values, found)
        return found, ranked, chance

    def _look_deeper(self, values: F32, found: dict[int, Fit], ranked: I64) -> None:
        """Add fits at places between those of the scan, and behind the first that it ranked."""
        track, heard = max(found.values()).track, Heard(values)
        track_of = self._scan.track_of
        between, _ = self._scan.search(values[1:], RANKED)
        for order in (between, ranked):
            for place in spread_out(order, track_of, DEEP_CANDIDATES, PER_TRACK).tolist():
                if place not in found:
                    found[place] = self._fit(heard, place, DEEP_RATES)
        if max(found.values()).track != track:
            self._look_at_repeats(values, found)

    def _look_at_repeats(self, values: F32, found: dict[int, Fit]) -> None:
        """Add other places of the winning track, at its pitch and speed: it may repeat itself."""
        best = max(found.values())
        if best.track >= len(self.names):
            return  # a decoy
        if best.pitch != 1.0:
            values = ft.shift_pitch(values, best.pitch)
        heard = Heard(values, best.pitch)
        near = [round(best.rate + off, 2) for off in REPEAT_RATES_OFF]
        rates = tuple(rate for rate in RATES if rate == 1.0 or rate in near)
        for first in like_places(self.index.coarse[best.track], values, REPEATS).tolist():
            fit = self._aligner.align(heard, best.track, first, REPEAT_SEARCH, rates)
            if abs(fit.tau_s - best.tau_s) >= REPEAT_APART_S:
                found[-1 - len(found)] = fit  # no place of the scan

    def _fit(self, heard: Heard, place: int, rates: tuple[float, ...] = RATES) -> Fit:
        """Align finely around a coarse place."""
        track = int(self._scan.track_of[place])
        first = FINE_PER_COARSE * (place - int(self._scan.starts[track]))
        return self._aligner.align(heard, track, first, SEARCH, rates)

    def _compare(self, values: F32, fits: list[Fit]) -> tuple[Fit | None, list[Fit], list[Fit]]:
        """Return the best fit, those of other tracks, and its twins among them."""
        best = next((fit for fit in fits if fit.track < len(self.names)), None)
        if best is None:
            return None, [], []
        twins = self._twins_of(best, len(values) * ft.HOP_S, fits)
        alike = {best.track, *(fit.track for fit in twins)}
        return best, [fit for fit in fits if fit.track not in alike], twins

    def _evidence(
        self, values: F32, best: Fit, others: list[Fit], chance: float
    ) -> tuple[F32, Fine, Numbers]:
        """Return what the verdict looks at."""
        query = values if best.pitch == 1.0 else ft.shift_pitch(values, best.pitch)
        reference = self._aligner.rows(best, len(values))
        second = others[0].similarity if others else 0.0
        return query, reference, Numbers(best.similarity, second, chance, best.rate, best.pitch)

    def _decide(self, values: F32, fits: list[Fit], chance: float) -> MatchResult:
        best, others, twins = self._compare(values, fits)
        if best is None:
            return MatchResult(votes=len(values))
        seconds = len(values) * ft.HOP_S
        verdict = learned()
        evidence = self._evidence(values, best, others, chance)
        odds = verdict.log_odds(*evidence)
        score = odds - float(verdict.accept.of(seconds))
        rival = next(iter(others), None)
        is_track = rival is not None and rival.track < len(self.names)
        return MatchResult(
            track=self.names[best.track],
            tau_s=best.tau_s,
            rate=best.rate,
            confidence=score,
            accepted=score > 0.0 and not twins,
            doubtful=odds <= float(verdict.lock.of(seconds))
            or is_bare(agreement(*evidence[:2]))
            or not self._may_be_own(values, best),
            similarity=best.similarity,
            runner_up=self.names[rival.track] if rival is not None and is_track else "",
            runner_up_confidence=rival.similarity if rival is not None else 0.0,
            votes=len(values),
            repeats=repeats_of(best, fits),
            twins=tuple((self.names[fit.track], fit.tau_s) for fit in twins),
        )

    def _may_be_own(self, values: F32, best: Fit) -> bool:
        """Say if a brief window may be the track at its own speed and pitch; True of others."""
        is_own = best.pitch == 1.0 and abs(best.rate - 1.0) <= NEAR_SPEED
        if is_own or len(values) >= SPEED_FRAMES:
            return True
        turned_s = 0.5 * (best.rate - 1.0) * (len(values) - 1) * ft.HOP_S  # about the middle
        first = round((best.tau_s + turned_s) / FINE_S) + PAD_FRAMES
        own = self._aligner.align(Heard(values), best.track, first, CHECK_SEARCH, (1.0,))
        return own.similarity >= OWN_SPEED_SHARE * best.similarity

    def _twins_of(self, best: Fit, seconds: float, fits: list[Fit]) -> list[Fit]:
        """Return the best fits of tracks that share this passage, where they fit nearly as well."""
        twins: dict[int, Fit] = {}
        for number in self._twins.of(best.track, best.tau_s, seconds):
            fit = next((fit for fit in fits if fit.track == number), None)
            if fit is not None and fit.similarity >= TWIN_SHARE * best.similarity:
                twins[number] = fit
        return sorted(twins.values(), reverse=True)


def _sorted(found: dict[int, Fit]) -> list[Fit]:
    return sorted(found.values(), reverse=True)


def _audible_features(samples: F32, sample_rate_hz: int) -> F32:
    """Return features, (w, NUM_BANDS), none of silence or of what is not finite."""
    peak = float(np.abs(samples).max()) if len(samples) else 0.0
    if not SILENT_PEAK <= peak < np.inf:  # NaN fails too
        return np.zeros((0, ft.NUM_BANDS), np.float32)
    return ft.features(ft.to_matcher_rate(samples, sample_rate_hz))
