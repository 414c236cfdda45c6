"""The run's log: an LCM event log with every logged channel, payloads as received."""

from __future__ import annotations

import logging
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import lcm

from downbeat.lcm_types.channels import CHANNELS
from downbeat.runtime.clock import Clock, ReplayClock
from downbeat.runtime.codec import CodecError, codec_for
from downbeat.runtime.endpoint import Endpoint, channel_named
from downbeat.runtime.errors import DownbeatError
from downbeat.runtime.udpm import check_multicast, drain, parse_udpm_url

logger = logging.getLogger("downbeat.log")

LOGGED_CHANNELS: tuple[str, ...] = tuple(c.name for c in CHANNELS.values() if c.logged)
"""What recorder and lockstep write."""


class LogError(DownbeatError):
    """A log that cannot be read or written."""


@dataclass(frozen=True, slots=True)
class LogEvent:
    """One event of a log.

    Attributes:
        utime: When it was received, or published in lockstep [us].
        channel: LCM channel name.
        payload: The bytes.
    """

    utime: int
    channel: str
    payload: bytes


@dataclass(frozen=True, slots=True)
class LogMessage:
    """One valid message of a log.

    Attributes:
        utime: As in LogEvent [us].
        channel: LCM channel name.
        msg: Instance of the channel's class.
    """

    utime: int
    channel: str
    msg: Any


class LogWriter:
    """Writes an LCM event log; `write` is also a tap for `MemqHub.tap`."""

    def __init__(self, path: Path) -> None:
        """Create the file, replacing an older one.

        Raises:
            LogError: It cannot be written.
        """
        try:
            self._log: Any = lcm.EventLog(str(path), "w", overwrite=True)
        except (OSError, ValueError) as error:
            raise LogError(f"Log {path} cannot be written: {error}.") from error
        self.count = 0

    def write(self, utime: int, channel: str, payload: bytes) -> None:
        """Append one event if the channel table says that its channel is logged."""
        row = CHANNELS.get(channel)
        if row is not None and row.logged and self._log is not None:
            self._log.write_event(utime, channel, payload)
            self.count += 1

    def close(self) -> None:
        """Finish the file; later writes are ignored."""
        if self._log is not None:
            self._log.close()
            self._log = None


def read_events(path: Path) -> Iterator[LogEvent]:
    """Read a log in file order; a log that was cut off ends early.

    Raises:
        LogError: There is no such file, or it is no event log.
    """
    if not path.is_file():
        raise LogError(f"There is no log {path}; a run leaves run.lcmlog in its folder.")
    try:
        events = lcm.EventLog(str(path), "r")
    except (OSError, ValueError) as error:
        raise LogError(f"{path} is not an LCM event log: {error}.") from error
    try:
        for event in events:
            yield LogEvent(event.timestamp, event.channel, event.data)
    finally:
        events.close()


def read_messages(path: Path, channels: Collection[str] | None = None) -> Iterator[LogMessage]:
    """Read and decode a log; bad messages are left out, as every receiver did.

    Args:
        path: The log.
        channels: Only these; None: all of the channel table.

    Raises:
        LogError: There is no such file, or it is no event log.
        BusError: A channel is not in the table.
    """
    wanted = frozenset(CHANNELS) if channels is None else frozenset(channels)
    codecs = {name: codec_for(channel_named(name).type) for name in sorted(wanted)}
    for event in read_events(path):
        codec = codecs.get(event.channel)
        if codec is None:
            continue
        try:
            msg = codec.decode(event.payload, event.channel)
        except CodecError:
            continue
        yield LogMessage(event.utime, event.channel, msg)


class RecorderNode:
    """Node "recorder": writes every logged channel of a udpm bus, payloads untouched."""

    name = "recorder"
    period_us = 20_000

    def __init__(self, url: str, clock: Clock, path: Path) -> None:
        """Join the bus and create the log.

        Raises:
            BusError: The URL is wrong, or there is no multicast.
            LogError: The log cannot be written.
        """
        self._clock = clock
        self.writer = LogWriter(path)
        parsed = parse_udpm_url(url)
        check_multicast(parsed)
        self._link: Any = lcm.LCM(parsed.text())
        for channel in LOGGED_CHANNELS:
            self._link.subscribe(channel, self._on_message).set_queue_capacity(0)

    def _on_message(self, channel: str, payload: bytes) -> None:
        self.writer.write(self._clock.utime(), channel, payload)

    def step(self, utime: int) -> None:
        """Write everything that has arrived."""
        drain(self._link)

    def close(self) -> None:
        """Write what is left and finish the file."""
        drain(self._link)
        self._link = None
        self.writer.close()
        logger.info("recorded %d messages", self.writer.count)


class LogBus(Endpoint):
    """A bus that reads a log: `pump` delivers everything up to the clock's time.

    Messages pass the same checks as on the wire. What is published goes nowhere.
    """

    def __init__(self, path: Path, clock: ReplayClock, process: str) -> None:
        super().__init__(clock, process, epoch=1)
        self._replay_clock = clock
        self._events = read_events(path)
        self._next: LogEvent | None = next(self._events, None)

    @property
    def next_utime(self) -> int | None:
        """Time of the next event [us]; None at the end."""
        return None if self._next is None else self._next.utime

    def pump(self, timeout_s: float = 0.0) -> int:
        """Deliver the events up to the clock's time; never waits."""
        count = 0
        now = self._replay_clock.utime()
        while self._next is not None and self._next.utime <= now:
            self._receive(self._next.channel, self._next.payload)
            self._next = next(self._events, None)
            count += 1
        return count

    def _send(self, channel: str, payload: bytes) -> None:
        """Drop it: the log says what was published."""

    def close(self) -> None:
        """Close the file."""
        self._next = None
        self._events = iter(())
