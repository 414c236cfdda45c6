"""When the samples of a sound card sounded, on the show's clock.

A card counts samples by a crystal of its own (up to 200 ppm off), and every block's stamp jitters
by how late the driver was asked. A delay-locked loop of second order follows the first and smooths
the second. Samples that were lost are not smoothed over: the block after them does not follow.
"""

from __future__ import annotations

import math

BANDWIDTH_HZ = 0.1
"""The loop forgets the jitter of single blocks and follows the card's clock within seconds."""
MAX_SKEW = 1e-3
"""A crystal is not farther off; what looks like more is jitter."""
JUMP_US = 30_000
"""A stamp that is farther off than this is no jitter: samples are missing, or time has jumped."""


class CaptureClock:
    """Stamps blocks; pure."""

    def __init__(self, sample_rate_hz: float) -> None:
        """Begin.

        Args:
            sample_rate_hz: What the card calls its rate [Hz].
        """
        self._us = 1e6 / sample_rate_hz
        self._next_us: float | None = None
        self.skew = 0.0
        """The card's sample period over the nominal one, less 1."""
        self.num_lost = 0
        """Samples that are known to be missing, at the card's rate."""

    def place(self, frames: int, captured_utime: int, overflowed: bool) -> tuple[int, bool]:
        """Return when a block's first sample sounded [us], and whether it follows the last block.

        Args:
            frames: Samples in it.
            captured_utime: When its first sample sounded by the driver, with jitter [us].
            overflowed: The driver says that samples were lost before this block.
        """
        duration_us = frames * self._us
        if self._next_us is None:
            return self._anchor(captured_utime, duration_us), False
        error_us = captured_utime - self._next_us
        if overflowed or abs(error_us) > JUMP_US:
            missing = max(round(error_us / self._us), 1 if overflowed else 0)
            self.num_lost += missing
            if error_us > -JUMP_US:  # a little early is jitter; far early, time has jumped back
                captured_utime = max(captured_utime, round(self._next_us + missing * self._us))
            return self._anchor(captured_utime, duration_us), False
        start = round(self._next_us)
        omega = 2.0 * math.pi * BANDWIDTH_HZ * duration_us * 1e-6
        shift_us = math.sqrt(2.0) * omega * error_us
        bound_us = MAX_SKEW * duration_us
        self.skew += omega**2 * error_us / max(duration_us, 1.0)
        self.skew = min(max(self.skew, -MAX_SKEW), MAX_SKEW)
        self._next_us += duration_us * (1.0 + self.skew) + min(max(shift_us, -bound_us), bound_us)
        return start, True

    def _anchor(self, start: float, duration_us: float) -> int:
        self._next_us = start + duration_us * (1.0 + self.skew)
        return round(start)
