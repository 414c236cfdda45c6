"""The conductor: track position and speech in, skill requests out, ahead of every known boundary.

Speech comes first (`voice_desk`); the music has the body for the rest of the time, and takes it
back on the moment at which it comes free, in phase. Music that the catalogue lacks is danced on the
beat that is heard (`improviser`). At most one skill is asked for per decision.
"""

from __future__ import annotations

from collections.abc import Container, Mapping

from downbeat.lcm_types import (
    audio_class_t,
    music_beat_t,
    music_match_t,
    skill_request_t,
    skill_status_t,
    speech_intent_t,
    speech_t,
)
from downbeat.perception.conductor_config import ConductorConfig
from downbeat.perception.improviser import Improviser
from downbeat.perception.music_requests import MusicRequests
from downbeat.perception.timeline import PhaseFit, Span, Timeline
from downbeat.perception.voice_desk import HOLD_S, VoiceDesk, VoiceSkill

MIN_SPAN_US = 1_500_000
"""A rest of a section shorter than this is not worth a switch of its own."""
MOVED_US = 15_000
SILENCE_US = 3_000_000
HAND_BACK_US = 4_000_000
"""The music asks so long before speech gives the body back."""


class Conductor:
    """Pure logic: `update` returns the messages to send."""

    def __init__(
        self,
        timeline: Timeline,
        skills: Mapping[str, VoiceSkill],
        allowed: Container[str] | None = None,
        hold_s: float = HOLD_S,
        config: ConductorConfig | None = None,
        improviser: Improviser | None = None,
    ) -> None:
        """Begin without any music.

        Args:
            timeline: What the tracks ask for.
            skills: By name.
            allowed: Skills that speech may ask for; None: all.
            hold_s: How long a spoken command without a duration lasts [s].
            config: Gates and habits.
            improviser: Who dances to music that nobody knows; None: nobody.
        """
        self._config = config or ConductorConfig()
        self._improviser = improviser if self._config.unknown == "dance" else None
        self.voice = VoiceDesk(skills, self._new_id, allowed, hold_s)
        self._asks = MusicRequests(skills, self._new_id)
        self._timeline = timeline
        self._skills = skills
        self._next_id = 1
        self._place: tuple[str, int] | None = None
        self._is_lost = True
        self._known_utime = 0
        self._sounding_utime = 0
        self._music_utime = 0
        self._music_since_utime = 0

    # ------------------------------------------------------------------ inputs

    def hear(self, match: music_match_t) -> None:
        """Take a MUSIC_MATCH: only a lock that passes the gates counts."""
        if match.method == music_match_t.EMBEDDING:
            if self._improviser is not None:
                self._improviser.resemble(match)
        elif passes(match, self._config) and match.lock == music_match_t.LOCKED:
            self._place = (match.track, int(match.track_zero_utime))
            self._is_lost = False
            self._known_utime = int(match.header.utime)
            self._timeline.lock(*self._place, int(match.header.utime))
        else:
            # A doubtful lock plans nothing: the old track's next section must not start.
            self._is_lost = True

    def beat(self, msg: music_beat_t) -> None:
        """Take a MUSIC_BEAT."""
        if self._improviser is not None:
            self._improviser.beat(msg)

    def sound(self, label: int, utime: int) -> None:
        """Take an AUDIO_CLASS; somebody who talks over a known track does not end it."""
        if label == audio_class_t.MUSIC:
            if utime - self._music_utime > SILENCE_US:
                self._music_since_utime = utime
                if self._improviser is not None:
                    self._improviser.forget()
            self._music_utime = utime
        if label == audio_class_t.MUSIC or (label == audio_class_t.SPEECH and not self._is_lost):
            self._sounding_utime = utime

    def listen(self, msg: speech_intent_t, now: int) -> list[skill_request_t]:
        """Take a SPEECH_INTENT."""
        current = self._asks.current
        playing = "" if current is None else current.span.skill
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
            self._asks.drop_ahead(out, now, "somebody speaks")
            self._asks.lose_body()
        return out + asked

    def _line(self, skill: str, utime: int) -> PhaseFit:
        """Return a skill's phase line in step with the music, from its start without any."""
        place = self._where(utime)
        if place is not None:
            span = Span(place[0], skill, utime, place[1])
            return self._timeline.phase(span, self._skills[skill], utime)
        heard = None
        if self._improviser is not None:
            heard = self._improviser.follow(skill, PhaseFit(utime, 0.0, 1.0), utime)
        return heard or PhaseFit(utime, 0.0, 1.0)

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
        asks, place = self._asks, self._where(now)
        asks.promote(now)
        if place is None:
            asks.drop_ahead(out, now, "the lock is lost")
            self._improvise(out, now)
            return out
        if asks.current is None and asks.ahead is not None:
            return out  # speech has just given the body back, and what follows is on its way
        here, following = self._timeline.spans(*place, now)
        if not self._ask_here(out, here, following, now):
            self._ask_ahead(out, following, now)
        self._retime(out, now)
        return out

    def _wait(self, out: list[skill_request_t], now: int, free: int | None) -> None:
        """Speech has the body: stay in phase, and ask for it back on the moment it comes free."""
        self._in_step(out, now)
        asks = self._asks
        place = None if free is None or self.voice.is_held else self._where(now)
        if place is None or free is None:
            asks.drop_ahead(out, now, "speech has the robot")
            return
        if free - now > HAND_BACK_US:
            return
        here, following = self._timeline.spans(*place, free)
        if following is not None and following.start_utime - free < MIN_SPAN_US:
            here = following
        at = max(free, here.start_utime)
        if asks.ahead is not None:
            same = here.is_same(asks.ahead.span)
            if same and abs(max(asks.ahead.line.utime, now) - at) < MOVED_US:
                return
            asks.drop_ahead(out, now, "the body comes free at another time")
        line = self._timeline.phase(here, self._skills[here.skill], at)
        asks.plan(out, here, line, now, f"back to {here.track}")

    def _in_step(self, out: list[skill_request_t], now: int) -> None:
        """Keep the dance that speech asked for in phase with the music."""
        claim, place = self.voice.claim, self._where(now)
        if claim is None or place is None or not claim.onset_utime:
            return
        if not self._asks.may_retime(now) or self._skills[claim.skill].bpm <= 0.0:
            return
        claim.line = self._line(claim.skill, now)
        msg = self._asks.retiming(claim.request_id, claim.skill, claim.line, now)
        msg.source = skill_request_t.SOURCE_SPEECH
        out.append(msg)

    def _where(self, now: int) -> tuple[str, int] | None:
        """Return (track, zero) believed in: what the set list says, else the lock."""
        scheduled = self._timeline.scheduled(now)
        if scheduled is not None:
            return scheduled
        return None if self._is_lost else self._place

    def _ask_here(
        self, out: list[skill_request_t], here: Span, following: Span | None, now: int
    ) -> bool:
        """Ask for what should be danced now, unless it is; returns whether it was asked for."""
        asks = self._asks
        if asks.current is not None and here.is_same(asks.current.span):
            return False
        if asks.ahead is not None and here.is_same(asks.ahead.span):
            # The lock moved the boundary by less than is worth a new request: it begins now.
            asks.advance()
            return False
        if following is not None and following.start_utime - now < MIN_SPAN_US:
            return False
        if asks.current is not None and (asks.current.span.skill, asks.current.span.track) == (
            here.skill,
            here.track,
        ):
            asks.moved(here)
            return False
        if asks.is_cooling(here.skill, now, round(self._config.cool_down_s * 1e6)):
            return False
        asks.drop_ahead(out, now, "another track plays")
        line = self._timeline.phase(here, self._skills[here.skill], now)
        asks.begin(out, here, line, now, f"{here.track} plays")
        return True

    def _improvise(self, out: list[skill_request_t], now: int) -> None:
        """Dance to what nobody knows, on its beat."""
        player, asks, config = self._improviser, self._asks, self._config
        unknown_us = now - max(self._known_utime, self._music_since_utime)
        if player is None or not self._music_utime or unknown_us < config.unknown_after_s * 1e6:
            return
        skill = player.skill(now)
        if not skill:
            return
        current = asks.current
        if current is None or current.span.skill != skill:
            line = player.begin(skill, now)
            if line is None or asks.is_cooling(skill, now, round(config.cool_down_s * 1e6)):
                return
            like = f", like {player.resembled}" if player.resembled else ""
            asks.begin(out, Span("", skill, line.utime, 0), line, now, f"unknown music{like}")
        elif now >= current.line.utime and asks.may_retime(now):
            fit = player.follow(skill, current.line, now)
            if fit is not None:
                asks.retime(out, current.span, fit, now)

    def _ask_ahead(self, out: list[skill_request_t], following: Span | None, now: int) -> None:
        asks = self._asks
        look_ahead_us = round(self._config.look_ahead_s * 1e6)
        if following is None or following.start_utime - now > look_ahead_us:
            asks.drop_ahead(out, now, "no boundary is near")
            return
        if asks.ahead is not None:
            same = following.is_same(asks.ahead.span)
            if same and abs(following.start_utime - asks.ahead.span.start_utime) < MOVED_US:
                return
            asks.drop_ahead(out, now, "the boundary moved")
        line = self._timeline.phase(following, self._skills[following.skill], following.start_utime)
        asks.plan(out, following, line, now, f"next section of {following.track}")

    def _retime(self, out: list[skill_request_t], now: int) -> None:
        current, place = self._asks.current, self._where(now)
        if current is None or place is None or not self._asks.may_retime(now):
            return
        skill = self._skills[current.span.skill]
        if skill.bpm <= 0.0 or place[0] != current.span.track:
            return
        moved = place[1] - current.span.track_zero_utime
        start = current.span.start_utime + moved
        span = Span(current.span.track, current.span.skill, start, place[1])
        self._asks.retime(out, span, self._timeline.phase(span, skill, now), now)

    def _end(self, out: list[skill_request_t], now: int, is_ours: bool = True) -> None:
        asks = self._asks
        asks.drop_ahead(out, now, "the music ended")
        if not is_ours:
            asks.current = None
            self._place = None
        elif not asks.is_standing and not self.voice.is_held:
            asks.stand(out, now, "the music ended")
            self._place = None

    def _new_id(self) -> int:
        self._next_id += 1
        return self._next_id - 1


def passes(match: music_match_t, config: ConductorConfig) -> bool:
    """Whether a match passes the acceptance gates."""
    return bool(
        match.rate > 0.0
        and match.confidence >= config.min_confidence
        and match.votes >= config.min_votes
    )
