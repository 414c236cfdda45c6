"""The robot's microphone: chunks on a time line, losses, halves; and over a real socket."""

import socket
import struct
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from downbeat.perception.errors import PerceptionError
from downbeat.perception.ring import Ring
from downbeat.perception.robot_microphone import (
    CHUNK_BYTES,
    CHUNK_SAMPLES,
    CHUNK_US,
    ChunkTimeline,
    RobotMicrophone,
)
from downbeat.runtime.clock import WallClock

START = 1_000_000_000


def chunk(number):
    """A chunk whose samples say which one it is."""
    return np.full(CHUNK_SAMPLES, number + 1, "<i2").tobytes()


def numbers(blocks):
    """Return which chunk each block is, 0 in front of one that does not follow."""
    found = []
    for block in blocks:
        gap = [] if block.follows else [0]
        found += [*gap, *(round(float(v) * 32768) for v in block.samples[::CHUNK_SAMPLES])]
    return found


def feed(timeline, arrivals):
    heard = [timeline.add(chunk(n), at) for n, at in arrivals]
    return numbers(block for block in heard if block is not None)


def test_chunks_without_loss_are_heard_as_they_are():
    timeline = ChunkTimeline(0)
    assert feed(timeline, [(n, START + n * CHUNK_US) for n in range(5)]) == [1, 2, 3, 4, 5]
    assert timeline.zero_utime == START - CHUNK_US
    assert timeline.heard_utime == START + 4 * CHUNK_US


@given(st.sets(st.integers(1, 38)), st.lists(st.integers(0, 40_000), min_size=40, max_size=40))
def test_what_was_lost_is_a_gap_whatever_the_jitter(lost, jitter):
    timeline, ring = ChunkTimeline(0), Ring(1.0)
    sent = [n for n in range(40) if n not in lost]
    run = 0
    for n in sent:
        block = timeline.add(chunk(n), START + n * CHUNK_US + jitter[n])
        run = run + 1 if n - 1 not in lost else 1
        ring.append(block.samples, block.utime, block.follows)
        assert ring.seconds == pytest.approx(min(0.16 * run, 1.0))
        assert abs(ring.last_utime - (START + n * CHUNK_US)) <= 60_000
    assert timeline.counters.lost_samples == CHUNK_SAMPLES * len(lost)
    assert timeline.counters.surplus == 0
    assert ring.num_gaps == sum(n - 1 in lost for n in sent)


def test_a_burst_after_a_stall_neither_gains_nor_loses_time():
    timeline = ChunkTimeline(0)
    arrivals = [(0, START), (1, START + CHUNK_US)]
    stall = START + 4 * CHUNK_US
    arrivals += [(2, stall), (3, stall + 100), (4, stall + 200)]
    arrivals += [(n, START + n * CHUNK_US) for n in range(5, 10)]
    feed(timeline, arrivals)
    assert timeline.num_samples == 10 * CHUNK_SAMPLES
    assert timeline.counters.lost_samples == 2 * CHUNK_SAMPLES
    assert timeline.counters.surplus == 2


@pytest.mark.parametrize("length", [0, 1, CHUNK_BYTES // 2, CHUNK_BYTES - 1, CHUNK_BYTES + 2])
def test_half_a_datagram_is_counted_and_not_heard(length):
    timeline = ChunkTimeline(0)
    timeline.add(chunk(0), START)
    assert timeline.add(bytes(length), START + CHUNK_US) is None
    assert timeline.counters.bad == 1 and timeline.counters.last_bad == length
    assert feed(timeline, [(2, START + 2 * CHUNK_US)]) == [0, 3]


def test_a_clock_that_runs_differently_is_followed():
    timeline = ChunkTimeline(0)
    step = round(CHUNK_US * 1.0002)  # 200 ppm: 72 ms in six minutes, half a chunk
    feed(timeline, [(n % 100, START + n * step) for n in range(4000)])
    assert timeline.counters.lost_samples == timeline.counters.surplus == 0
    assert abs(timeline.heard_utime - (START + 3999 * step)) < 5_000


def test_time_goes_on_through_an_outage():
    timeline = ChunkTimeline(0)
    assert feed(timeline, [(0, START), (1, START + 25 * CHUNK_US)]) == [1, 0, 2]
    assert abs(timeline.heard_utime - (START + 25 * CHUNK_US)) < CHUNK_US // 4


def test_latency_moves_the_stamps_not_the_sound():
    timeline = ChunkTimeline(40_000)
    assert feed(timeline, [(0, START)]) == [1]
    assert timeline.heard_utime == START - 40_000


def test_datagrams_come_over_a_real_group_with_the_time_of_their_arrival():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        address = ("239.168.123.161", probe.getsockname()[1])
    clock = WallClock()
    try:
        microphone = RobotMicrophone(clock, "lo", address=address)
    except PerceptionError as error:
        pytest.skip(str(error))
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    interface = struct.pack("=4s4si", bytes(4), bytes(4), socket.if_nametoindex("lo"))
    sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, interface)
    sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
    time.sleep(0.1)  # the kernel begins to stamp datagrams a moment after it was asked to
    before = clock.utime()
    sender.sendto(chunk(0), address)
    after = clock.utime()
    sender.sendto(chunk(1)[:999], address)
    time.sleep(0.2)  # read late: the stamp is that of the arrival all the same
    assert numbers(microphone.read(clock.utime())) == [1]
    assert microphone.counters.bad == 1 and microphone.counters.last_bad == 999
    assert before - 2_000 <= microphone.heard_utime <= after + 50_000
    assert microphone.sample_rate_hz == 16_000 and not microphone.is_finished
    later = clock.utime() + 1_500_000
    assert not microphone.failure and not microphone.read(later)
    assert "robot microphone on lo" in microphone.failure and microphone.counters.outages == 1
    assert microphone.heard_utime == later
    sender.sendto(chunk(2), address)
    time.sleep(0.05)
    assert microphone.read(later + 50_000) and not microphone.failure
    sender.close()
    microphone.close()


def test_an_unknown_interface_is_refused_with_those_there_are():
    with pytest.raises(PerceptionError, match="this machine has"):
        RobotMicrophone(WallClock(), "nonesuch")
