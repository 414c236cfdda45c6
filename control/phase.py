"""A skill's phase: the line the music asks for, and the slew-limited phase that follows it."""

from __future__ import annotations

import math
from dataclasses import dataclass

TICK_US = 20_000
TICK_S = 0.02


@dataclass(frozen=True, slots=True)
class PhaseLine:
    """phase_s(t) = start_phase_s + rate * (t - start_utime).

    Attributes:
        start_utime: [us].
        start_phase_s: [s] of skill time.
        rate: Skill seconds per real second.
    """

    start_utime: int
    start_phase_s: float
    rate: float

    def at(self, utime: int) -> float:
        """Return the phase [s] asked for at `utime`."""
        return self.start_phase_s + self.rate * (utime - self.start_utime) * 1e-6


def wrap(value: float, period: float) -> float:
    """Return `value` modulo `period`, in [-period/2, period/2)."""
    return (value + 0.5 * period) % period - 0.5 * period


@dataclass(frozen=True, slots=True)
class FollowLimits:
    """How fast a phase may chase its line.

    Attributes:
        trim: Largest deviation of the rate from the line's, as a fraction of it. Skills survive
            90-150 BPM from one file, so 10 % for a moment is far inside.
        gain_per_s: Share of the error taken away per second [1/s].
        rate_slew_per_s: Largest change of the rate per second [1/s]; no step in speed is felt.
    """

    trim: float = 0.10
    gain_per_s: float = 2.0
    rate_slew_per_s: float = 1.0


class PhaseFollower:
    """The phase a skill is played at: on the line when it can be, chasing it otherwise.

    `beat_s` is the period modulo which the error counts: a dance that is one whole beat off is in
    time. Skills without beats (gestures) only follow the rate.
    """

    STATE = ("line", "duration_s", "beat_s", "limits", "loop", "rate", "phase_s")
    """Everything it remembers, for the snapshot."""

    def __init__(
        self,
        line: PhaseLine,
        utime: int,
        duration_s: float,
        beat_s: float | None,
        entry_phase_s: float | None = None,
        limits: FollowLimits | None = None,
        loop: bool = True,
    ) -> None:
        """Start on the line, or at `entry_phase_s`.

        Args:
            line: Phase line to follow.
            utime: Now [us].
            duration_s: Length of the skill [s].
            beat_s: Length of a beat of skill time [s]; None: no beats.
            entry_phase_s: Start here instead of on the line [s].
            limits: How fast the phase may chase the line.
            loop: False: the phase is held at the start and at the end instead of wrapping.
        """
        self.line = line
        self.duration_s = duration_s
        self.beat_s = beat_s
        self.limits = limits or FollowLimits()
        self.loop = loop
        self.rate = line.rate
        self.phase_s = line.at(utime) if entry_phase_s is None else entry_phase_s

    def retime(self, line: PhaseLine) -> None:
        """Follow another line from now on; the phase itself does not jump."""
        self.line = line

    def error_s(self, utime: int) -> float:
        """Return line minus phase [s of skill time], modulo one beat; 0 for gestures."""
        if self.beat_s is None:
            return 0.0
        return wrap(self.line.at(utime) - self.phase_s, self.beat_s)

    def advance(self, utime: int, dt_s: float = TICK_S) -> None:
        """Move the phase from `utime` on by one tick."""
        limit = self.limits
        trim = limit.trim * self.line.rate
        wanted = self.line.rate + min(max(limit.gain_per_s * self.error_s(utime), -trim), trim)
        step = limit.rate_slew_per_s * dt_s
        self.rate += min(max(wanted - self.rate, -step), step)
        self.phase_s += self.rate * dt_s

    @property
    def wrapped_s(self) -> float:
        """The phase inside the loop, [0, duration_s); of a one-shot, held at both ends."""
        if not self.loop:
            return min(max(self.phase_s, 0.0), self.duration_s)
        return self.phase_s % self.duration_s

    def next_crossing_s(self, loop_phase_s: float) -> float:
        """Return the real seconds until the loop phase `loop_phase_s` is reached, >= 0.

        A crossing less than half a tick ago counts as now: ticks do not stand on crossings.
        """
        ahead = (loop_phase_s - self.phase_s) % self.duration_s
        behind = self.duration_s - ahead
        if behind < 0.5 * TICK_S * self.rate:
            return 0.0
        return ahead / max(self.rate, 1e-3)

    def next_beat_utime(self, utime: int) -> int:
        """Return when the line next stands on a beat at or after `utime` [us]."""
        if self.beat_s is None or self.line.rate <= 0.0:
            return utime
        return next_beat_utime(self.line, self.beat_s, utime)


def next_beat_utime(line: PhaseLine, beat_s: float, utime: int) -> int:
    """Return the first time [us] at or after `utime` at which `line` is a whole number of beats."""
    beats = line.at(utime) / beat_s
    remaining = math.ceil(beats - 1e-6) - beats
    return utime + round(max(remaining, 0.0) * beat_s / line.rate * 1e6)
