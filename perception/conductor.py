"""The conductor process: track position in, skill requests out, ahead of every known boundary."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from downbeat.lcm_types import audio_class_t, audio_source_t, music_match_t, skill_request_t
from downbeat.perception.timeline import PhaseFit, SkillInfo, Span, Timeline
from downbeat.runtime.bus import Bus

LOOK_AHEAD_US = 10_000_000
"""Footwork may need a whole loop to find its exit; so the next section is asked for early."""
MIN_SPAN_US = 1_500_000
"""A rest of a section shorter than this is not worth a switch of its own."""
MOVED_US = 15_000
RETIME_PERIOD_US = 500_000
RETIME_PHASE_S = 0.005
RETIME_RATE = 0.002
SILENCE_US = 3_000_000
EXPIRES_US = 10_000_000


@dataclass(frozen=True, slots=True)
class Asked:
    """A request that was sent."""

    request_id: int
    span: Span
    line: PhaseFit


class Conductor:
    """Pure logic: `update` returns the messages to send."""

    def __init__(self, timeline: Timeline, skills: Mapping[str, SkillInfo]) -> None:
        self._timeline = timeline
        self._skills = skills
        self._next_id = 1
        self._place: tuple[str, int] | None = None
        self._current: Asked | None = None
        self._ahead: Asked | None = None
        self._is_standing = True
        self._sounding_utime = 0
        self._retimed_utime = 0
        self._is_lost = True

    # ------------------------------------------------------------------ inputs

    def hear(self, match: music_match_t) -> None:
        """Take a MUSIC_MATCH: only a lock counts."""
        if match.lock == music_match_t.LOCKED and match.rate > 0.0:
            self._place = (match.track, int(match.track_zero_utime))
            self._is_lost = False
            self._timeline.lock(*self._place, int(match.header.utime))
        else:
            # A doubtful lock plans nothing: the old track's next section must not start.
            self._is_lost = True

    def sound(self, label: int, utime: int) -> None:
        """Take an AUDIO_CLASS."""
        if label != audio_class_t.SKIP:
            self._sounding_utime = utime

    # ------------------------------------------------------------------ decisions

    def update(self, now: int, finished: bool = False) -> list[skill_request_t]:
        """Return the requests to publish at `now` [us]."""
        out: list[skill_request_t] = []
        silent = now - self._sounding_utime > SILENCE_US
        if finished or (silent and self._sounding_utime > 0):
            self._end(out, now)
            return out
        place = self._where(now)
        self._promote(now)
        if place is None:
            self._drop_ahead(out, now, "the lock is lost")
            return out
        here, following = self._timeline.spans(*place, now)
        self._ask_here(out, here, following, now)
        self._ask_ahead(out, following, now)
        self._retime(out, now)
        return out

    def _where(self, now: int) -> tuple[str, int] | None:
        """Return (track, zero) believed in: what the set list says, else the lock."""
        scheduled = self._timeline.scheduled(now)
        if scheduled is not None:
            return scheduled
        return None if self._is_lost else self._place

    def _promote(self, now: int) -> None:
        """What was asked ahead is current once its time has come."""
        if self._ahead is not None and now >= self._ahead.span.start_utime:
            self._current, self._ahead = self._ahead, None
            self._is_standing = False

    def _ask_here(
        self, out: list[skill_request_t], here: Span, following: Span | None, now: int
    ) -> None:
        if self._current is not None and here.is_same(self._current.span):
            return
        if following is not None and following.start_utime - now < MIN_SPAN_US:
            return
        moved_in_track = (
            self._current is not None
            and self._current.span.skill == here.skill
            and self._current.span.track == here.track
        )
        if moved_in_track and self._current is not None:
            # Same skill of the same track at another place: only the phase line changes.
            self._current = Asked(self._current.request_id, here, self._current.line)
            return
        self._drop_ahead(out, now, "another track plays")
        line = self._timeline.phase(here, self._skills[here.skill], now)
        self._current = self._start(out, here, line, now, f"{here.track} plays")
        self._is_standing = False

    def _ask_ahead(self, out: list[skill_request_t], following: Span | None, now: int) -> None:
        if following is None or following.start_utime - now > LOOK_AHEAD_US:
            self._drop_ahead(out, now, "no boundary is near")
            return
        if self._ahead is not None:
            same = following.is_same(self._ahead.span)
            if same and abs(following.start_utime - self._ahead.span.start_utime) < MOVED_US:
                return
            self._drop_ahead(out, now, "the boundary moved")
        line = self._timeline.phase(following, self._skills[following.skill], following.start_utime)
        self._ahead = self._start(out, following, line, now, f"next section of {following.track}")

    def _retime(self, out: list[skill_request_t], now: int) -> None:
        current = self._current
        if current is None or now - self._retimed_utime < RETIME_PERIOD_US:
            return
        skill = self._skills[current.span.skill]
        place = self._where(now)
        if skill.bpm <= 0.0 or place is None or place[0] != current.span.track:
            return
        moved = place[1] - current.span.track_zero_utime
        span = Span(
            current.span.track,
            current.span.skill,
            current.span.start_utime + moved,
            place[1],
        )
        fit = self._timeline.phase(span, skill, now)
        old = current.line.phase_s + current.line.rate * (now - current.line.utime) * 1e-6
        beat_s = 60.0 / skill.bpm
        error_s = abs((fit.phase_s - old + 0.5 * beat_s) % beat_s - 0.5 * beat_s)
        if error_s < RETIME_PHASE_S and abs(fit.rate - current.line.rate) < RETIME_RATE:
            return
        self._retimed_utime = now
        self._current = Asked(current.request_id, span, fit)
        msg = self._message(now, skill_request_t.RETIME, span.skill, "phase of the music")
        msg.target_request_id = current.request_id
        msg.start_utime, msg.start_phase_s, msg.phase_rate = fit.utime, fit.phase_s, fit.rate
        out.append(msg)

    def _end(self, out: list[skill_request_t], now: int) -> None:
        self._drop_ahead(out, now, "the music ended")
        if self._is_standing:
            return
        msg = self._message(now, skill_request_t.START, "stand", "the music ended")
        msg.start_utime = now
        out.append(msg)
        self._is_standing = True
        self._current = None
        self._place = None

    # ------------------------------------------------------------------ messages

    def _drop_ahead(self, out: list[skill_request_t], now: int, why: str) -> None:
        if self._ahead is None:
            return
        msg = self._message(now, skill_request_t.CANCEL, self._ahead.span.skill, why)
        msg.target_request_id = self._ahead.request_id
        out.append(msg)
        self._ahead = None

    def _start(
        self, out: list[skill_request_t], span: Span, line: PhaseFit, now: int, why: str
    ) -> Asked:
        msg = self._message(now, skill_request_t.START, span.skill, why)
        msg.start_utime = line.utime
        msg.start_phase_s = line.phase_s
        msg.phase_rate = line.rate
        msg.expires_utime = line.utime + EXPIRES_US
        out.append(msg)
        return Asked(msg.request_id, span, line)

    def _message(self, now: int, operation: int, skill: str, why: str) -> Any:
        msg: Any = skill_request_t()
        msg.header.utime = now
        msg.request_id = self._next_id
        msg.operation = operation
        msg.skill = skill
        msg.source = skill_request_t.SOURCE_MUSIC
        msg.phase_rate = 1.0
        msg.cause = why
        self._next_id += 1
        return msg


class ConductorNode:
    """Node "conductor", 20 Hz."""

    name = "conductor"
    period_us = 50_000

    def __init__(self, bus: Bus, conductor: Conductor, known_tracks: frozenset[str]) -> None:
        """Wire the process.

        Args:
            bus: Endpoint of the process "conductor".
            conductor: The logic.
            known_tracks: Tracks that have rules; a lock on any other is ignored.
        """
        self._bus = bus
        self._conductor = conductor
        self._known = known_tracks
        self._finished = False
        bus.subscribe("MUSIC_MATCH", "AUDIO_CLASS", "AUDIO_SOURCE")

    def step(self, utime: int) -> None:
        """Decide at `utime` [us]."""
        self._bus.pump()
        for received in self._bus.take("AUDIO_SOURCE"):
            self._finished = received.msg.state != audio_source_t.STARTED
        for received in self._bus.take("AUDIO_CLASS"):
            self._conductor.sound(received.msg.label, received.msg.header.utime)
        for received in self._bus.take("MUSIC_MATCH"):
            if received.msg.lock != music_match_t.LOCKED or received.msg.track in self._known:
                self._conductor.hear(received.msg)
        for request in self._conductor.update(utime, self._finished):
            self._bus.publish("SKILL_REQUEST", request)

    def close(self) -> None:
        """Nothing to release."""
