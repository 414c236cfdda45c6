"""From windows to a lock: which track plays, where it stands, and when it stopped to.

While locked, every hop checks the last second against the place where the track must be: cheap, and
it notices a cut within half a second. Then the sound after the change is searched, hop by hop in a
longer window, until one stands high enough, or two that share no sound agree (suspicion.py). In
noise a weak second is no change where three still fit. While a lock is young, longer windows may
move it to another repeat of the passage. What slips steadily is played at another speed.

A passage that the track repeats note by note has several places. The lock follows one of them and
says that it is ambiguous until what follows differs; who was sure before a repeat stays sure.
"""

from __future__ import annotations

import math
from dataclasses import replace

from downbeat.perception.matcher import MatchResult, MusicMatcher
from downbeat.perception.source import Ring
from downbeat.perception.suspicion import Suspicions
from downbeat.perception.track_state import Lock, Place, Rival, TrackState

__all__ = ["Lock", "Place", "TrackState", "Tracker"]

CHECK_S = 1.0
HOLD_SIMILARITY, SURE_SIMILARITY = 0.24, 0.30
"""A second of the right place correlates by 0.5 to 0.95 (in noise by 0.3), of a wrong one by 0.1;
what was in doubt must be surer."""
NOISY_USUAL, NOISY_SIMILARITY, NOISY_CHECK_S = 0.5, 0.15, 2.0
"""A lock used to less is one in noise: a second may fall short of the floor there, two do not; a
second of something else falls below the second figure."""
DIP_USUAL, DIP_CHECK_S, DIP_SIMILARITY, DIP_SHARE = 0.7, 3.0, 0.13, 0.5
"""A weak second of a lock used to less than the first figure may be a dip: three seconds tell.
Those of a wrong place stay below 0.11 in 99 of 100, and soon after a cut they have fallen below
this share of what the lock has been used to; three seconds that hold nothing from before are not
asked for it: music may fade in its noise."""
DIP_FRESH_S, DIP_FRESH_SIMILARITY = 1.45, 0.1
"""Of what came since the last good second this is asked, as soon as there is so much."""
HOLD_SHARE = 0.6
"""Or a fall to this share of what the lock has been used to."""
REGAIN_SHARE = 0.75
"""After a bad hop more is asked for: half of the check may be new, and alike by chance."""
DROP_AFTER_HOPS = 3
SHORTEST_S, LONGEST_S = 1.0, 5.0
LOST_LENGTHS_S, LONG_LENGTHS_S = (1.25, 2.0), (3.0, 5.0, 8.0)
"""Of the long ones, which cost most, one per hop in turn."""
ALL_FROM_S = 2.4
"""At first the whole of what there is is one of them."""
LOOK_BACK_S = 0.25
"""A search begins this much before the last good check: some of that check may have been new."""
COAST_US, PAUSE_US = 3_000_000, 4_000_000
"""Through sound that is something else, and through silence: a drop-out of three seconds and the
second that the next check needs."""
SETTLING_US = 1_000_000
"""What is corrected in the first second was an error of the place, not of the rate."""
USUAL_GAIN = 0.2
CONFIRM_S = 8.0
"""For this long after a lock, longer windows may still move it to another repeat."""
BETTER_SIMILARITY = 0.03
RIVALS = 6
RIVAL_EVIDENCE = 0.3
"""Difference of similarity, summed over hops, by which one repeat outdoes another."""
LOCK_STD_S = 0.02
"""Of a place just found by one window."""
STD_FLOOR_S, BLUR_S = 0.003, 0.03
"""Noise hides how notes decay, and the place looks late: the floor at similarity 1, and what is
added down to similarity 0."""
SLIP_GAIN, SLIP_SHARE = 0.1, 0.5
"""Checks overlap by three quarters, so the loop averages over less than it seems."""
DRIFT = 0.002
"""Uncertainty of the rate: seconds lost per second without a check."""


def _is_sure(result: MatchResult) -> bool:
    """Say whether a search is enough for a lock, or for a place among twins."""
    return (result.accepted or bool(result.twins)) and not result.doubtful


