"""Run all processes of a show in one process, in a fixed order, on simulated time.

The same process objects as in real time, stepped every 2 ms in the order they are given; messages
still pass the codec. Two runs with the same seed are byte-identical.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from downbeat.runtime.clock import SimClock
from downbeat.runtime.node import Node

STEP_US = 2_000
"""The plant's step; every period in a show is a multiple of it."""


class Lockstep:
    """The scheduler: it alone moves the clock."""

    def __init__(self, clock: SimClock, nodes: Sequence[Node]) -> None:
        self.clock = clock
        self.nodes = tuple(nodes)

    def run_until(
        self,
        end_utime: int,
        on_second: Callable[[int], bool] | None = None,
    ) -> int:
        """Step everything until `end_utime` [us].

        Args:
            end_utime: Where to stop.
            on_second: Called once per simulated second with the time; returning False stops.

        Returns:
            The time reached [us].
        """
        utime = self.clock.utime()
        while utime < end_utime:
            utime += STEP_US
            self.clock.advance_to(utime)
            for node in self.nodes:
                if utime % node.period_us == 0:
                    node.step(utime)
            if on_second is not None and utime % 1_000_000 == 0 and not on_second(utime):
                break
        return utime

    def close(self) -> None:
        """Close the nodes in reverse order."""
        for node in reversed(self.nodes):
            node.close()
