"""The robot's own microphone as a source: UDP multicast, 16 kHz mono s16le, 160 ms a datagram.

The datagrams carry neither a number nor a time. What was lost shows only in when the next one
comes: a datagram that is late by whole chunks has lost ones before it; they are a gap, and what
sounds later keeps its time. The kernel stamps arrivals, not our own loop.
"""

from __future__ import annotations

import math
import socket
import struct
import time

import numpy as np

from downbeat.perception.errors import PerceptionError
from downbeat.perception.ring import RATE_HZ, Block
from downbeat.perception.source import SourceCounters
from downbeat.runtime.clock import Clock
from downbeat.runtime.errors import one_of

GROUP, PORT = "239.168.123.161", 5555
SAMPLE_RATE_HZ = RATE_HZ
CHUNK_SAMPLES = 2560
CHUNK_BYTES = 2 * CHUNK_SAMPLES
CHUNK_US = CHUNK_SAMPLES * 1_000_000 // SAMPLE_RATE_HZ
LATE = 0.75
"""In chunks: later than this is a loss, earlier by this is one that was given up already."""
FOLLOW = 0.02
"""Share of an arrival's lateness that moves the time base: the robot's clock is not ours."""
OUTAGE_US = 1_000_000
"""After so long without a datagram the microphone counts as gone, until the next one."""
SO_TIMESTAMPNS = getattr(socket, "SO_TIMESTAMPNS", 35)
RECEIVE_BYTES = 1 << 20


class ChunkTimeline:
    """Puts datagrams on a time line by when they arrive; pure."""

    def __init__(self, latency_us: int) -> None:
        """Begin.

        Args:
            latency_us: From when a chunk's last sample sounds to its arrival.
        """
        self.counters = SourceCounters()
        self.zero_utime: int | None = None
        """When the first sample sounded [us]."""
        self.num_samples = 0
        """Heard or lost so far."""
        self._latency_us = latency_us
        self._shift_us = 0.0

    def add(self, payload: bytes, arrived: int) -> Block | None:
        """Return the sound of a datagram that arrived at `arrived` [us], None if it has none."""
        counters = self.counters
        if len(payload) != CHUNK_BYTES:
            counters.bad += 1
            counters.last_bad = len(payload)
            return None
        sounded = arrived - self._latency_us  # its last sample
        if self.zero_utime is None:
            self.zero_utime = sounded - CHUNK_US
        expected = self._utime_of(self.num_samples) + CHUNK_US
        late = (sounded - expected) / CHUNK_US
        if late < -LATE:
            counters.surplus += 1
            return None
        missing = max(0, round(late)) if late > LATE else 0
        counters.lost_samples += missing * CHUNK_SAMPLES
        self._shift_us += FOLLOW * (late - missing) * CHUNK_US
        counters.good += 1
        self.num_samples += missing * CHUNK_SAMPLES
        first_utime = self._utime_of(self.num_samples)
        self.num_samples += CHUNK_SAMPLES
        samples = np.frombuffer(payload, "<i2").astype(np.float32) / np.float32(32768.0)
        return Block(samples, first_utime, missing == 0)

    def _utime_of(self, number: int) -> int:
        assert self.zero_utime is not None
        return self.zero_utime + round(self._shift_us + number * 1e6 / SAMPLE_RATE_HZ)

    @property
    def heard_utime(self) -> int:
        """When the last sample sounded [us]; 0 before the first."""
        return 0 if self.zero_utime is None else self._utime_of(self.num_samples)


class RobotMicrophone:
    """A `perception.source.Source`: the microphone on the robot's head."""

    sample_rate_hz = SAMPLE_RATE_HZ
    duration_s = math.nan
    is_finished = False

    def __init__(
        self,
        clock: Clock,
        interface: str,
        first_sample_utime: int = 0,
        latency_s: float = 0.0,
        address: tuple[str, int] = (GROUP, PORT),
    ) -> None:
        """Join the group.

        Args:
            clock: The show's.
            interface: Network interface to the robot, e.g. "eth0".
            first_sample_utime: What came before is not heard [us].
            latency_s: From sound to datagram beyond the chunk itself [s]; to be calibrated.
            address: Multicast group and port.

        Raises:
            PerceptionError: No such interface, or the group cannot be joined on it.
        """
        self._clock = clock
        self.first_sample_utime = first_sample_utime
        self.name = f"robot microphone on {interface}"
        self.failure = ""
        self._timeline = ChunkTimeline(round(latency_s * 1e6))
        self._silent_since = first_sample_utime or clock.utime()
        self._read_utime = 0
        self._socket = _join(interface, address)

    @property
    def counters(self) -> SourceCounters:
        """What came."""
        return self._timeline.counters

    @property
    def heard_utime(self) -> int:
        """When the last sample that was read sounded; during an outage: the last read [us]."""
        if self.failure:
            return self._read_utime
        return self._timeline.heard_utime or self._clock.utime()

    def read(self, utime: int) -> list[Block]:
        """Return the chunks that came in since the last read; lost ones are gaps."""
        blocks: list[Block] = []
        self._read_utime = utime
        while True:
            try:
                payload, ancillary, _flags, _sender = self._socket.recvmsg(65536, 64)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:
                break  # an interface that went down: nothing follows
            arrived = self._clock.utime() - _age_us(ancillary)
            if arrived < self.first_sample_utime:
                continue
            block = self._timeline.add(payload, arrived)
            if block is not None:
                blocks.append(block)
        self._judge(utime, bool(blocks))
        return blocks

    def _judge(self, utime: int, came: bool) -> None:
        """Say once that nothing comes any more, and take it back when something does."""
        if came:
            self.failure = ""
            self._silent_since = utime
        elif not self.failure and utime - self._silent_since > OUTAGE_US:
            self.counters.outages += 1
            self.failure = (
                f"No sound has come from the {self.name} for {OUTAGE_US / 1e6:.0f} s; it is heard "
                "again as soon as it sends."
            )

    def close(self) -> None:
        """Leave the group."""
        self._socket.close()


def _age_us(ancillary: list[tuple[int, int, bytes]]) -> int:
    """Return how long ago the kernel took a datagram [us]; 0 if it does not say."""
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS and len(data) >= 16:
            seconds, nanoseconds = struct.unpack("=qq", data[:16])
            return max(0, (time.time_ns() - seconds * 1_000_000_000 - nanoseconds) // 1000)
    return 0


def _join(interface: str, address: tuple[str, int]) -> socket.socket:
    names = [name for _index, name in socket.if_nameindex()]
    if interface not in names:
        raise PerceptionError(
            f"The robot's microphone cannot be heard on {interface!r}: there is no such network "
            f"interface; this machine has {one_of(names)}."
        )
    group, port = address
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM, socket.IPPROTO_UDP)
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BYTES)
        made.bind((group, port))
        request = struct.pack(
            "=4s4si", socket.inet_aton(group), bytes(4), socket.if_nametoindex(interface)
        )
        made.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, request)
        made.setblocking(False)
    except OSError as error:
        made.close()
        raise PerceptionError(
            f"The robot's microphone at {group}:{port} cannot be joined on {interface!r}: "
            f"{error.strerror}. Check that the interface is up and has an address."
        ) from error
    return made
