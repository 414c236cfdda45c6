"""Who publishes a channel, and which of its messages come next.

A publisher is known by its epoch. On a channel with a rate the one that is heard stays the
publisher: a second one counts as foreign until the first has been silent for as long as the channel
may be stale. On event channels, where silence says nothing, the newest epoch takes over.
"""

from __future__ import annotations

from enum import Enum

from downbeat.lcm_types.channels import Channel

KEPT_EPOCHS = 32
LEAP_S = 0.1
LEAST_LEAP = 10
EVENT_LEAP = 1000
"""A sequence number farther ahead than this is damage, not loss, unless the next message agrees."""


class Verdict(Enum):
    """What a message is."""

    GOOD = "good"
    OLD = "old"
    """A duplicate, or overtaken by a newer one."""
    LEAP = "leap"
    """Its sequence number is implausible."""
    FOREIGN = "foreign"
    """Of another publisher."""


class PublisherGuard:
    """Follows one channel; pure, the time comes with every message."""

    __slots__ = ("_is_open", "_last_seqs", "_leap", "_max_leap", "_patience_us", "epoch", "_heard")

    def __init__(self, channel: Channel) -> None:
        self.epoch = 0
        self._is_open = not channel.publishers
        self._patience_us = round(channel.stale_after_s * 1e6) if channel.rate_hz else -1
        paced = max(LEAST_LEAP, round(LEAP_S * channel.rate_hz))
        self._max_leap = paced if channel.rate_hz else EVENT_LEAP
        self._last_seqs: dict[int, int] = {}
        self._leap: tuple[int, int] = (0, 0)
        self._heard = 0

    def is_next(self, epoch: int, seq: int, utime: int) -> bool:
        """Take the plain case, the next message of the publisher that is heard; False: `judge`."""
        if epoch != self.epoch or self._last_seqs.get(epoch) != seq - 1:
            return False
        self._last_seqs[epoch] = seq
        self._heard = utime
        return True

    def judge(self, epoch: int, seq: int, utime: int) -> tuple[Verdict, int]:
        """Judge a message that arrived at `utime` [us].

        Returns:
            The verdict, and how many messages are missing before it.
        """
        last = self._last_seqs.get(epoch)
        if epoch != self.epoch and not self._is_open and self._is_taken(last, utime):
            return Verdict.FOREIGN, 0
        lost = 0
        if last is not None and seq <= last:
            return Verdict.OLD, 0
        if last is not None and seq > last + 1:
            lost = seq - last - 1
            if lost > self._max_leap:
                (same, expected), self._leap = self._leap, (epoch, seq + 1)
                if same != epoch or not 0 <= seq - expected <= self._max_leap:
                    return Verdict.LEAP, 0
        if last is None and len(self._last_seqs) >= KEPT_EPOCHS:
            self._last_seqs.pop(next(iter(self._last_seqs)))
        self.epoch = epoch
        self._last_seqs[epoch] = seq
        self._heard = utime
        return Verdict.GOOD, lost

    def _is_taken(self, last: int | None, utime: int) -> bool:
        """Whether somebody else publishes this channel."""
        if self._patience_us < 0:
            return last is not None  # an epoch that was replaced by a newer one
        return self._heard > 0 and utime - self._heard <= self._patience_us
