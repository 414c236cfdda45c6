"""The conductor: track position and speech in, skill requests out, ahead of every known boundary.

Speech comes first (`voice_desk`); the music has the body for the rest of the time, and takes it
back on the moment at which it comes free, in phase.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass
from typing import Any

from downbeat.lcm_types import (
    audio_class_t,
    music_match_t,
    skill_request_t,
    skill_status_t,
    speech_intent_t,
    speech_t,
)
from downbeat.perception.timeline import PhaseFit, Span, Timeline
from downbeat.perception.voice_desk import HOLD_S, VoiceDesk, VoiceSkill, request_message

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
HAND_BACK_US = 4_000_000
"""The music asks so long before speech gives the body back."""


@dataclass(frozen=True, slots=True)
class Asked:
    """A request that was sent."""

    request_id: int
    span: Span
    line: PhaseFit


class Conductor:
    """Pure logic: `update` returns the messages to send."""

    def __init__(
        self,
        timeline: Timeline,
        skills: Mapping[str, VoiceSkill],
        allowed: Container[str] | None = None,
        hold_s: float = HOLD_S,
    ) -> None:
        """Begin without any music.

        Args:
            timeline: What the tracks ask for.
            skills: By name.
            allowed: Skills that speech may ask for; None: all.
            hold_s: How long a spoken command without a duration lasts [s].
        """
        self.voice = VoiceDesk(skills, self._new_id, allowed, hold_s)
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

    def listen(self, msg: speech_intent_t, now: int) -> list[skill_request_t]:
        """Take a SPEECH_INTENT."""
        playing = "" if self._current is None else self._current.span.skill
        asked = self.voice.hear(msg, now, lambda skill, at: self._line(skill, at), playing)
        return self._voiced(asked, now)

    def speak(self, msg: speech_t, now: int) -> list[skill_request_t]:
        """Take a SPEECH of the robot's own."""
        return self._voiced(self.voice.speak(msg, now), now)

    def follow(self, msg: skill_status_t, now: int) -> list[skill_request_t]:
        """Take a SKILL_STATUS."""
        if msg.source != skill_request_t.SOURCE_SPEECH:
            return []
        return self._voiced(self.voice.follow(msg, now), now)

    def _voiced(self, asked: list[skill_request_t], now: int) -> list[skill_request_t]:
        """What speech starts takes the place of what the music had planned."""
        out: list[skill_request_t] = []
        if any(msg.operation == skill_request_t.START for msg in asked):
            self._drop_ahead(out, now, "somebody speaks")
            self._current = None
            self._is_standing = False
        return out + asked

    def _line(self, skill: str, utime: int) -> PhaseFit:
        """Return a skill's phase line in step with the music, from its start without any."""
        place = self._where(utime)
        if place is None:
            return PhaseFit(utime, 0.0, 1.0)
        return self._timeline.phase(
            Span(place[0], skill, utime, place[1]), self._skills[skill], utime
        )

    # ------------------------------------------------------------------ decisions

    def update(self, now: int, finished: bool = False) -> list[skill_request_t]:
        """Return the requests to publish at `now` [us]."""
        out = self.voice.update(now)
        free = self.voice.free_utime(now)
        silent = now - self._sounding_utime > SILENCE_US
        if finished or (silent and self._sounding_utime > 0):
            self._end(out, now, is_ours=free == now)
            return out
        if self.voice.is_held or free is None or free > now:
            self._wait(out, now, free)
            return out
        place = self._where(now)
        self._promote(now)
        if place is None:
            self._drop_ahead(out, now, "the lock is lost")
            return out
        if self._current is None and self._ahead is not None:
            return out  # speech has just given the body back, and what follows is on its way
        here, following = self._timeline.spans(*place, now)
        self._ask_here(out, here, following, now)
        self._ask_ahead(out, following, now)
        self._retime(out, now)
        return out

    def _wait(self, out: list[skill_request_t], now: int, free: int | None) -> None:
        """Speech has the body: stay in phase, and ask for it back on the moment it comes free."""
        self._in_step(out, now)
        place = None if free is None or self.voice.is_held else self._where(now)
        if place is None or free is None:
            self._drop_ahead(out, now, "speech has the robot")
            return
        if free - now > HAND_BACK_US:
            return
        here, following = self._timeline.spans(*place, free)
        if following is not None and following.start_utime - free < MIN_SPAN_US:
            here = following
        at = max(free, here.start_utime)
        if self._ahead is not None:
            same = here.is_same(self._ahead.span)
            if same and abs(max(self._ahead.line.utime, now) - at) < MOVED_US:
                return
            self._drop_ahead(out, now, "the body comes free at another time")
        line = self._timeline.phase(here, self._skills[here.skill], at)
        self._ahead = self._start(out, here, line, now, f"back to {here.track}")

    def _in_step(self, out: list[skill_request_t], now: int) -> None:
        """Keep the dance that speech asked for in phase with the music."""
        claim, place = self.voice.claim, self._where(now)
        if claim is None or place is None or not claim.onset_utime:
            return
        if now - self._retimed_utime < RETIME_PERIOD_US or self._skills[claim.skill].bpm <= 0.0:
            return
        self._retimed_utime = now
        claim.line = line = self._line(claim.skill, now)
        msg = self._message(now, skill_request_t.RETIME, claim.skill, "phase of the music")
        msg.source = skill_request_t.SOURCE_SPEECH
        msg.target_request_id = claim.request_id
        msg.start_utime, msg.start_phase_s, msg.phase_rate = line.utime, line.phase_s, line.rate
        out.append(msg)

    def _where(self, now: int) -> tuple[str, int] | None:
        """Return (track, zero) believed in: what the set list says, else the lock."""
        scheduled = self._timeline.scheduled(now)
        if scheduled is not None:
            return scheduled
        return None if self._is_lost else self._place

    def _promote(self, now: int) -> None:
        """What was asked ahead is current once its time has come."""
        if self._ahead is not None and now >= self._ahead.line.utime:
            self._current, self._ahead = self._ahead, None
            self._is_standing = False

    def _ask_here(
        self, out: list[skill_request_t], here: Span, following: Span | None, now: int
    ) -> None:
        if self._current is not None and here.is_same(self._current.span):
            return
        if self._ahead is not None and here.is_same(self._ahead.span):
            # The lock moved the boundary by less than is worth a new request: it begins now.
            self._current, self._ahead = self._ahead, None
            self._is_standing = False
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

    def _end(self, out: list[skill_request_t], now: int, is_ours: bool = True) -> None:
        self._drop_ahead(out, now, "the music ended")
        if self._is_standing or not is_ours or self.voice.is_held:
            self._current = None if not is_ours else self._current
            self._place = None if not is_ours else self._place
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
        return request_message(now, self._new_id(), operation, skill, why)

    def _new_id(self) -> int:
        self._next_id += 1
        return self._next_id - 1
