"""What became of the queries of the chunk study."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.signal import fftconvolve
from scipy.stats import beta

from downbeat.perception import features as ft
from downbeat.perception.features import F32
from downbeat.perception.matcher import MatchResult
from downbeat.tools.chunks_make import Query

PLACE_S = 0.1
"""A place is right within this."""
SAME_SOUND, SAME_SOUND_LAG_S, COMPARED_S = 0.8, 0.06, 4.0
"""Or where the reference is the identical recording: a loop repeated bit for bit."""


@dataclass
class ConditionScore:
    """One condition.

    Attributes:
        n: Queries that hold sound.
        top1: Right track.
        right: Right track and right place.
        accepted: Right, and accepted.
        wrong: Accepted at another track or place.
        elsewhere: Of `right`, at another repeat of the identical sound.
        twins: Answered with the names of two tracks that share the passage, the right one among
            them; not accepted.
        error_ms: Of the places that are right by time.
        missed: Which were not accepted.
    """

    n: int = 0
    top1: int = 0
    right: int = 0
    accepted: int = 0
    wrong: int = 0
    elsewhere: int = 0
    twins: int = 0
    error_ms: list[float] = field(default_factory=list)
    missed: list[str] = field(default_factory=list)

    def shares(self) -> dict[str, float]:
        """Return n, and the others as shares of it."""
        n = max(self.n, 1)
        counted = ("top1", "right", "accepted", "wrong", "elsewhere", "twins")
        return {"n": self.n, **{name: round(getattr(self, name) / n, 4) for name in counted}}


@dataclass
class FalseAccepts:
    """One class of sound that must be refused.

    Attributes:
        n: Windows.
        accepted: Of them, accepted.
        names: Which those were.
        kin: Of the accepted, taken for a piece of their own composer or sound bank.
        elsewhere: Accepted as a track that holds the identical recording: it is in the catalogue,
            under another name. Not among `accepted`.
        elsewhere_names: Which those were.
    """

    n: int = 0
    accepted: int = 0
    names: list[str] = field(default_factory=list)
    kin: int = 0
    elsewhere: int = 0
    elsewhere_names: list[str] = field(default_factory=list)

    @property
    def upper95(self) -> float:
        """Upper 95 % bound of the rate (Clopper-Pearson, one-sided)."""
        if self.accepted >= self.n:
            return 1.0
        return float(beta.ppf(0.95, self.accepted + 1, self.n - self.accepted))

    def shares(self) -> dict[str, float | list[str]]:
        """Return n, the rate and its bound, and which they were."""
        return {
            "n": self.n,
            "rate": round(self.accepted / max(self.n, 1), 5),
            "upper95": round(self.upper95, 5),
            "taken_for_kin": self.kin,
            "rate_without_kin": round((self.accepted - self.kin) / max(self.n, 1), 5),
            "accepted": self.names[:20],
            "same_recording_elsewhere": self.elsewhere,
            "elsewhere": self.elsewhere_names[:20],
        }

    def add(
        self,
        query: Query,
        result: MatchResult,
        is_same_sound: bool = False,
        is_kin: bool = False,
    ) -> None:
        """Count one query.

        Args:
            query: What was played.
            result: What it was taken for.
            is_same_sound: The track that it was taken for holds it.
            is_kin: That track is of the same composer or sound bank.
        """
        self.n += 1
        if not result.accepted:
            return
        said = (
            f"{query.condition}: {query.track} at {query.start_s:g} s "
            f"taken for {result.track} ({result.confidence:.2f})"
        )
        if is_same_sound:
            self.elsewhere += 1
            self.elsewhere_names.append(said)
        else:
            self.accepted += 1
            self.kin += is_kin
            self.names.append(said)


class Places:
    """Tells right places from wrong ones; a repeat of the identical sound is right."""

    def __init__(self, references: Mapping[str, F32]) -> None:
        """Take the tracks at the matcher's rate, (n,) each."""
        self._references = references

    def judge(self, query: Query, result: MatchResult, score: ConditionScore) -> bool:
        """Count one query of a catalogue track; returns whether track and place are right."""
        score.n += 1
        is_track = result.track == query.track
        score.top1 += is_track
        error_s = result.tau_s - query.start_s
        is_place = is_track and abs(error_s) <= PLACE_S
        if is_place:
            score.error_ms.append(abs(error_s) * 1e3)
        is_repeat = not is_place and self.is_same_sound(query, result)
        score.elsewhere += is_repeat
        score.right += is_place or is_repeat
        score.accepted += (is_place or is_repeat) and result.accepted
        if not (is_place or is_repeat) or not result.accepted:
            score.missed.append(f"{query.track} at {query.start_s:g} s ({result.confidence:.2f})")
        score.wrong += result.accepted and not (is_place or is_repeat)
        named = (result.track, *(track for track, _ in result.twins))
        score.twins += bool(result.twins) and query.track in named
        return is_place or is_repeat

    def is_same_sound(self, query: Query, result: MatchResult) -> bool:
        """Compare the reference at both places: the identical recording?"""
        if result.track not in self._references or query.track not in self._references:
            return False
        lag = round(SAME_SOUND_LAG_S * ft.SAMPLE_RATE_HZ)
        count = round(COMPARED_S * ft.SAMPLE_RATE_HZ)
        played = self._cut(query.track, query.start_s + 0.5, count, 0)
        found = self._cut(result.track, max(result.tau_s, 0.0) + 0.5, count, lag)
        products = np.abs(fftconvolve(found, played[::-1], "valid"))
        power = np.concatenate([[0.0], np.cumsum(found.astype(np.float64) ** 2)])
        energy = np.maximum(power[count:] - power[:-count], 1e-9)
        own = float((played.astype(np.float64) ** 2).sum()) + 1e-9
        return float((products / np.sqrt(energy * own)).max()) >= SAME_SOUND

    def _cut(self, track: str, start_s: float, count: int, pad: int) -> F32:
        reference = self._references[track]
        first = round(start_s * ft.SAMPLE_RATE_HZ) - pad
        part = np.zeros(count + 2 * pad, np.float32)
        low, high = max(first, 0), min(first + len(part), len(reference))
        if high > low:
            part[low - first : high - first] = reference[low:high]
        return part
