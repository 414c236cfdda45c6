"""The kernel drops channels that nobody asked for, and nothing else."""

from __future__ import annotations

import socket
import struct
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from downbeat.lcm_types import estop_t, g1_low_state_t
from downbeat.runtime import channel_filter
from downbeat.runtime.bus import open_udpm
from downbeat.runtime.clock import WallClock

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="socket filters are Linux")

NAMES = ["ESTOP", "G1_LOW_CMD", "A", "AB", "ABC", "ABCD", "SKILL_REQUEST_LONG_NAME"]
OTHERS = ["", "ESTO", "ESTOPS", "estop", "G1_LOW_STATE", "G1_LOW_CM", "B", "AC", "ABCDE", "X" * 63]


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(1.0)
        sender.connect(receiver.getsockname())
        yield receiver, sender


def datagram(channel: str, magic: bytes = b"LC02") -> bytes:
    return magic + struct.pack(">I", 7) + channel.encode() + b"\0" + b"payload"


def received(receiver: socket.socket, sender: socket.socket) -> list[bytes]:
    sender.send(b"LC03last")  # fragments pass: marks the end
    got = []
    while (data := receiver.recv(4096)) != b"LC03last":
        got.append(data)
    return got


def test_exactly_the_named_channels_pass(pair: tuple[socket.socket, socket.socket]) -> None:
    receiver, sender = pair
    assert channel_filter.attach(receiver.fileno(), NAMES)
    for channel in [*NAMES, *OTHERS]:
        sender.send(datagram(channel))
    assert received(receiver, sender) == [datagram(channel) for channel in NAMES]


def test_fragments_and_the_self_test_pass(pair: tuple[socket.socket, socket.socket]) -> None:
    receiver, sender = pair
    assert channel_filter.attach(receiver.fileno(), [])
    wanted = [datagram("G1_LOW_STATE", b"LC03"), datagram("LCM_SELF_TEST")]
    for data in [*wanted, datagram("ESTOP")]:
        sender.send(data)
    assert received(receiver, sender) == wanted


def test_a_later_filter_replaces_the_earlier(pair: tuple[socket.socket, socket.socket]) -> None:
    receiver, sender = pair
    assert channel_filter.attach(receiver.fileno(), ["ESTOP"])
    assert channel_filter.attach(receiver.fileno(), ["G1_LOW_CMD"])
    for channel in ("ESTOP", "G1_LOW_CMD"):
        sender.send(datagram(channel))
    assert received(receiver, sender) == [datagram("G1_LOW_CMD")]


def test_half_a_datagram_harms_nobody(pair: tuple[socket.socket, socket.socket]) -> None:
    receiver, sender = pair
    assert channel_filter.attach(receiver.fileno(), ["ESTOP"])
    for length in range(4, len(datagram("ESTOP")) - 8):
        sender.send(datagram("ESTOP")[:length])
    sender.send(datagram("ESTOP"))
    assert received(receiver, sender) == [datagram("ESTOP")]


def test_a_thing_that_is_no_socket_is_refused_quietly(tmp_path) -> None:  # type: ignore[no-untyped-def]
    with (tmp_path / "file").open("w") as file:
        assert not channel_filter.attach(file.fileno(), ["ESTOP"])
        assert channel_filter.bound_to([file.fileno(), 9999], 7667) is None


def slices() -> int:
    """Times that this process's threads were put on a processor."""
    tasks = Path("/proc/self/task").iterdir()
    return sum(int((task / "schedstat").read_text().split()[2]) for task in tasks)


def test_a_bus_wakes_for_its_channels_only(free_url: str) -> None:
    talker = open_udpm(free_url, WallClock(), "bridge")
    hearer = open_udpm(free_url, WallClock(), "control")
    hearer.subscribe("ESTOP")
    state, stop = g1_low_state_t(), estop_t()
    state.imu_pelvis.quat = state.imu_torso.quat = [1.0, 0.0, 0.0, 0.0]
    before = slices()
    for _ in range(200):
        talker.publish("G1_LOW_STATE", state)
        time.sleep(0.001)  # this thread: a slice each
    assert slices() - before < 200 + 100
    talker.publish("ESTOP", stop)
    end = time.monotonic() + 2.0
    handled = 0
    while not hearer.take("ESTOP") and time.monotonic() < end:
        handled += hearer.pump(0.05)
    assert handled == 1
    hearer.subscribe("G1_LOW_STATE")  # later: the filter grows
    talker.publish("G1_LOW_STATE", state)
    hearer.pump(1.0)
    assert len(hearer.take("G1_LOW_STATE")) == 1
    hearer.close()
    talker.close()
