"""What speech asks of the body: commands, stops and the gesture of an answer, ahead of the music.

Pure logic. The conductor owns SKILL_REQUEST; while the desk holds the body, the music waits, and is
told ahead of time when the body comes free again, so that the dance resumes on that moment.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from downbeat.lcm_types import skill_request_t, skill_status_t, speech_intent_t, speech_t
from downbeat.perception.timeline import PhaseFit, SkillInfo

HOLD_S = 15.0
"""A dance asked for without a duration; then the music's dance goes on, or the robot stands."""
WALK_MPS, BACK_MPS, WALK_M = 0.2, 0.1, 1.0
EXPIRES_US = 8_000_000
HAND_OVER_US = 4_000_000
"""What follows a gesture is asked for so far ahead."""
LEAVES_S = 0.13
"""A gesture is left so long before the sound ends: half of the way into stand."""
REMAINS_S = 3.0
"""Less of an interrupted command than this is not worth going back to."""
TEMPO_STEP = 1.1
_BACK = re.compile(r"\bback(?:wards?)?\b")
_OVER = {
    skill_status_t.DONE,
    skill_status_t.REFUSED,
    skill_status_t.CANCELLED,
    skill_status_t.EXPIRED,
    skill_status_t.PREEMPTED,
    skill_status_t.ABORTED,
}
LineFor = Callable[[str, int], PhaseFit]
"""(skill, utime) -> phase line in step with the music, if there is any."""


class VoiceSkill(SkillInfo, Protocol):
    """What the desk must know of a skill (a SkillManifest has it)."""

    @property
    def loop(self) -> bool:
        """Whether it goes on for ever."""

    @property
    def command(self) -> Any:
        """Limits of its velocity command; None: it takes none."""


@dataclass(slots=True)
class Claim:
    """What holds the body.

    Attributes:
        request_id: Of its START.
        skill: Which.
        duration_s: How long from its onset [s].
        line: Its phase line.
        is_gesture: It accompanies the robot's own speech.
        again: How often it is started again when it is done.
        onset_utime: When it took over, or will [us]; 0: not known yet.
        ends_utime: When the body is free again [us]; 0: not known yet.
        velocity: Of a walk [m/s, m/s, rad/s].
    """

    request_id: int
    skill: str
    duration_s: float
    line: PhaseFit
    is_gesture: bool = False
    again: int = 0
    onset_utime: int = 0
    ends_utime: int = 0
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)


