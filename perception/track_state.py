"""What the tracker believes: a lock on a place that moves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

from downbeat.perception.matcher import MatchResult

SAME_PLACE_S = 0.08
POSITION_GAIN, RATE_GAIN = 0.25, 0.015
"""A loop of second order, critically damped: it averages over about eight hops."""
RATE_EVIDENCE = 0.004
"""Below this the speed is taken for nominal: a loop's noise is no change of speed."""
MAX_RATE_OFF = 0.05


class Lock(IntEnum):
    """As music_match_t.lock."""

    LOST = 0
    CANDIDATE = 1
    LOCKED = 2


@dataclass(frozen=True, slots=True)
class Place:
    """A moving place in a track.

    Attributes:
        track: Name.
        tau_s: Position [s] at `utime`.
        utime: [us].
        rate: Track seconds per real second, as estimated.
    """

    track: str
    tau_s: float
    utime: int
    rate: float = 1.0

    @property
    def used_rate(self) -> float:
        """The rate, nominal unless there is evidence against it."""
        return self.rate if abs(self.rate - 1.0) > RATE_EVIDENCE else 1.0

    def at(self, utime: int) -> float:
        """Return the position at a time [s]."""
        return self.tau_s + (utime - self.utime) * 1e-6 * self.used_rate

    def is_near(self, other: Place) -> bool:
        """Whether both are the same place."""
        if self.track != other.track:
            return False
        return abs(self.at(other.utime) - other.tau_s) < SAME_PLACE_S

    def corrected(self, correction_s: float, utime: int, elapsed_s: float) -> Place:
        """Return the place moved by a share of what a check said, at the check's time.

        Over `elapsed_s` since the last check the rate explains a part of it; over 0 s none.
        """
        rate = self.rate
        if elapsed_s > 0.0:
            rate += RATE_GAIN * correction_s / elapsed_s
        rate = min(max(rate, 1.0 - MAX_RATE_OFF), 1.0 + MAX_RATE_OFF)
        return Place(self.track, self.at(utime) + POSITION_GAIN * correction_s, utime, rate)


@dataclass(slots=True)
class Rival:
    """Another repeat of the passage, or another track that shares it.

    Attributes:
        track: Name.
        offset_s: Where it stands, after the place of the lock [s].
        evidence: How much less it fits, summed over hops.
    """

    track: str
    offset_s: float
    evidence: float = 0.0


@dataclass(frozen=True, slots=True)
class TrackState:
    """What the tracker believes.

    Attributes:
        lock: LOST, CANDIDATE or LOCKED.
        place: Where the track is, None when lost.
        similarity: Of the last check.
        result: The last search, None if this hop needed none.
        tau_std_s: Uncertainty of the position, of the same repeat [s]; NaN when lost.
        ambiguous: The track repeats the passage, and nothing heard so far says which repeat plays.
    """

    lock: Lock = Lock.LOST
    place: Place | None = None
    similarity: float = 0.0
    result: MatchResult | None = None
    tau_std_s: float = math.nan
    ambiguous: bool = False

    @property
    def track(self) -> str:
        """Track name, empty when lost."""
        return "" if self.place is None else self.place.track

    @property
    def rate(self) -> float:
        """Track seconds per real second; 1 unless there is evidence."""
        return 1.0 if self.place is None else self.place.used_rate

    @property
    def track_zero_utime(self) -> int:
        """When the track was at 0 s, at `rate` [us]; 0 when lost."""
        if self.place is None:
            return 0
        return self.place.utime - round(self.place.tau_s / self.rate * 1e6)
