"""From windows to a lock: which track plays, where it stands, and when it stopped to.

While locked, every hop checks the last second against the place where the track must be: cheap, and
it notices a cut within half a second. Then windows that lie after the change are searched, as soon
as they are long enough. A place that a longer window contradicts twice is corrected (music repeats
itself).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

from downbeat.perception.matcher import MatchResult, MusicMatcher
from downbeat.perception.source import Ring

CHECK_S = 1.0
HOLD_SIMILARITY = 0.30
"""A second of the right place correlates by 0.5 to 0.95, of a wrong one by 0.1."""
HOLD_FRACTION = 0.6
"""Or a fall to this share of what the lock has been used to."""
DROP_AFTER_HOPS = 3
SEARCH_LENGTHS_S = (1.25, 2.0, 3.0, 5.0)
LOOK_BACK_S = 0.2
"""The search window begins this much before the last good check: half of a check may be new."""
COAST_US = 3_000_000
SAME_PLACE_US = 80_000
CORRECTION_GAIN = 0.2
CONFIRM_S = 8.0
"""For this long after a lock, longer windows may still move it to another repeat."""
BETTER_SIMILARITY = 0.03


class Lock(IntEnum):
    """As music_match_t.lock."""

    LOST = 0
    CANDIDATE = 1
    LOCKED = 2


@dataclass(frozen=True, slots=True)
class TrackState:
    """What the tracker believes.

    Attributes:
        lock: LOST, CANDIDATE or LOCKED.
        track: Track name, empty when lost.
        track_zero_utime: When the track was at 0 s [us].
        similarity: Of the last check.
        result: The last search, None if this hop needed none.
    """

    lock: Lock = Lock.LOST
    track: str = ""
    track_zero_utime: int = 0
    similarity: float = 0.0
    result: MatchResult | None = None


class Tracker:
    """The lock's state machine; `update` once per hop."""

    def __init__(self, matcher: MusicMatcher) -> None:
        self._matcher = matcher
        self.state = TrackState()
        self._last_good_utime = 0
        self._bad_hops = 0
        self._usual = 0.0
        self._locked_since_utime = 0
        self._doubt_zero_utime: int | None = None

    def update(self, ring: Ring, now: int, audible: bool) -> TrackState:
        """Judge the newest sound.

        Args:
            ring: Sound heard so far.
            now: Time of its last sample [us].
            audible: False during silence.
        """
        if self.state.lock == Lock.LOST:
            self.state = self._search(ring, now) if audible else TrackState()
        else:
            self.state = self._check(ring, now) if audible else self._coast(now)
        return self.state

    def _coast(self, now: int) -> TrackState:
        """During a pause nothing speaks for or against the lock; it is kept for a while."""
        state = self.state
        if now - self._last_good_utime > COAST_US:
            return TrackState()
        return TrackState(state.lock, state.track, state.track_zero_utime, state.similarity)

    # ------------------------------------------------------------------ locked

    def _check(self, ring: Ring, now: int) -> TrackState:
        state = self.state
        window = ring.last(CHECK_S)
        start = now - round(len(window) / ring.sample_rate_hz * 1e6)
        tau_s = (start - state.track_zero_utime) * 1e-6
        similarity, correction_s = self._matcher.agreement(
            window, ring.sample_rate_hz, state.track, tau_s
        )
        if similarity >= max(HOLD_SIMILARITY, HOLD_FRACTION * self._usual):
            self._bad_hops = 0
            self._last_good_utime = now
            self._usual += 0.2 * (similarity - self._usual)
            zero = state.track_zero_utime - round(CORRECTION_GAIN * correction_s * 1e6)
            held = TrackState(Lock.LOCKED, state.track, zero, similarity)
            return self._confirm(ring, now, held)
        self._bad_hops += 1
        found = self._search_after_change(ring, now)
        if found is not None:
            return found
        if self._bad_hops >= DROP_AFTER_HOPS:
            if similarity < HOLD_SIMILARITY:
                return TrackState(similarity=similarity)
            self._usual = similarity  # quieter or noisier than before, but still this place
        return TrackState(Lock.CANDIDATE, state.track, state.track_zero_utime, similarity)

    def _search_after_change(self, ring: Ring, now: int) -> TrackState | None:
        """Search the sound since the last good check; None while it is too short or unclear."""
        seconds = (now - self._last_good_utime) * 1e-6 + LOOK_BACK_S
        if seconds < SEARCH_LENGTHS_S[0] or ring.seconds < SEARCH_LENGTHS_S[0]:
            return None
        result, zero = self._query(ring, now, min(seconds, SEARCH_LENGTHS_S[-1]))
        if not result.accepted or self._is_here(result, zero):
            return None  # the old place fits the whole window, but its last second did not
        return self._lock_on(result, zero, now)

    def _is_here(self, result: MatchResult, zero: int) -> bool:
        near = abs(zero - self.state.track_zero_utime) < SAME_PLACE_US
        return near and result.track == self.state.track

    def _confirm(self, ring: Ring, now: int, held: TrackState) -> TrackState:
        """Ask a longer window, while the lock is young, whether another repeat fits better."""
        age_s = (now - self._locked_since_utime) * 1e-6
        seconds = min(age_s + SEARCH_LENGTHS_S[0], SEARCH_LENGTHS_S[-1])
        if age_s > CONFIRM_S or ring.seconds < seconds:
            return held
        result, zero = self._query(ring, now, seconds)
        moved = abs(zero - held.track_zero_utime) > SAME_PLACE_US
        if not result.accepted or result.track != held.track or not moved:
            self._doubt_zero_utime = None
            return held
        window = ring.last(seconds)
        tau_s = (now - held.track_zero_utime) * 1e-6 - len(window) / ring.sample_rate_hz
        own, _ = self._matcher.agreement(window, ring.sample_rate_hz, held.track, tau_s)
        if result.similarity < own + BETTER_SIMILARITY:
            self._doubt_zero_utime = None
            return held
        doubt, self._doubt_zero_utime = self._doubt_zero_utime, zero
        if doubt is None or abs(doubt - zero) > SAME_PLACE_US:
            return held
        return self._lock_on(result, zero, now)

    # ------------------------------------------------------------------ lost

    def _search(self, ring: Ring, now: int) -> TrackState:
        # Sound from before the change belongs to another track.
        fresh_s = (now - self._last_good_utime) * 1e-6 + LOOK_BACK_S
        for seconds in SEARCH_LENGTHS_S:
            if min(ring.seconds, fresh_s) < seconds:
                break
            result, zero = self._query(ring, now, seconds)
            if result.accepted:
                return self._lock_on(result, zero, now)
        return TrackState()

    def _query(self, ring: Ring, now: int, seconds: float) -> tuple[MatchResult, int]:
        window = ring.last(seconds)
        result = self._matcher.query(window, ring.sample_rate_hz)
        start = now - round(len(window) / ring.sample_rate_hz * 1e6)
        return result, start - round(result.tau_s / result.rate * 1e6)

    def _lock_on(self, result: MatchResult, zero: int, now: int) -> TrackState:
        if not self._is_here(result, zero):
            self._locked_since_utime = now
        self._last_good_utime = now
        self._bad_hops = 0
        self._usual = result.similarity
        self._doubt_zero_utime = None
        return TrackState(Lock.LOCKED, result.track, zero, result.similarity, result)

    @property
    def age_s(self) -> float:
        """Seconds since the lock was taken, NaN when lost."""
        if self.state.lock == Lock.LOST:
            return math.nan
        return (self._last_good_utime - self._locked_since_utime) * 1e-6
