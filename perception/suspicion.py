"""What windows said that were not enough for a lock: two that share no sound and agree are.

One window is the best of all places of all tracks, and of a hundred thousand places some fit by
chance. That a second window, of sound which the first did not hear, finds the same track where it
must be by then, is no chance: of five hours of strangers only one that shares its beginning with
the track was found so.
"""

from __future__ import annotations

from dataclasses import dataclass

from downbeat.perception.match import MatchResult
from downbeat.perception.track_state import Place

LEAST_CONFIDENCE, LEAST_SUM = -1.5, -1.5
"""Of each of the two windows, and of both together."""
MAX_RATE_OFF = 0.02
"""What fits at another speed only moves away from itself, and a drum machine's loop meets another
most often so."""
OVERLAP_US = 300_000
"""A window's ends are faded, so that so much sound in common is none."""
MEMORY_US = 10_000_000


@dataclass(frozen=True, slots=True)
class Suspicion:
    """A place that a window may have found.

    Attributes:
        place: Where the track would be.
        utime: When the window ended [us].
        confidence: Of its result.
    """

    place: Place
    utime: int
    confidence: float


class Suspicions:
    """Those of the last seconds."""

    def __init__(self) -> None:
        self._held: list[Suspicion] = []

    def confirm(self, result: MatchResult, place: Place, now: int, seconds: float) -> bool:
        """Say whether an earlier window agrees with this one; remember it too.

        Args:
            result: Of the window.
            place: That it found.
            now: When the window ended [us].
            seconds: Its length.
        """
        is_one = bool(result.track) and not result.twins
        if not is_one or result.confidence < LEAST_CONFIDENCE:
            return False
        if abs(result.rate - 1.0) > MAX_RATE_OFF:
            return False
        begin = now - round(seconds * 1e6) + OVERLAP_US
        self._held = [s for s in self._held if now - s.utime < MEMORY_US]
        is_confirmed = any(
            s.utime <= begin
            and s.confidence + result.confidence > LEAST_SUM
            and s.place.is_near(place)
            for s in self._held
        )
        self._held.append(Suspicion(place, now, result.confidence))
        return is_confirmed