class Tracker:
    """The lock's state machine; `update` once per hop."""

    def __init__(self, matcher: MusicMatcher) -> None:
        self._matcher = matcher
        self.state = TrackState()
        self._last_good_utime = self._last_held_utime = 0  # by a second; by three as well
        self._bad_hops = 0
        self._usual = 0.0
        self._locked_since_utime = 0
        self._doubt: Place | None = None
        self._now = self._turn = 0
        self._paused_us = 0  # since the last good check
        self._rivals: list[Rival] = []
        self._suspicions = Suspicions()
        self._slip = 0.0  # mean square of the corrections [s^2]

    def update(self, ring: Ring, now: int, audible: bool) -> TrackState:
        """Judge the newest sound.

        Args:
            ring: Sound heard so far.
            now: Time of its last sample [us].
            audible: False during silence.
        """
        place = self.state.place
        if place is None:
            state = self._search(ring, now) if audible else TrackState()
        elif audible:
            state = self._check(ring, now, place)
        elif now - self._last_held_utime > PAUSE_US:
            state = TrackState()
        else:  # a pause speaks neither for nor against the lock
            self._paused_us += now - self._now
            state = replace(self.state, result=None)
        if state.place is not None:
            std_s, ambiguous = self._std_s(now), bool(self._rivals)
            # Which track it is must be known; which repeat of it need not.
            is_known = self._is_one_track(state.track)
            lock = state.lock if is_known else min(state.lock, Lock.CANDIDATE)
            state = replace(state, lock=lock, tau_std_s=std_s, ambiguous=ambiguous)
        self.state, self._now = state, now
        return state

    def _std_s(self, now: int) -> float:
        """Return the uncertainty of the position [s]; it grows while nothing can be checked."""
        drift_s = DRIFT * (now - self._last_held_utime) * 1e-6
        floor_s = STD_FLOOR_S + BLUR_S * (1.0 - self._usual)
        return math.sqrt(SLIP_SHARE * self._slip + floor_s**2) + drift_s

    # ------------------------------------------------------------------ locked

    def _check(self, ring: Ring, now: int, place: Place) -> TrackState:
        similarity, correction_s = self._compare(ring, now, place, CHECK_S)
        floor, share = HOLD_SIMILARITY, HOLD_SHARE
        if self._bad_hops:
            floor, share = SURE_SIMILARITY, REGAIN_SHARE
        is_held = similarity >= max(floor, share * self._usual)
        if not is_held and self._usual < NOISY_USUAL and similarity >= NOISY_SIMILARITY:
            longer, correction_s = self._compare(ring, now, place, NOISY_CHECK_S)
            is_held = longer >= max(floor, share * self._usual)
        if is_held:
            is_young = now - self._locked_since_utime <= SETTLING_US
            elapsed_s = 0.0 if is_young else (now - self._last_held_utime) * 1e-6
            self._bad_hops = self._paused_us = 0
            self._last_good_utime = self._last_held_utime = now
            self._usual += USUAL_GAIN * (similarity - self._usual)
            self._slip += SLIP_GAIN * (correction_s**2 - self._slip)
            held = place.corrected(correction_s, now, elapsed_s)
            held = self._outdone(ring, now, held, similarity)
            return self._confirm(ring, now, TrackState(Lock.LOCKED, held, similarity))
        self._bad_hops += 1
        found = self._search_after_change(ring, now, place)
        if found is not None:
            return found
        dip = self._dip(ring, now, place)
        if dip is not None:  # or another repeat goes on as what is heard
            dip = self._outdone(ring, now, dip, similarity)
            return TrackState(Lock.LOCKED, dip, similarity)
        if self._bad_hops >= DROP_AFTER_HOPS:
            if similarity >= SURE_SIMILARITY:
                self._usual = similarity  # quieter or noisier than before, but still this place
            elif now - self._last_held_utime - self._paused_us > self._coast_us():
                return TrackState(similarity=similarity)
        return TrackState(Lock.CANDIDATE, place, similarity)

    def _dip(self, ring: Ring, now: int, place: Place) -> Place | None:
        """Return the place if a longer check still fits it; the search meanwhile goes on."""
        if self._usual >= DIP_USUAL:
            return None
        fresh_s = min(self._fresh_s(ring, now), DIP_CHECK_S)
        share = DIP_SHARE if fresh_s < DIP_CHECK_S else 0.0
        if fresh_s >= DIP_FRESH_S:
            fresh, _ = self._compare(ring, now, place, fresh_s)
            if fresh < DIP_FRESH_SIMILARITY:
                return None
        longer, correction_s = self._compare(ring, now, place, DIP_CHECK_S)
        if longer < max(DIP_SIMILARITY, share * self._usual):
            return None
        self._last_held_utime = now
        return place.corrected(correction_s, now, 0.0)

    def _outdone(self, ring: Ring, now: int, held: Place, similarity: float) -> Place:
        """Compare the newest sound with the other repeats; return the one that it speaks for."""
        for rival in self._rivals:
            place = replace(held, track=rival.track, tau_s=held.tau_s + rival.offset_s)
            rival.evidence += similarity - self._compare(ring, now, place, CHECK_S)[0]
        self._rivals = [r for r in self._rivals if r.evidence < RIVAL_EVIDENCE]
        best = min(self._rivals, key=lambda r: r.evidence, default=None)
        if best is None or best.evidence > -RIVAL_EVIDENCE:
            return held
        # From now on the others are measured against the new place.
        rest = [
            Rival(r.track, r.offset_s - best.offset_s, r.evidence - best.evidence)
            for r in self._rivals
            if r is not best
        ]
        self._rivals = [r for r in rest if r.evidence < RIVAL_EVIDENCE]
        return replace(held, track=best.track, tau_s=held.tau_s + best.offset_s)

    def _is_one_track(self, track: str) -> bool:
        return all(rival.track == track for rival in self._rivals)

    def _coast_us(self) -> int:
        """Return how long a lock outlives its last good check: somebody talks, applause, a break.

        The search for what else it may be goes on meanwhile. A lock that did not hold for long is
        not believed for long.
        """
        return min(self._last_held_utime - self._locked_since_utime, COAST_US)

    def _compare(self, ring: Ring, now: int, place: Place, seconds: float) -> tuple[float, float]:
        """Return (similarity, correction [s]) of the newest sound against a place."""
        window = ring.last(seconds)
        half_s = 0.5 * len(window) / ring.sample_rate_hz
        start_s = place.at(now - round(half_s * 1e6)) - half_s
        return self._matcher.agreement(window, ring.sample_rate_hz, place.track, start_s)

    def _search_after_change(self, ring: Ring, now: int, place: Place) -> TrackState | None:
        """Search the sound since the last good check; None while it is too short or unclear."""
        seconds = self._fresh_s(ring, now)
        if seconds < SHORTEST_S:
            return None
        seconds = min(seconds, LONGEST_S)
        result, found = self._query(ring, now, seconds)
        if place.is_near(found):
            return None  # the old place may fit the whole window, but not its last second
        if not self._is_enough(result, found, now, seconds):
            return None
        return self._lock_on(result, found, now)

    def _confirm(self, ring: Ring, now: int, held: TrackState) -> TrackState:
        """Ask a longer window, while the lock is young, whether another repeat fits better."""
        age_s = (now - self._locked_since_utime) * 1e-6
        seconds = min(age_s + SHORTEST_S, LONGEST_S)
        if held.place is None or age_s > CONFIRM_S or ring.seconds < seconds:
            return held
        result, found = self._query(ring, now, seconds)
        doubt, self._doubt = self._doubt, None
        if result.accepted and _is_sure(result) and not self._is_one_track(held.track):
            return self._lock_on(result, found, now)  # longer, the window tells twins apart
        if not result.accepted or found.track != held.track or held.place.is_near(found):
            return held
        own, _ = self._compare(ring, now, held.place, seconds)
        if result.similarity < own + BETTER_SIMILARITY:
            return held
        if doubt is not None and doubt.is_near(found):  # twice the same: believe it
            return self._lock_on(result, found, now)
        self._doubt = found
        return held

    # ------------------------------------------------------------------ lost

    def _search(self, ring: Ring, now: int) -> TrackState:
        """Search windows of all lengths that hold nothing from before the change."""
        fresh_s = self._fresh_s(ring, now)
        lengths = [s for s in LOST_LENGTHS_S if s <= fresh_s]
        all_s = [fresh_s] if ALL_FROM_S <= fresh_s < LONGEST_S else []
        if long := [s for s in LONG_LENGTHS_S if s <= fresh_s] + all_s:
            self._turn += 1
            lengths.append(long[self._turn % len(long)])
        if not lengths and fresh_s >= SHORTEST_S:
            lengths = [fresh_s]
        for seconds in lengths:
            result, found = self._query(ring, now, seconds)
            if self._is_enough(result, found, now, seconds):
                return self._lock_on(result, found, now)
        return TrackState()

    def _is_enough(self, result: MatchResult, found: Place, now: int, seconds: float) -> bool:
        """Say whether a search is enough for a lock, by itself or with one before it."""
        is_confirmed = self._suspicions.confirm(result, found, now, seconds)
        return _is_sure(result) or is_confirmed

    def _fresh_s(self, ring: Ring, now: int) -> float:
        """Return how much sound there is that the last lock did not explain [s]."""
        return min(ring.seconds, (now - self._last_good_utime) * 1e-6 + LOOK_BACK_S)

    def _query(self, ring: Ring, now: int, seconds: float) -> tuple[MatchResult, Place]:
        """Search a window; the place is that of its middle, which the rate does not move."""
        window = ring.last(seconds)
        result = self._matcher.query(window, ring.sample_rate_hz)
        half_s = 0.5 * len(window) / ring.sample_rate_hz
        middle_s = result.tau_s + result.rate * half_s
        return result, Place(result.track, middle_s, now - round(half_s * 1e6))

    def _lock_on(self, result: MatchResult, found: Place, now: int) -> TrackState:
        self._locked_since_utime = now
        self._last_good_utime = self._last_held_utime = now
        self._bad_hops = self._paused_us = 0
        self._usual = result.similarity
        self._doubt = None
        self._slip = LOCK_STD_S**2 / SLIP_SHARE
        others = [*result.twins, *((result.track, tau_s) for tau_s in result.repeats)]
        self._rivals = [Rival(name, tau_s - result.tau_s) for name, tau_s in others[:RIVALS]]
        place = replace(found, tau_s=found.at(now), utime=now)
        return TrackState(Lock.LOCKED, place, result.similarity, result)
