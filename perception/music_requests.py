"""What the music has asked of the body, and the messages that ask for it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from downbeat.lcm_types import skill_request_t
from downbeat.perception.timeline import PhaseFit, SkillInfo, Span
from downbeat.perception.voice_desk import request_message

RETIME_PERIOD_US = 500_000
RETIME_PHASE_S = 0.005
RETIME_RATE = 0.002
EXPIRES_US = 10_000_000

Out = list[skill_request_t]


@dataclass(frozen=True, slots=True)
class Asked:
    """A request that was sent."""

    request_id: int
    span: Span
    line: PhaseFit


class MusicRequests:
    """The running request, the one that waits for its boundary, and when each skill began.

    Every method appends what must be published to `out`.
    """

    def __init__(self, skills: Mapping[str, SkillInfo], next_id: Callable[[], int]) -> None:
        """Begin in stand.

        Args:
            skills: By name.
            next_id: Numbers requests.
        """
        self._skills = skills
        self._next_id = next_id
        self.current: Asked | None = None
        self.ahead: Asked | None = None
        self.is_standing = True
        self._retimed_utime = 0
        self._started_utime: dict[str, int] = {}

    def begin(self, out: Out, span: Span, line: PhaseFit, now: int, why: str) -> None:
        """Ask for a skill now."""
        self.current = self._start(out, span, line, now, why)
        self.is_standing = False

    def plan(self, out: Out, span: Span, line: PhaseFit, now: int, why: str) -> None:
        """Ask for what begins at a boundary."""
        self.ahead = self._start(out, span, line, now, why)

    def promote(self, now: int) -> None:
        """What was asked ahead is current once its time has come."""
        if self.ahead is not None and now >= self.ahead.line.utime:
            self.advance()

    def advance(self) -> None:
        """What was asked ahead begins."""
        self.current, self.ahead = self.ahead, None
        self.is_standing = False

    def lose_body(self) -> None:
        """Somebody else moves the body now."""
        self.current = None
        self.is_standing = False

    def moved(self, span: Span) -> None:
        """The current skill goes on in another passage: only its phase line will change."""
        if self.current is not None:
            self.current = Asked(self.current.request_id, span, self.current.line)

    def drop_ahead(self, out: Out, now: int, why: str) -> None:
        """Take back what waits for its boundary."""
        if self.ahead is None:
            return
        msg = self._message(now, skill_request_t.CANCEL, self.ahead.span.skill, why)
        msg.target_request_id = self.ahead.request_id
        out.append(msg)
        self.ahead = None

    def stand(self, out: Out, now: int, why: str) -> None:
        """Ask for stand."""
        msg = self._message(now, skill_request_t.START, "stand", why)
        msg.start_utime = now
        out.append(msg)
        self.is_standing = True
        self.current = None

    def is_cooling(self, skill: str, now: int, cool_down_us: int) -> bool:
        """Whether a skill began so lately that it may not begin again: a match that wavers."""
        before = self._started_utime.get(skill)
        return self.current is not None and before is not None and 0 <= now - before < cool_down_us

    # ------------------------------------------------------------------ phase

    def may_retime(self, now: int) -> bool:
        """Whether a new phase line may be sent: twice a second at most."""
        return now - self._retimed_utime >= RETIME_PERIOD_US

    def retime(self, out: Out, span: Span, fit: PhaseFit, now: int) -> None:
        """Send a new phase line for the current skill, if it differs."""
        current = self.current
        if current is None:
            return
        old = current.line.phase_s + current.line.rate * (now - current.line.utime) * 1e-6
        beat_s = 60.0 / self._skills[span.skill].bpm
        error_s = abs((fit.phase_s - old + 0.5 * beat_s) % beat_s - 0.5 * beat_s)
        if error_s < RETIME_PHASE_S and abs(fit.rate - current.line.rate) < RETIME_RATE:
            return
        self.current = Asked(current.request_id, span, fit)
        out.append(self.retiming(current.request_id, span.skill, fit, now))

    def retiming(self, request_id: int, skill: str, fit: PhaseFit, now: int) -> Any:
        """Return the message that gives a request another phase line."""
        self._retimed_utime = now
        msg = self._message(now, skill_request_t.RETIME, skill, "phase of the music")
        msg.target_request_id = request_id
        msg.start_utime, msg.start_phase_s, msg.phase_rate = fit.utime, fit.phase_s, fit.rate
        return msg

    # ------------------------------------------------------------------ messages

    def _start(self, out: Out, span: Span, line: PhaseFit, now: int, why: str) -> Asked:
        msg = self._message(now, skill_request_t.START, span.skill, why)
        msg.start_utime = line.utime
        msg.start_phase_s = line.phase_s
        msg.phase_rate = line.rate
        msg.expires_utime = line.utime + EXPIRES_US
        out.append(msg)
        self._started_utime[span.skill] = line.utime
        return Asked(msg.request_id, span, line)

    def _message(self, now: int, operation: int, skill: str, why: str) -> Any:
        return request_message(now, self._next_id(), operation, skill, why)
