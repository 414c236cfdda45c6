"""The book of requests: what was asked, what became of it, and why."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from downbeat.control.phase import PhaseLine
from downbeat.lcm_types import skill_request_t, skill_status_t
from downbeat.runtime.errors import one_of

MAX_PENDING = 16
"""More pending requests than any show needs; beyond it something is wrong with the asker."""
PHASE_RATE_RANGE = (0.25, 4.0)

Key = tuple[int, int]
"""(source, request_id): publishers number their requests independently."""


@dataclass(frozen=True, slots=True)
class Request:
    """One accepted request.

    Attributes:
        key: (source, request_id).
        skill: Skill name.
        priority: Higher wins.
        onset_utime: Wanted onset [us]; one that has passed means as soon as possible.
        expires_utime: Not to be started after [us], 0: never expires.
        line: Phase line.
        duration_s: Then STAND; 0: for ever, or to the end.
        velocity: vx, vy [m/s], yaw rate [rad/s].
        arrived_tick: Orders requests that want the same onset.
    """

    key: Key
    skill: str
    priority: int
    onset_utime: int
    expires_utime: int
    line: PhaseLine
    duration_s: float
    velocity: tuple[float, float, float]
    arrived_tick: int


@dataclass(frozen=True, slots=True)
class StatusChange:
    """A line of SKILL_STATUS, before it gets its header."""

    key: Key
    skill: str
    state: int
    phase_s: float = math.nan
    planned_start_utime: int = 0
    onset_utime: int = 0
    plan: str = ""
    reason: str = ""


@dataclass(slots=True)
class RequestBook:
    """Pending requests and the one that runs. Pure state; time comes with every call."""

    is_known: Callable[[str], bool]
    skill_names: tuple[str, ...]
    safe_rate: Callable[[str, float], float] = lambda _skill, rate: rate
    pending: list[Request] = field(default_factory=list)
    active: Request | None = None
    changes: list[StatusChange] = field(default_factory=list)

    def say(self, request: Request, state: int, **extra: Any) -> None:
        """Queue a SKILL_STATUS change."""
        self.changes.append(StatusChange(request.key, request.skill, state, **extra))

    def take_changes(self) -> list[StatusChange]:
        """Return and forget the queued changes."""
        changes, self.changes = self.changes, []
        return changes

    def receive(self, msg: skill_request_t, now: int, tick: int) -> None:
        """Handle one SKILL_REQUEST message; every answer is a status, never an exception."""
        if msg.operation == skill_request_t.CANCEL:
            self._cancel(msg)
        elif msg.operation == skill_request_t.RETIME:
            self._retime(msg)
        else:
            self._start(msg, now, tick)

    def refuse(self, msg: skill_request_t, now: int, tick: int, reason: str) -> None:
        """Answer a request that cannot be taken now."""
        self.say(to_request(msg, now, tick), skill_status_t.REFUSED, reason=reason)

    def _start(self, msg: skill_request_t, now: int, tick: int) -> None:
        request = self._limited(to_request(msg, now, tick))
        reason = self._refusal(msg, now)
        if reason:
            self.say(request, skill_status_t.REFUSED, reason=reason)
            return
        if msg.operation == skill_request_t.REPLACE:
            target = (msg.source, msg.target_request_id)
            self._drop(target, skill_status_t.CANCELLED, f"replaced by request {msg.request_id}")
        if request.onset_utime <= now:
            self._preempt_overdue(request, now)
        self.pending.append(request)
        self.pending.sort(key=lambda r: (r.onset_utime, r.arrived_tick))
        planned, note = request.onset_utime, ""
        if request.line.rate != msg.phase_rate:
            note = (
                f"played at {request.line.rate:.2f} of its built tempo instead of "
                f"{msg.phase_rate:.2f}: the nearest that it is certified for"
            )
        self.say(request, skill_status_t.QUEUED, planned_start_utime=planned, reason=note)

    def _limited(self, request: Request) -> Request:
        """Return the request at a tempo that its skill is certified for."""
        rate = self.safe_rate(request.skill, request.line.rate)
        return replace(request, line=replace(request.line, rate=rate))

    def _preempt_overdue(self, newer: Request, now: int) -> None:
        """A new wish for "now" replaces older wishes for now."""
        for old in [r for r in self.pending if r.onset_utime <= now]:
            if old.priority <= newer.priority:
                reason = f"request {newer.key[1]} ({newer.skill}) came later"
                self._drop(old.key, skill_status_t.PREEMPTED, reason)

    def _refusal(self, msg: skill_request_t, now: int) -> str:
        """Return why a START cannot be taken, or an empty string."""
        where = f"request {msg.request_id} of source {msg.source}"
        if not self.is_known(msg.skill):
            known = one_of(self.skill_names)
            return f"Skill '{msg.skill}' is unknown; skills are {known} ({where})."
        if msg.request_id <= 0 or self._find((msg.source, msg.request_id)) is not None:
            return (
                f"Request id {msg.request_id} is not new; ids are > 0 and never reused ({where})."
            )
        if msg.expires_utime and msg.expires_utime < now:
            return f"The request expired {(now - msg.expires_utime) / 1e6:.2f} s ago ({where})."
        low, high = PHASE_RATE_RANGE
        if not low <= msg.phase_rate <= high:
            return f"phase_rate {msg.phase_rate} is outside {low}..{high} ({where})."
        if self.active is not None and msg.priority < self.active.priority:
            return (
                f"Priority {msg.priority} is below {self.active.priority} of the running "
                f"'{self.active.skill}' ({where})."
            )
        if len(self.pending) >= MAX_PENDING:
            return f"{MAX_PENDING} requests are pending already; cancel some ({where})."
        return ""

    def _find(self, key: Key) -> Request | None:
        if self.active is not None and self.active.key == key:
            return self.active
        return next((r for r in self.pending if r.key == key), None)

    def _cancel(self, msg: skill_request_t) -> None:
        self._drop((msg.source, msg.target_request_id), skill_status_t.CANCELLED, msg.cause)

    def _drop(self, key: Key, state: int, reason: str) -> None:
        """Remove a request; a running one ends in stand (see `ControlCore`)."""
        request = self._find(key)
        if request is None:
            return
        self.say(request, state, reason=reason)
        if request is self.active:
            self.active = None
        else:
            self.pending.remove(request)

    def _retime(self, msg: skill_request_t) -> None:
        request = self._find((msg.source, msg.target_request_id))
        low, high = PHASE_RATE_RANGE
        if request is None or not low <= msg.phase_rate <= high or msg.start_utime <= 0:
            return
        line = PhaseLine(msg.start_utime, msg.start_phase_s, msg.phase_rate)
        retimed = self._limited(replace(request, line=line))
        if request is self.active:
            self.active = retimed
        else:
            self.pending[self.pending.index(request)] = retimed

    def expire(self, now: int) -> None:
        """Drop what may no longer be started."""
        for request in [r for r in self.pending if r.expires_utime and r.expires_utime < now]:
            reason = "it could not be started in time"
            self._drop(request.key, skill_status_t.EXPIRED, reason)

    def head(self) -> Request | None:
        """Return the request that is next, None if nothing is pending."""
        return self.pending[0] if self.pending else None

    def activate(self, request: Request) -> None:
        """Make a pending request the running one."""
        if self.active is not None and self.active.key != request.key:
            reason = f"request {request.key[1]} ({request.skill}) took over"
            self.say(self.active, skill_status_t.PREEMPTED, reason=reason)
        self.pending = [r for r in self.pending if r.key != request.key]
        self.active = request

    def abort_all(self, reason: str) -> None:
        """End everything (safety)."""
        for request in [*self.pending, *([self.active] if self.active else [])]:
            self.say(request, skill_status_t.ABORTED, reason=reason)
        self.pending.clear()
        self.active = None


def to_request(msg: skill_request_t, now: int, tick: int) -> Request:
    """Convert the message; values were checked by the codec.

    A start of 0 means now, and then the phase line starts now as well.
    """
    start = int(msg.start_utime) or now
    vx, vy, yaw_rate = (float(v) for v in msg.velocity)
    return Request(
        key=(int(msg.source), int(msg.request_id)),
        skill=msg.skill,
        priority=int(msg.priority),
        onset_utime=start,
        expires_utime=int(msg.expires_utime),
        line=PhaseLine(start, float(msg.start_phase_s), float(msg.phase_rate)),
        duration_s=float(msg.duration_s),
        velocity=(vx, vy, yaw_rate),
        arrived_tick=tick,
    )
