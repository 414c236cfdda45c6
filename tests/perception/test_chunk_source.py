"""Sound over LCM: lost, repeated and reordered chunks, other clocks; and over real groups."""

import socket
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_music import RATE, make_music

from downbeat.lcm_types import audio_chunk_t, audio_source_t, music_match_t
from downbeat.perception.chunk_source import ChunkReader, ChunkSource
from downbeat.perception.listener import ListenerNode
from downbeat.perception.ring import Block, Ring
from downbeat.perception.sound_share import MAX_SAMPLES, SoundShare
from downbeat.perception.source import FileSource, Recording
from downbeat.perception.source_node import SourceNode
from downbeat.runtime.bus import MulticastError, open_udpm
from downbeat.runtime.clock import SimClock, WallClock
from downbeat.runtime.memq import MemqHub

COUNT = 800
CHUNK_US = 50_000
START = 1_700_000_000_000_000


def chunk(number, rate=16_000, epoch=1, start=START, count=COUNT):
    """Chunk `number` of a ramp of samples that says which ones they are."""
    msg = audio_chunk_t()
    msg.header.epoch = epoch
    msg.first_sample = number * count
    msg.first_sample_utime = start + number * count * 1_000_000 // rate
    msg.sample_rate_hz, msg.num_samples = rate, count
    msg.samples = ((number * count + np.arange(count)) % 30_000).astype(np.int16)
    return msg


def arrived(number):
    return START + (number + 1) * CHUNK_US + 20_000


def play(numbers, reader=None, late_us=0):
    reader, ring = reader or ChunkReader(), Ring(6.0)
    for number in numbers:
        for block in reader.add(chunk(number), arrived(number) + late_us):
            ring.append(block.samples, block.utime, block.follows)
    return reader, ring


def values(ring):
    return (ring.last(6.0) * 32768).round().astype(int)


@given(st.lists(st.integers(0, 12), min_size=1, max_size=30))
def test_lost_repeated_and_reordered_chunks_never_glue_what_does_not_belong_together(numbers):
    reader, ring = play(numbers)
    last, run, lost = -1, 0, 0
    for number in numbers:
        if number <= last:
            continue  # heard already, or overtaken
        lost += COUNT * (number - last - 1) if last >= 0 else 0
        run = run + 1 if number == last + 1 and last >= 0 else 1
        last = number
    end = (last + 1) * COUNT
    assert values(ring).tolist() == list(range(end - run * COUNT, end))
    assert reader.counters.lost_samples == lost
    assert reader.counters.surplus == len(numbers) - reader.counters.good
    assert ring.last_utime == reader.heard_utime == START + (last + 1) * CHUNK_US


def test_a_chunk_that_overlaps_is_taken_from_where_it_is_new():
    reader, ring = play([0])
    half = chunk(0)
    half.first_sample, half.first_sample_utime = 400, START + 25_000
    half.samples = half.samples + np.int16(400)
    for block in reader.add(half, arrived(0) + 25_000):
        ring.append(block.samples, block.utime, block.follows)
    assert values(ring).tolist() == list(range(1_200)) and ring.num_gaps == 0


def test_a_sender_that_starts_anew_is_a_gap():
    reader, ring = play([5, 6])
    for block in reader.add(chunk(0, epoch=2, start=START + 400_000), START + 460_000):
        ring.append(block.samples, block.utime, block.follows)
    assert ring.num_gaps == 1 and ring.seconds == 0.05
    assert ring.last_utime == START + 450_000


