"""Clocks: the only door through which time comes in.

`utime` is an int64 count of microseconds on the show's time base, the same for every process.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Protocol

from downbeat.runtime.errors import DownbeatError

SIM_EPOCH_UTIME = 1_700_000_000_000_000
"""Where simulated time starts [us]; a multiple of every period."""


class ClockError(DownbeatError):
    """Time was asked to run backwards."""


class Clock(Protocol):
    """What everything that needs time is given."""

    def utime(self) -> int:
        """Return now [us]."""
        ...


class WaitingClock(Clock, Protocol):
    """A clock that can be waited for; real time only."""

    def sleep_until(self, utime: int) -> None:
        """Return at `utime` [us] or, if that is past, at once."""
        ...


@dataclass(frozen=True, slots=True)
class TimeBase:
    """The show's time base, fixed once by the supervisor and handed to every process.

    Attributes:
        epoch_utime: Wall clock at the epoch [us since 1970].
        epoch_monotonic_ns: CLOCK_MONOTONIC at the same moment [ns].
    """

    epoch_utime: int
    epoch_monotonic_ns: int

    @staticmethod
    def now() -> TimeBase:
        """Fix a base at this moment."""
        return TimeBase(time.time_ns() // 1000, time.monotonic_ns())


class WallClock:
    """Real time: the base's wall clock plus monotonic elapsed time; it never steps."""

    def __init__(self, base: TimeBase | None = None) -> None:
        """Use the supervisor's base; without one, fix a new one now."""
        self.base = base or TimeBase.now()
        self._origin_us = self.base.epoch_utime - self.base.epoch_monotonic_ns // 1000

    def utime(self) -> int:
        """Return now [us]."""
        return self._origin_us + time.monotonic_ns() // 1000

    def sleep_until(self, utime: int) -> None:
        """Sleep to an absolute deadline [us]; returns at once if it is past."""
        remaining_ns = (utime - self._origin_us) * 1000 - time.monotonic_ns()
        if remaining_ns > 0:
            # CPython sleeps with clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME) inside.
            time.sleep(remaining_ns * 1e-9)


class SimClock:
    """Simulated time: only the lockstep scheduler moves it."""

    def __init__(self, utime: int = SIM_EPOCH_UTIME) -> None:
        self._utime = utime

    def utime(self) -> int:
        """Return now [us]."""
        return self._utime

    def advance_to(self, utime: int) -> None:
        """Move to `utime` [us].

        Raises:
            ClockError: That is in the past.
        """
        if utime < self._utime:
            raise ClockError(
                f"Simulated time cannot go back to {utime} us, it is {self._utime} us already."
            )
        self._utime = utime


class ReplayClock:
    """Time of a log: as late as the latest event that was read."""

    def __init__(self, utime: int = 0) -> None:
        self._utime = utime

    def utime(self) -> int:
        """Return now [us]."""
        return self._utime

    def follow(self, utime: int) -> None:
        """Take the time of an event [us]; an event out of order does not turn time back."""
        self._utime = max(self._utime, utime)