class VoiceDesk:
    """Turns SPEECH_INTENT and SPEECH into requests; follows them by SKILL_STATUS."""

    def __init__(
        self,
        skills: Mapping[str, VoiceSkill],
        next_id: Callable[[], int],
        allowed: Container[str] | None = None,
        hold_s: float = HOLD_S,
    ) -> None:
        """Wire it.

        Args:
            skills: By name.
            next_id: Numbers requests.
            allowed: Skills that speech may ask for; None: all.
            hold_s: How long a dance without a duration lasts [s].
        """
        self._skills = skills
        self._next_id = next_id
        self._allowed = allowed
        self._hold_s = hold_s
        self._last = ""
        self._claim: Claim | None = None
        self._later: Claim | None = None
        self.is_held = False
        """Somebody said stop: the music may not move the robot until something is asked for."""

    @property
    def claim(self) -> Claim | None:
        """What holds the body, None: nothing."""
        return self._claim

    def free_utime(self, now: int) -> int | None:
        """Return when the music may have the body [us]; `now` if it may, None if unknown."""
        if self._claim is None:
            return now
        if self._later is not None or self._claim.again or not self._claim.ends_utime:
            return None
        return max(self._claim.ends_utime, now)

    # ------------------------------------------------------------------ what is heard

    def hear(
        self, msg: speech_intent_t, now: int, line_for: LineFor, playing: str
    ) -> list[skill_request_t]:
        """Take an intent.

        Args:
            msg: SPEECH_INTENT.
            now: [us].
            line_for: Phase lines in step with the music.
            playing: Skill that the music has asked for, empty: none.
        """
        if msg.kind == speech_intent_t.STOP:
            doing = self._claim.skill if self._claim is not None else playing
            if msg.negated and msg.skill and msg.skill != doing:
                return []  # "not the twist", and nobody twists
            return self._stop(now, msg.text)
        if msg.kind == speech_intent_t.RESUME:
            self.is_held = False
            return []
        if msg.kind == speech_intent_t.TEMPO:
            return self._tempo(now, int(msg.tempo))
        skill = self._last if msg.kind == speech_intent_t.AGAIN else msg.skill
        if msg.kind not in (speech_intent_t.AGAIN, speech_intent_t.SKILL):
            return []
        if skill not in self._skills or not (self._allowed is None or skill in self._allowed):
            return []
        self.is_held = False
        self._last = skill
        self._later = None
        self._claim = self._planned(msg, skill, line_for(skill, now))
        return [self._start(self._claim, now, now, f'"{msg.text}"')]

    def speak(self, msg: speech_t, now: int) -> list[skill_request_t]:
        """Take a SPEECH: the gesture runs exactly as long as the sound."""
        claim = self._claim
        if msg.state == speech_t.REQUESTED:
            if self.is_held or not msg.gesture or msg.gesture not in self._skills:
                return []
            if claim is not None and not claim.is_gesture:
                self._later = claim
            line = PhaseFit(now, 0.0, 1.0)
            self._claim = Claim(self._next_id(), msg.gesture, msg.duration_s, line, True)
            return [self._start(self._claim, now, now, "the robot speaks")]
        if claim is None or not claim.is_gesture:
            return []
        if msg.state == speech_t.STARTED:
            claim.ends_utime = int(msg.start_utime) + round(msg.duration_s * 1e6)
            return []
        if claim.ends_utime and claim.ends_utime - now < 200_000:
            return []  # it ends by itself
        return self._give_up(claim, now, "the robot fell silent")

    def follow(self, msg: skill_status_t, now: int) -> list[skill_request_t]:
        """Take a SKILL_STATUS of a request of ours."""
        claim = self._claim
        if claim is None or msg.request_id != claim.request_id:
            return []
        if msg.state in (skill_status_t.BLENDING, skill_status_t.RUNNING):
            claim.onset_utime = int(msg.onset_utime or msg.planned_start_utime)
            if not claim.is_gesture or not claim.ends_utime:
                claim.ends_utime = claim.onset_utime + round(claim.duration_s * 1e6)
        elif msg.state in _OVER:
            return self._over(claim, int(msg.state), now)
        return []

    def update(self, now: int) -> list[skill_request_t]:
        """Ask ahead for the command that a gesture interrupted."""
        claim, later = self._claim, self._later
        if claim is None or later is None or not claim.ends_utime:
            return []
        if claim.ends_utime - now > HAND_OVER_US:
            return []
        left_s = (later.ends_utime - claim.ends_utime) * 1e-6 if later.ends_utime else 0.0
        self._later = None
        if left_s < REMAINS_S:
            return []
        at = claim.ends_utime
        phase_s = later.line.phase_s + later.line.rate * (at - later.line.utime) * 1e-6
        line = PhaseFit(at, max(phase_s, 0.0), later.line.rate)
        self._claim = Claim(self._next_id(), later.skill, left_s, line, velocity=later.velocity)
        return [self._start(self._claim, now, at, "after the answer")]

    # ------------------------------------------------------------------ requests

    def _planned(self, msg: speech_intent_t, skill: str, line: PhaseFit) -> Claim:
        info = self._skills[skill]
        claim = Claim(self._next_id(), skill, float(msg.duration_s), line)
        if info.command is not None:
            back = bool(_BACK.search(msg.text.lower()))
            speed = -BACK_MPS if back else WALK_MPS
            claim.velocity = (speed, 0.0, 0.0)
            claim.duration_s = msg.duration_s or (msg.distance_m or WALK_M) / abs(speed)
        elif info.loop:
            repeats_s = msg.repeat * info.duration_s
            claim.duration_s = msg.duration_s or repeats_s or self._hold_s
        else:
            turns = msg.repeat or math.ceil(msg.duration_s / info.duration_s) or 1
            claim.duration_s = info.duration_s
            claim.again = turns - 1
        return claim

    def _stop(self, now: int, text: str) -> list[skill_request_t]:
        out = []
        if self._claim is not None and not self._claim.onset_utime:
            out.append(self._cancel(self._claim, now, f'"{text}"'))
        self._claim = self._later = None
        self.is_held = True
        still = Claim(self._next_id(), "stand", 0.0, PhaseFit(now, 0.0, 1.0))
        return [*out, self._start(still, now, now, f'"{text}"')]

    def _tempo(self, now: int, direction: int) -> list[skill_request_t]:
        claim = self._claim
        if claim is None or self._skills[claim.skill].bpm <= 0.0 or not claim.onset_utime:
            return []
        phase_s = claim.line.phase_s + claim.line.rate * (now - claim.line.utime) * 1e-6
        claim.line = PhaseFit(now, phase_s, claim.line.rate * TEMPO_STEP**direction)
        msg = request_message(
            now, self._next_id(), skill_request_t.RETIME, claim.skill, "faster or slower"
        )
        msg.source = skill_request_t.SOURCE_SPEECH
        msg.target_request_id = claim.request_id
        msg.start_utime, msg.start_phase_s, msg.phase_rate = now, phase_s, claim.line.rate
        return [msg]

    def _over(self, claim: Claim, state: int, now: int) -> list[skill_request_t]:
        if state == skill_status_t.DONE and claim.again:
            line = PhaseFit(now, 0.0, 1.0)
            self._claim = Claim(
                self._next_id(), claim.skill, claim.duration_s, line, again=claim.again - 1
            )
            return [self._start(self._claim, now, now, "once more")]
        self._claim = self._later = None
        return []

    def _give_up(self, claim: Claim, now: int, why: str) -> list[skill_request_t]:
        self._claim = self._later = None
        return [self._cancel(claim, now, why)]

    def _start(self, claim: Claim, now: int, at: int, why: str) -> skill_request_t:
        msg = request_message(now, claim.request_id, skill_request_t.START, claim.skill, why)
        msg.source = skill_request_t.SOURCE_SPEECH
        msg.start_utime = at
        msg.start_phase_s = claim.line.phase_s
        msg.phase_rate = claim.line.rate
        msg.expires_utime = max(now, at) + EXPIRES_US
        lasts_s = max(claim.duration_s - (LEAVES_S if claim.is_gesture else 0.0), 0.1)
        msg.duration_s = lasts_s if self._skills[claim.skill].loop else 0.0
        msg.velocity = list(claim.velocity)
        return msg

    def _cancel(self, claim: Claim, now: int, why: str) -> skill_request_t:
        msg = request_message(now, self._next_id(), skill_request_t.CANCEL, claim.skill, why)
        msg.source = skill_request_t.SOURCE_SPEECH
        msg.target_request_id = claim.request_id
        return msg


def request_message(now: int, request_id: int, operation: int, skill: str, why: str) -> Any:
    """Return a SKILL_REQUEST of the music's, to be completed."""
    msg: Any = skill_request_t()
    msg.header.utime = now
    msg.request_id = request_id
    msg.operation = operation
    msg.skill = skill
    msg.source = skill_request_t.SOURCE_MUSIC
    msg.phase_rate = 1.0
    msg.cause = why
    return msg
