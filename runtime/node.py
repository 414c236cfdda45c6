"""Process objects: the same Node runs in its own process on real time, or in lockstep."""

from __future__ import annotations

import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Any, Protocol

from downbeat.lcm_types import heartbeat_t
from downbeat.runtime.bus import Bus
from downbeat.runtime.clock import WaitingClock
from downbeat.runtime.rate import DurationStats, RateKeeper
from downbeat.runtime.usage import own_usage

HEARTBEAT_PERIOD_US = 500_000


class Node(Protocol):
    """One process of a show, without the process.

    Attributes:
        name: Process name, as in the channel table.
        period_us: `step` is called at every utime that is a multiple of it.
    """

    name: str
    period_us: int

    def step(self, utime: int) -> None:
        """Pump the own bus endpoint, then do what is due at `utime` [us]; must not block."""
        ...

    def close(self) -> None:
        """Release what the node holds."""
        ...


@dataclass(frozen=True, slots=True)
class LoopReport:
    """How a real-time loop went.

    Attributes:
        steps: Steps done.
        missed: Deadlines given up.
        lateness: Wake-up after the deadline.
        compute: Duration of a step.
    """

    steps: int
    missed: int
    lateness: DurationStats
    compute: DurationStats


class Heartbeat:
    """Publishes HEARTBEAT twice a second and on every change of state.

    The detail ends with the process's usage so far (`downbeat.runtime.usage`).
    """

    def __init__(self, bus: Bus, process: str, period_us: int) -> None:
        self._bus = bus
        self._process = process
        self._period_us = period_us
        self._host = socket.gethostname()
        self._next_utime = 0
        self._state = -1
        self._missed = 0

    def beat(self, utime: int, missed: int = 0, node: Node | None = None) -> None:
        """Publish if due; DEGRADED while deadlines were missed since the last one.

        A node may have a `detail: str`, which then goes with it.
        """
        if utime >= self._next_utime:
            is_degraded = missed > self._missed
            detail = str(getattr(node, "detail", ""))
            if is_degraded:
                detail = f"{missed - self._missed} deadlines missed {detail}".rstrip()
            self._missed = missed
            state = heartbeat_t.DEGRADED if is_degraded else heartbeat_t.READY
            self.publish(utime, state, detail)

    def publish(self, utime: int, state: int, detail: str = "") -> None:
        """Publish now."""
        msg: Any = heartbeat_t()
        msg.header.utime = utime
        msg.process = self._process
        msg.host = self._host
        msg.pid = os.getpid()
        msg.period_us = self._period_us
        msg.state = state
        msg.detail = f"{detail} {own_usage().text()}".lstrip()
        self._bus.publish("HEARTBEAT", msg)
        self._next_utime = (utime // HEARTBEAT_PERIOD_US + 1) * HEARTBEAT_PERIOD_US


def run_node(
    node: Node,
    clock: WaitingClock,
    bus: Bus | None = None,
    *,
    rate: RateKeeper | None = None,
    end_utime: int | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> LoopReport:
    """Step a node on absolute deadlines until it is told to stop (SIGTERM, SIGINT).

    Args:
        node: The node; closed on the way out.
        clock: Real-time clock on the show's base.
        bus: The node's endpoint, for the heartbeat; None: no heartbeat.
        rate: Given when the node itself wants the loop's timing (`rate.timing`).
        end_utime: Stop at this time [us].
        should_stop: Asked after every step.
    """
    keeper = rate or RateKeeper(clock, node.period_us)
    heartbeat = None if bus is None else Heartbeat(bus, node.name, node.period_us)
    steps = 0
    if heartbeat is not None:
        heartbeat.publish(clock.utime(), heartbeat_t.STARTING)
    with stop_signals() as is_signalled:
        try:
            while not is_signalled():
                utime = keeper.wait()
                if end_utime is not None and utime > end_utime:
                    break
                node.step(utime)
                steps += 1
                if heartbeat is not None:
                    heartbeat.beat(utime, keeper.missed, node)
                if should_stop is not None and should_stop():
                    break
        finally:
            if heartbeat is not None:
                heartbeat.publish(clock.utime(), heartbeat_t.STOPPING)
            node.close()
    return LoopReport(steps, keeper.missed, keeper.lateness.stats(), keeper.compute.stats())


@contextmanager
def stop_signals() -> Iterator[Callable[[], bool]]:
    """Turn SIGTERM and SIGINT into a flag, so that a step is never cut in the middle."""
    received: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        # Only the main thread may set handlers; a node in a thread is stopped by `should_stop`.
        yield lambda: False
        return

    def note(number: int, _frame: FrameType | None) -> None:
        received.append(number)

    before = {number: signal.signal(number, note) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield lambda: bool(received)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
