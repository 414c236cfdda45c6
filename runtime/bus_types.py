"""What every bus speaks: received messages, freshness, counters, the Bus protocol."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

from downbeat.runtime.clock import Clock
from downbeat.runtime.errors import DownbeatError


class BusError(DownbeatError):
    """A channel, publisher or URL that is not in order; raised at set-up and on publish only."""


@dataclass(frozen=True, slots=True)
class Received:
    """One valid message.

    Attributes:
        channel: Channel name.
        msg: Instance of the channel's generated class; arrays are numpy arrays.
        recv_utime: When it was taken from the bus [us].
    """

    channel: str
    msg: Any
    recv_utime: int


@dataclass(frozen=True, slots=True)
class Freshness:
    """How a subscription is doing.

    Attributes:
        alive: A message came within the channel's stale_after_s; event channels: ever.
        rate_ok: At least 90 % of the nominal rate arrived lately; event channels: True.
        age_s: Since the last message [s]; inf before the first.
        count: Valid messages so far.
        lost: Messages missing in the sequence so far.
        rejected: Messages dropped as bad so far.
    """

    alive: bool
    rate_ok: bool
    age_s: float
    count: int
    lost: int
    rejected: int


@dataclass(slots=True)
class BusCounters:
    """What went wrong on one endpoint so far.

    Attributes:
        lost: Gaps in sequence numbers, all channels.
        rejected: Messages dropped as bad, all channels.
        foreign: Messages of a second publisher, all channels; more than 0 is a fault.
        not_sent: Messages that the network did not take.
    """

    lost: int = 0
    rejected: int = 0
    foreign: int = 0
    not_sent: int = 0
    _lost: dict[str, int] = field(default_factory=dict)
    _rejected: dict[str, int] = field(default_factory=dict)
    _foreign: dict[str, int] = field(default_factory=dict)

    def lost_on(self, channel: str) -> int:
        """Return messages missing on one channel."""
        return self._lost.get(channel, 0)

    def rejected_on(self, channel: str) -> int:
        """Return bad messages on one channel."""
        return self._rejected.get(channel, 0)

    def foreign_on(self, channel: str) -> int:
        """Return messages of a second publisher on one channel."""
        return self._foreign.get(channel, 0)

    @property
    def foreign_channels(self) -> tuple[str, ...]:
        """Channels with more than one publisher, sorted."""
        return tuple(sorted(self._foreign))

    def add_lost(self, channel: str, count: int) -> int:
        """Count missing messages; return the channel's new total."""
        self.lost += count
        self._lost[channel] = self._lost.get(channel, 0) + count
        return self._lost[channel]

    def add_rejected(self, channel: str) -> int:
        """Count a bad message; return the channel's new total."""
        self.rejected += 1
        self._rejected[channel] = self._rejected.get(channel, 0) + 1
        return self._rejected[channel]

    def add_foreign(self, channel: str) -> int:
        """Count a second publisher's message; return the channel's new total."""
        self.foreign += 1
        self._foreign[channel] = self._foreign.get(channel, 0) + 1
        return self._foreign[channel]


class Bus(Protocol):
    """One process's endpoint; not for use by several threads."""

    counters: BusCounters
    tap: Callable[[str, bytes], None] | None
    clock: Clock

    def publish(self, channel: str, msg: Any) -> int:
        """Stamp header.seq and header.epoch, check the channel table, encode, send.

        Args:
            channel: Name in the channel table.
            msg: Instance of its type; the caller sets msg.header.utime.

        Returns:
            The sequence number.

        Raises:
            BusError: Unknown channel, or this process is not its publisher.
            CodecError: The message does not encode.
        """
        ...

    def publish_encoded(self, channel: str, payload: bytearray) -> int:
        """Publish a message whose bytes the caller has made, header.utime included.

        Args:
            channel: Name in the channel table.
            payload: The whole message; header.seq and header.epoch are written into it.

        Returns:
            The sequence number.

        Raises:
            BusError: Unknown channel, or this process is not its publisher.
        """
        ...

    def subscribe(self, *channels: str) -> None:
        """Receive channels from now on.

        Raises:
            BusError: Unknown channel.
        """
        ...

    def subscribe_newest(self, *channels: str) -> None:
        """Receive channels of which only the newest message counts; `take` is not for them.

        Sequence numbers and publishers are followed message by message, but only what `latest`
        returns is decoded and judged: of ten states per tick, nine are superseded before anybody
        could read them. A bad newest message is counted, and the one before it is looked at.

        Raises:
            BusError: Unknown channel.
        """
        ...

    def pump(self, timeout_s: float = 0.0) -> int:
        """Take everything that has arrived; wait up to `timeout_s` [s] for the first message.

        Returns:
            Messages taken, bad ones included; they are counted and dropped, never raised.
        """
        ...

    def latest(self, channel: str) -> Received | None:
        """Return the last valid message of a subscribed channel."""
        ...

    def take(self, channel: str) -> list[Received]:
        """Return all valid messages since the last take, in order."""
        ...

    def freshness(self, channel: str, utime: int) -> Freshness:
        """Judge a subscription at `utime` [us]; a change of verdict is logged once."""
        ...

    def close(self) -> None:
        """Leave the bus."""
        ...
