"""The robot's own microphone as a source: UDP multicast, 16 kHz mono s16le, 160 ms a datagram.

The datagrams carry neither a number nor a time. What was lost shows only in when the next one
comes: a datagram that is late by whole chunks has lost ones before it, and silence takes their
place, so that what sounds later keeps its time. The kernel stamps arrivals, not our own loop.
"""

from __future__ import annotations

import math
import socket
import struct
import time
from dataclasses import dataclass

import numpy as np

from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32
from downbeat.runtime.clock import Clock
from downbeat.runtime.errors import one_of

GROUP, PORT = "239.168.123.161", 5555
SAMPLE_RATE_HZ = 16_000
CHUNK_SAMPLES = 2560
CHUNK_BYTES = 2 * CHUNK_SAMPLES
CHUNK_US = CHUNK_SAMPLES * 1_000_000 // SAMPLE_RATE_HZ
LATE = 0.75
"""In chunks: later than this is a loss, earlier by this is one that was given up already."""
FOLLOW = 0.02
"""Share of an arrival's lateness that moves the time base: the robot's clock is not ours."""
OUTAGE_US = 1_000_000
"""After so long without a datagram silence is heard, half a second behind."""
OUTAGE_LAG_US = 500_000
SO_TIMESTAMPNS = getattr(socket, "SO_TIMESTAMPNS", 35)
RECEIVE_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class LiveSound:
    """What the listener announces of a source that does not end.

    Attributes:
        name: Of the device.
        duration_s: NaN: nobody knows.
    """

    name: str
    duration_s: float = math.nan


@dataclass(slots=True)
class MicrophoneCounters:
    """What came.

    Attributes:
        good: Datagrams taken.
        bad: Datagrams of another length; never heard.
        lost: Chunks that silence stands for.
        surplus: Datagrams that came after silence had taken their place; dropped.
        last_bad: Length of the last bad one [bytes].
    """

    good: int = 0
    bad: int = 0
    lost: int = 0
    surplus: int = 0
    last_bad: int = -1


class ChunkTimeline:
    """Puts datagrams on a time line by when they arrive; pure."""

    def __init__(self, latency_us: int) -> None:
        """Begin.

        Args:
            latency_us: From when a chunk's last sample sounds to its arrival.
        """
        self.counters = MicrophoneCounters()
        self.zero_utime: int | None = None
        """When sample 0 sounded [us]."""
        self.num_samples = 0
        self._latency_us = latency_us
        self._shift_us = 0.0

    def add(self, payload: bytes, arrived: int) -> F32:
        """Return the samples to append for a datagram that arrived at `arrived` [us]; may be none.

        Lost chunks come as silence in front.
        """
        counters = self.counters
        if len(payload) != CHUNK_BYTES:
            counters.bad += 1
            counters.last_bad = len(payload)
            return np.zeros(0, np.float32)
        sounded = arrived - self._latency_us  # its last sample
        if self.zero_utime is None:
            self.zero_utime = sounded - CHUNK_US
        expected = self.zero_utime + self._shift_us + self._end_us(self.num_samples) + CHUNK_US
        late = (sounded - expected) / CHUNK_US
        if late < -LATE:
            counters.surplus += 1
            return np.zeros(0, np.float32)
        missing = max(0, round(late)) if late > LATE else 0
        counters.lost += missing
        self._shift_us += FOLLOW * (late - missing) * CHUNK_US
        counters.good += 1
        samples = np.frombuffer(payload, "<i2").astype(np.float32) / np.float32(32768.0)
        silence = np.zeros(missing * CHUNK_SAMPLES, np.float32)
        self.num_samples += len(silence) + len(samples)
        return np.concatenate([silence, samples])

    def fill(self, utime: int) -> F32:
        """Return the silence that is due at `utime` [us] when nothing comes any more."""
        if self.zero_utime is None or utime - self.heard_utime < OUTAGE_US:
            return np.zeros(0, np.float32)
        chunks = (utime - OUTAGE_LAG_US - self.heard_utime) // CHUNK_US
        self.counters.lost += chunks
        self.num_samples += chunks * CHUNK_SAMPLES
        return np.zeros(chunks * CHUNK_SAMPLES, np.float32)

    @staticmethod
    def _end_us(samples: int) -> float:
        return samples * 1e6 / SAMPLE_RATE_HZ

    @property
    def heard_utime(self) -> int:
        """When the last sample sounded [us]; 0 before the first."""
        if self.zero_utime is None:
            return 0
        return self.zero_utime + round(self._shift_us + self._end_us(self.num_samples))


class RobotMicrophone:
    """A source for the listener, in the form of `perception.source.FileSource`."""

    sample_rate_hz = SAMPLE_RATE_HZ
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
        self.recording = LiveSound(f"robot microphone on {interface}")
        self._timeline = ChunkTimeline(round(latency_s * 1e6))
        self._socket = _join(interface, address)

    @property
    def counters(self) -> MicrophoneCounters:
        """What came."""
        return self._timeline.counters

    @property
    def heard_utime(self) -> int:
        """When the last sample that was read sounded [us]."""
        return self._timeline.heard_utime or self._clock.utime()

    def read(self, utime: int) -> F32:
        """Return the samples that came in since the last read, silence for lost ones."""
        parts: list[F32] = []
        while True:
            try:
                payload, ancillary, _flags, _sender = self._socket.recvmsg(65536, 64)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:
                break  # an interface that went down: silence follows
            arrived = self._clock.utime() - _age_us(ancillary)
            if arrived >= self.first_sample_utime:
                parts.append(self._timeline.add(payload, arrived))
        parts.append(self._timeline.fill(utime))
        return np.concatenate(parts)

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
