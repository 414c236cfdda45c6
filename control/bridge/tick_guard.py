"""Follows LowState.tick: what is missing, doubled, or out of order."""

from __future__ import annotations

from enum import Enum

RESTART_MESSAGES = 50
"""So many in a row that follow each other, but not what was before, are a robot that restarted."""
STEP_WINDOW = 64


class TickVerdict(Enum):
    """What a tick says about its message."""

    GOOD = "good"
    BACKWARDS = "backwards"
    """Not newer than what came before: never passed on."""
    RESTARTED = "restarted"
    """The robot's count began again."""


class TickGuard:
    """Counts gaps in units of the step that the ticks usually make.

    A robot may count milliseconds or messages; a simulator may leave the tick at zero. The usual
    step is the smallest one that was seen lately.
    """

    def __init__(self) -> None:
        self.lost = 0
        self._last: int | None = None
        self._step = 0
        self._smallest = 0
        self._seen = 0
        self._other_last = 0
        self._other_count = 0

    def judge(self, tick: int) -> TickVerdict:
        """Take the next message's tick; `lost` grows by what is missing before it."""
        last = self._last
        if last is None or tick == last == 0:
            self._last = tick
            return TickVerdict.GOOD
        if tick <= last:
            return self._judge_backwards(tick)
        self._other_count = 0
        self._last = tick
        self._learn(tick - last)
        if self._step:
            self.lost += max(0, round((tick - last) / self._step) - 1)
        return TickVerdict.GOOD

    def _judge_backwards(self, tick: int) -> TickVerdict:
        follows = self._other_count > 0 and tick > self._other_last
        self._other_count = self._other_count + 1 if follows else 1
        self._other_last = tick
        if self._other_count < RESTART_MESSAGES:
            return TickVerdict.BACKWARDS
        self._last, self._other_count = tick, 0
        self._step = self._seen = 0
        return TickVerdict.RESTARTED

    def _learn(self, delta: int) -> None:
        self._smallest = delta if self._seen == 0 else min(self._smallest, delta)
        self._seen += 1
        if self._seen == STEP_WINDOW:
            self._step, self._seen = self._smallest, 0
