"""Which track is this, and where in it: exhaustive alignment in two stages (alignment.py).

Accepted is what stands far enough above the best *other* track, in units of the query's own chance
spread; queries and places that hold little (tones, single notes, pauses) must stand higher.
Decoys, the catalogue backwards and transposed, compete like any other track and never win.
Measured in docs/matcher.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from downbeat.perception import features as ft
from downbeat.perception.alignment import FINE_S, RATES, Fit, Heard, spread_out
from downbeat.perception.candidates import MAX_SCANNED_TRACKS, prepare
from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32
from downbeat.perception.index import FINE_PER_COARSE, PAD_FRAMES, SILENT_PEAK, Index
from downbeat.perception.match import MatchResult, MusicMatcher
from downbeat.perception.passages import Twins
from downbeat.perception.repeats import like_places

__all__ = ["AlignmentMatcher", "MatchResult", "MusicMatcher", "threshold"]

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
RUNNER_UP_SHARE = 0.8
SPREAD_FLOOR = 1e-3
REPEAT_SHARE, REPEAT_APART_S = 0.95, 0.25
"""A place counts as a repeat if it reaches this share of the best similarity."""
TWIN_SHARE = 0.95
"""A track that shares the passage and reaches this share is its twin: the same recording reaches
0.97 in any noise. What fits less is a rival like any other."""
INFORMATION = 0.5
"""Mean square of features rich in notes, of query and place together; what is poorer is alike by
chance and must pay by the square root."""
RATE_PENALTY = 15.0
"""Score per unit of rate off 1."""
MIN_WINDOW_FRAMES = 8
MIN_SAMPLE_RATE_HZ = 8_000
THRESHOLDS = (
    (1.0, 3.0), (1.25, 2.8), (1.5, 2.6), (2.0, 2.4), (3.0, 2.3), (5.0, 2.5), (8.0, 2.7),
)  # fmt: skip
"""(window [s], score). Calibrated on 81 recordings, each in turn a stranger to the 80 others or to
8 of them, clean, coded, in noise and by the robot's microphone, and shuffled, backwards, and on
voices, animals and tones: at most 0.3 % of 2, 3 and 5 s windows of strangers stand higher. Shorter
windows meet more chance."""


LOCK_THRESHOLDS = ((1.0, 4.2), (1.25, 4.0), (2.0, 3.6), (3.0, 3.6), (5.0, 4.0), (8.0, 4.4))
"""The same for a lock: a listener that is lost asks 40,000 windows an hour, and each may be wrong.
Nearly one above the highest of any stranger in three quarters of an hour of streams, of that
calibration and of other recordings: 2.9 at 1.25 to 3 s, 3.0 at 5 s, 3.3 at 8 s. Higher stood only
a medley of pieces that the catalogue held."""


def threshold(seconds: float, table: Sequence[tuple[float, float]] = THRESHOLDS) -> float:
    """Return the acceptance score that a window of this length needs."""
    lengths, scores = zip(*table)
    return float(np.interp(seconds, lengths, scores))


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
        _check_rate(sample_rate_hz)
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
        _check_rate(sample_rate_hz)
        if not self._ready:
            self.finish()
        values = _audible_features(samples, sample_rate_hz)
        if len(values) < MIN_WINDOW_FRAMES:
            return MatchResult()
        values = values[: len(values) // 2 * 2]
        fits, chance = self._search(values)
        return self._decide(values, fits, chance)

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

    def _search(self, values: F32) -> tuple[list[Fit], float]:
        """Return the fits, best first, and the chance spread of the coarse scores."""
        ranked, chance = self._scan.search(values, RANKED)
        track_of = self._scan.track_of
        places = spread_out(ranked, track_of, CANDIDATES, PER_TRACK).tolist()
        heard = {1.0: Heard(values)}
        found = {place: self._fit(heard[1.0], place) for place in places}
        is_plain = bool(found) and max(found.values()).similarity > PLAIN_SIMILARITY
        for pitch in () if is_plain else PITCHES:
            heard[pitch] = Heard(ft.shift_pitch(values, pitch), pitch)
            for place in places[:PITCHED]:
                found[place] = max(found[place], self._fit(heard[pitch], place))
        self._look_at_repeats(values, found)
        if len(values) >= DEEP_FRAMES and not self._decide(values, _sorted(found), chance).accepted:
            best = max(found.values())
            between, _ = self._scan.search(values[1:], RANKED)
            for order in (between, ranked):
                for place in spread_out(order, track_of, DEEP_CANDIDATES, PER_TRACK).tolist():
                    if place not in found:
                        found[place] = self._fit(heard[1.0], place, DEEP_RATES)
            if max(found.values()).track != best.track:
                self._look_at_repeats(values, found)
        return _sorted(found), chance

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

    def _decide(self, values: F32, fits: list[Fit], chance: float) -> MatchResult:
        best = next((fit for fit in fits if fit.track < len(self.names)), None)
        if best is None:
            return MatchResult(votes=len(values))
        seconds = len(values) * ft.HOP_S
        twins = self._twins_of(best, seconds, fits)
        alike = {best.track, *(fit.track for fit in twins)}
        other = next((fit for fit in fits if fit.track not in alike), None)
        second = 0.0 if other is None else other.similarity
        information = float(np.sqrt((values**2).mean() * best.information))
        rich = min(information / INFORMATION, 1.0) ** 0.5
        margin = best.similarity - RUNNER_UP_SHARE * second
        score = margin / (chance + SPREAD_FLOOR) * rich
        score -= RATE_PENALTY * abs(best.rate - 1.0)
        is_track = other is not None and other.track < len(self.names)
        return MatchResult(
            track=self.names[best.track],
            tau_s=best.tau_s,
            rate=best.rate,
            confidence=score,
            accepted=score > threshold(seconds) and not twins,
            doubtful=score <= threshold(seconds, LOCK_THRESHOLDS),
            similarity=best.similarity,
            runner_up=self.names[other.track] if other is not None and is_track else "",
            runner_up_confidence=second,
            votes=len(values),
            repeats=_repeats(best, fits),
            twins=tuple((self.names[fit.track], fit.tau_s) for fit in twins),
        )

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


def _repeats(best: Fit, fits: list[Fit]) -> tuple[float, ...]:
    """Return where else in its track the best fit is nearly reached [s]."""
    found: list[float] = []
    for fit in fits:
        is_near = any(abs(fit.tau_s - tau_s) < REPEAT_APART_S for tau_s in (best.tau_s, *found))
        if fit.track == best.track and fit.similarity >= REPEAT_SHARE * best.similarity:
            found += [] if is_near else [fit.tau_s]
    return tuple(found)


def _audible_features(samples: F32, sample_rate_hz: int) -> F32:
    """Return features, (w, NUM_BANDS), none of silence or of what is not finite."""
    peak = float(np.abs(samples).max()) if len(samples) else 0.0
    if not SILENT_PEAK <= peak < np.inf:  # NaN fails too
        return np.zeros((0, ft.NUM_BANDS), np.float32)
    return ft.features(ft.to_matcher_rate(samples, sample_rate_hz))


def _check_rate(sample_rate_hz: int) -> None:
    if sample_rate_hz < MIN_SAMPLE_RATE_HZ:
        raise PerceptionError(
            f"Sound at {sample_rate_hz} Hz cannot be matched; valid is {MIN_SAMPLE_RATE_HZ} Hz "
            "and above."
        )
