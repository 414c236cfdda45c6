"""Keep a rate on absolute deadlines, and count how late they were met.

A relative sleep adds its own lateness to every period: 3 ms per second against the music. Deadlines
here are the multiples of the period on the show's time base, so all processes tick in phase.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from downbeat.runtime.clock import WaitingClock

KEPT_SAMPLES = 1 << 18
"""Samples that percentiles are taken from: the latest 87 minutes at 50 Hz."""


@dataclass(frozen=True, slots=True)
class DurationStats:
    """Percentiles of durations [us]; all 0 before the first sample."""

    count: int = 0
    p50_us: float = 0.0
    p99_us: float = 0.0
    p999_us: float = 0.0
    max_us: float = 0.0

    def as_dict(self) -> dict[str, float]:
        """Return the keys of metrics.json."""
        return {
            "p50": self.p50_us,
            "p99": self.p99_us,
            "p999": self.p999_us,
            "max": self.max_us,
        }


class DurationRecorder:
    """Collects durations without allocating."""

    def __init__(self, capacity: int = KEPT_SAMPLES) -> None:
        self._samples = np.zeros(capacity, np.int32)
        self._count = 0
        self._max = 0
        self.last_us = 0

    def add(self, duration_us: int) -> None:
        """Add one duration [us]."""
        self.last_us = min(duration_us, 2**31 - 1)
        self._samples[self._count % len(self._samples)] = self.last_us
        self._count += 1
        self._max = max(self._max, self.last_us)

    def samples(self) -> npt.NDArray[np.int32]:
        """Return the samples kept, oldest first, (n,) [us]."""
        size = len(self._samples)
        if self._count <= size:
            return self._samples[: self._count].copy()
        return np.roll(self._samples, -(self._count % size))

    def stats(self) -> DurationStats:
        """Return the percentiles of the samples kept and the maximum of all."""
        if self._count == 0:
            return DurationStats()
        kept = self._samples[: min(self._count, len(self._samples))]
        p50, p99, p999 = (float(value) for value in np.percentile(kept, (50.0, 99.0, 99.9)))
        return DurationStats(self._count, p50, p99, p999, float(self._max))


class RateKeeper:
    """Waits for the multiples of a period; knows lateness, compute time and missed deadlines."""

    def __init__(self, clock: WaitingClock, period_us: int, max_catch_up: int = 0) -> None:
        """Keep a rate.

        Args:
            clock: Real-time clock.
            period_us: Period; deadlines are its multiples.
            max_catch_up: Deadlines that may be served late, back to back, before any is given
                up. 0: after an overrun go on with the newest deadline.
        """
        self._clock = clock
        self.period_us = period_us
        self._max_catch_up = max_catch_up
        self._next_utime = 0
        self._started_utime = 0
        self.lateness = DurationRecorder()
        self.compute = DurationRecorder()
        self.missed = 0
        """Deadlines that were given up so far."""

    def wait(self) -> int:
        """Wait for the next deadline and return it [us]; call it once per period."""
        now = self._clock.utime()
        if self._next_utime == 0:
            self._next_utime = (now // self.period_us + 1) * self.period_us
        else:
            self.compute.add(now - self._started_utime)
            self._give_up_past_deadlines(now)
        deadline = self._next_utime
        self._clock.sleep_until(deadline)
        self._started_utime = self._clock.utime()
        self.lateness.add(max(0, self._started_utime - deadline))
        self._next_utime = deadline + self.period_us
        return deadline

    def _give_up_past_deadlines(self, now: int) -> None:
        behind = (now - self._next_utime) // self.period_us
        if behind > self._max_catch_up:
            self.missed += behind
            self._next_utime += behind * self.period_us

    def timing(self) -> tuple[int, int, int]:
        """Return (lateness_us of this tick, compute_us of the previous one, missed so far)."""
        return self.lateness.last_us, self.compute.last_us, self.missed
