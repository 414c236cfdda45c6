"""The ring: the same content and stamps however sound comes, and never a gap inside a window."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from downbeat.perception.ring import RATE_HZ, Block, Resampler, Ring

START = 1_700_000_000_000_000


def ramp(first, count):
    """Samples that say which ones they are."""
    return np.arange(first, first + count, dtype=np.float32)


def utime_of(number):
    return START + number * 1_000_000 // RATE_HZ


sizes = st.lists(st.integers(0, 700), min_size=1, max_size=30)


@given(sizes, sizes)
def test_any_split_into_blocks_gives_the_same_content_and_stamps(first, second):
    total = min(sum(first), sum(second))
    rings = []
    for split in (first, second):
        ring, done = Ring(0.05), 0
        for size in [*split, total]:
            count = min(size, total - done)
            ring.append(ramp(done, count), utime_of(done))
            done += count
        rings.append(ring)
    one, other = rings
    assert np.array_equal(one.last(1.0), other.last(1.0))
    assert np.array_equal(one.last(1.0), ramp(max(0, total - 800), min(total, 800)))
    assert one.seconds == other.seconds and one.num_gaps == other.num_gaps == 0
    assert one.last_utime == other.last_utime
    assert total == 0 or one.last_utime == utime_of(total)


@given(st.lists(st.tuples(st.integers(1, 300), st.integers(0, 50)), min_size=1, max_size=30))
def test_a_gap_is_never_inside_a_window(parts):
    ring, at, since_gap, gaps = Ring(0.05), 0, 0, 0
    for number, (count, missing) in enumerate(parts):
        at += missing
        if missing and number:
            since_gap, gaps = 0, gaps + 1
        ring.append(ramp(at, count), utime_of(at))
        at += count
        since_gap += count
        for seconds in (0.001, 0.02, 1.0):
            window = ring.last(seconds)
            assert len(window) <= min(round(seconds * RATE_HZ), since_gap)
            assert np.array_equal(window, ramp(at - len(window), len(window)))
        assert ring.seconds == min(since_gap, 800) / RATE_HZ
        # After a gap time is counted from a whole microsecond.
        assert 0 <= utime_of(at) - ring.last_utime <= 1
    assert ring.num_gaps == gaps


def test_one_missing_sample_is_a_gap_and_a_clock_that_drifts_is_none():
    ring = Ring(1.0)
    ring.append(ramp(0, 160), START)
    ring.append(ramp(161, 160), utime_of(161))
    assert ring.num_gaps == 1 and ring.seconds == 0.01
    for number in range(1, 50):  # 300 ppm fast, told by the source
        utime = utime_of(161) + round(number * 10_000 * 1.0003)
        ring.append(ramp(161 + 160 * number, 160), utime, True)
    assert ring.num_gaps == 1 and ring.seconds == 0.5
    assert ring.last_utime == pytest.approx(utime_of(161) + 49 * 10_003 + 10_000, abs=2)


def test_time_that_goes_back_or_forward_is_a_gap():
    ring = Ring(1.0)
    for utime in (START, START - 5_000_000, START + 60_000_000):
        ring.append(ramp(0, 160), utime)
        assert ring.seconds == 0.01 and ring.last_utime == utime + 10_000
    assert ring.num_gaps == 2
    ring.append(ramp(160, 160), START + 60_010_000, False)  # the source knows better
    assert ring.num_gaps == 3 and ring.seconds == 0.01
    ring.append(ramp(320, 160), START + 60_020_000 + 50_000, True)  # and cannot be right
    assert ring.num_gaps == 4


def test_what_was_before_a_marked_gap_is_gone_at_once():
    ring = Ring(1.0)
    ring.append(ramp(0, 160), START)
    ring.mark_gap()
    ring.mark_gap()
    assert ring.num_gaps == 1 and ring.seconds == 0.0 and len(ring.last(1.0)) == 0
    assert ring.last_utime == START + 10_000


def test_a_window_stays_what_it_was_when_more_is_heard():
    ring = Ring(0.01)
    ring.append(ramp(0, 160), START)
    window = ring.last(0.01)
    ring.append(ramp(160, 160), utime_of(160))
    assert np.array_equal(window, ramp(0, 160))


def push_all(resampler, samples, first_utime, cuts):
    """Feed samples in pieces; returns the blocks."""
    blocks, at = [], 0
    for size in [*cuts, len(samples)]:
        part = samples[at : at + size]
        utime = first_utime + at * 1_000_000 // resampler.sample_rate_hz
        blocks += resampler.push(Block(part, utime))
        at += len(part)
    return blocks + resampler.flush()


@pytest.mark.parametrize("rate", [8_000, 22_050, 44_100, 48_000, 96_000])
@settings(max_examples=8, deadline=None)
@given(st.lists(st.integers(1, 5_000), max_size=20), st.integers(100, 900))
def test_an_impulse_keeps_its_time_through_resampling(rate, cuts, at_ms):
    at = at_ms * rate // 1000
    samples = np.zeros(rate, np.float32)
    samples[at] = 1.0
    blocks = push_all(Resampler(rate), samples, START, cuts)
    ring = Ring(2.0)
    for block in blocks:
        ring.append(block.samples, block.utime, block.follows)
    assert ring.num_gaps == 0
    sound = ring.last(2.0)
    assert abs(len(sound) - RATE_HZ) <= 1
    begin = ring.last_utime - len(sound) * 1e6 / RATE_HZ
    heard_utime = begin + int(np.abs(sound).argmax()) * 1e6 / RATE_HZ
    assert abs(heard_utime - (START + at * 1e6 / rate)) <= 1e6 / RATE_HZ


@settings(max_examples=10, deadline=None)
@given(st.lists(st.integers(1, 3_000), max_size=20))
def test_resampling_does_not_depend_on_the_blocks(cuts):
    samples = np.random.default_rng(0).standard_normal(20_000).astype(np.float32)
    whole = np.concatenate([b.samples for b in push_all(Resampler(44_100), samples, START, [])])
    split = np.concatenate([b.samples for b in push_all(Resampler(44_100), samples, START, cuts)])
    assert np.array_equal(whole, split)


@pytest.mark.parametrize("rate", [16_000, 44_100])
def test_a_gap_before_the_resampler_is_a_gap_behind_it_with_the_right_stamp(rate):
    resampler, ring = Resampler(rate), Ring(3.0)
    samples = np.random.default_rng(1).standard_normal(rate // 10).astype(np.float32)
    later = START + 100_000 + 7_000
    for utime in (START, later):
        for block in resampler.push(Block(samples, utime)):
            ring.append(block.samples, block.utime, block.follows)
    for block in resampler.flush():
        ring.append(block.samples, block.utime, block.follows)
    assert ring.num_gaps == 1
    assert ring.seconds == pytest.approx(0.1, abs=1e-4)
    assert ring.last_utime == pytest.approx(later + 100_000, abs=63)


def test_samples_that_are_no_numbers_become_silence_and_are_counted():
    resampler = Resampler(48_000)
    samples = np.full(4_800, 0.1, np.float32)
    samples[[5, 6, 7, 8]] = np.nan, np.inf, -np.inf, 3e38
    blocks = resampler.push(Block(samples, START)) + resampler.flush()
    assert resampler.num_bad_samples == 4
    assert all(np.abs(block.samples).max() < 0.2 for block in blocks)