@pytest.mark.parametrize("rate", [8_000, 44_100, 48_000])
def test_any_rate_becomes_16_khz_with_the_right_stamps(rate):
    reader, ring = ChunkReader(), Ring(6.0)
    for number in range(40):
        msg = chunk(number, rate)
        for block in reader.add(msg, START + (number + 1) * COUNT * 1_000_000 // rate):
            ring.append(block.samples, block.utime, block.follows)
    sent_s = 40 * COUNT / rate
    assert ring.num_gaps == 0 and sent_s - 0.06 <= ring.seconds <= sent_s
    assert ring.last_utime - START == pytest.approx(ring.seconds * 1e6, abs=63)


@pytest.mark.parametrize("off_us", [3_600_000_000, -3_600_000_000])
def test_a_sender_with_another_clock_is_stamped_by_the_arrival(off_us):
    _, ring = play(range(20), late_us=off_us)
    assert ring.num_gaps == 0 and ring.seconds == 1.0
    assert ring.last_utime == arrived(19) + off_us


def test_a_sender_whose_time_jumps_is_a_gap_once():
    reader, ring = play(range(10))
    for number in range(10, 30):
        msg = chunk(number, start=START - 900_000_000)
        for block in reader.add(msg, arrived(number)):
            ring.append(block.samples, block.utime, block.follows)
    assert ring.num_gaps == 1 and ring.seconds == 1.0
    assert ring.last_utime == pytest.approx(arrived(29), abs=1)


@pytest.mark.parametrize(("rate", "count"), [(7_999, 10), (1, 10), (16_000, 0)])
def test_a_chunk_that_cannot_be_sound_is_counted(rate, count):
    reader, msg = ChunkReader(), chunk(0, 16_000, count=count)
    msg.sample_rate_hz = rate
    assert reader.add(msg, arrived(0)) == [] and reader.counters.bad == 1


def test_silence_on_the_bus_is_told_once_and_ends():
    clock, hub = SimClock(), MemqHub()
    sender, bus = hub.endpoint("source", clock), hub.endpoint("listener", clock)
    source, told = ChunkSource(bus), []
    for step in range(160):
        clock.advance_to(clock.utime() + CHUNK_US)
        if step // 40 % 2 == 1:  # 2 s of silence, 2 s of sound, and again
            sender.publish("AUDIO_CHUNK", chunk(step, start=clock.utime() - (step + 1) * CHUNK_US))
        bus.pump()
        source.read(clock.utime())
        if source.failure not in told[-1:]:
            told.append(source.failure)
        assert source.heard_utime >= clock.utime() - 1_100_000
    assert [bool(text) for text in told] == [False, True, False, True, False]
    assert "downbeat source" in told[1] and source.counters.outages == 2


@settings(max_examples=20, deadline=None)
@given(st.lists(st.tuples(st.integers(1, 20_000), st.integers(0, 3_000)), min_size=1, max_size=8))
def test_what_is_shared_arrives_with_its_gaps(parts):
    clock, hub = SimClock(START), MemqHub()
    sender, bus = hub.endpoint("source", clock), hub.endpoint("listener", clock)
    source, share = ChunkSource(bus), SoundShare(sender)
    there, here = Ring(6.0), Ring(6.0)
    at = 0
    for count, missing in parts:
        at += missing
        samples = ((at + np.arange(count)) % 20_000 / 32767.0).astype(np.float32)
        block = Block(samples, START + at * 1_000_000 // 16_000)
        clock.advance_to(max(clock.utime(), block.utime + count * 1_000_000 // 16_000))
        there.append(block.samples, block.utime, block.follows)
        share.send(block, clock.utime())
        at += count
        bus.pump()
        for heard in source.read(clock.utime()):
            assert len(heard.samples) <= MAX_SAMPLES
            here.append(heard.samples, heard.utime, heard.follows)
    assert here.num_gaps == there.num_gaps and here.seconds == there.seconds
    assert abs(here.last_utime - there.last_utime) <= 1
    assert np.abs(here.last(6.0) - there.last(6.0)).max() < 1e-4


def test_a_listener_hears_a_source_on_a_real_group_of_its_own(matcher, music):
    """Process "source" sends a piece; the listener locks on it, by real UDP and real time."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        url = f"udpm://239.255.76.67:{min(probe.getsockname()[1], 65_533)}?ttl=0"
    clock = WallClock()
    try:
        buses = {name: open_udpm(url, clock, name) for name in ("source", "listener", "operator")}
    except MulticastError as error:
        pytest.skip(str(error))
    listener = ListenerNode(buses["listener"], ChunkSource(buses["listener"]), matcher)
    # Two seconds that have sounded already come at once, as after a network that stood still.
    begin = clock.utime() - 1_900_000
    sound = Recording("piece", music["piece1"][3 * RATE : 12 * RATE], RATE)
    node = SourceNode(buses["source"], FileSource(sound, begin))
    watcher = buses["operator"]
    watcher.subscribe("MUSIC_MATCH", "AUDIO_SOURCE")
    locks, end = [], time.monotonic() + 5.0
    while not locks and time.monotonic() < end:
        utime = clock.utime()
        node.step(utime)
        listener.step(utime)
        watcher.pump(0.02)
        found = [received.msg for received in watcher.take("MUSIC_MATCH")]
        locks = [msg for msg in found if msg.lock == music_match_t.LOCKED]
    assert locks and locks[0].track == "piece1"
    assert (locks[0].track_zero_utime - begin) * 1e-6 == pytest.approx(-3.0, abs=0.03)
    states = [received.msg.state for received in watcher.take("AUDIO_SOURCE")]
    assert states == [audio_source_t.STARTED]


def test_music_that_goes_on_after_a_gap_is_not_glued_to_what_was_before(matcher, music):
    """A second is lost on the way: the lock holds, and no window reaches over the gap."""
    clock, hub = SimClock(START), MemqHub()
    sender, bus = hub.endpoint("source", clock), hub.endpoint("listener", clock)
    listener = ListenerNode(bus, ChunkSource(bus), matcher)
    file = FileSource(Recording("piece", music["piece0"], RATE), START)
    share = SoundShare(sender)
    watcher = hub.endpoint("operator", clock)
    watcher.subscribe("MUSIC_MATCH")
    locks = []
    for step in range(240):
        clock.advance_to(START + step * CHUNK_US)
        for block in file.read(clock.utime()):
            lost = Block(block.samples, block.utime)
            if not 100 <= step < 120:
                share.send(lost, clock.utime())
        listener.step(clock.utime())
        watcher.pump()
        locks += [(step, received.msg) for received in watcher.take("MUSIC_MATCH")]
    late = [msg for step, msg in locks if step > 150]
    assert late and all(msg.lock == music_match_t.LOCKED for msg in late)
    assert all(abs(msg.track_zero_utime - START) < 30_000 for msg in late)
    assert not any(msg.lock == music_match_t.LOST for step, msg in locks if step > 40)


def test_foreign_music_over_chunks_never_locks(matcher):
    clock, hub = SimClock(START), MemqHub()
    sender, bus = hub.endpoint("source", clock), hub.endpoint("listener", clock)
    listener = ListenerNode(bus, ChunkSource(bus), matcher)
    node = SourceNode(sender, FileSource(Recording("other", make_music(77, 8.0), RATE), START))
    watcher = hub.endpoint("operator", clock)
    watcher.subscribe("MUSIC_MATCH")
    for step in range(160):
        clock.advance_to(START + step * CHUNK_US)
        node.step(clock.utime())
        listener.step(clock.utime())
        watcher.pump()
    found = [received.msg.lock for received in watcher.take("MUSIC_MATCH")]
    assert found and music_match_t.LOCKED not in found
