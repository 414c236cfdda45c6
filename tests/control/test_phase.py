"""Phases, lines and crossings."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from downbeat.control.phase import PhaseFollower, PhaseLine, next_beat_utime, wrap

rates = st.floats(0.7, 1.3)
phases = st.floats(0.0, 8.0)
times = st.integers(0, 10**9)


@given(st.floats(-1e4, 1e4), st.floats(0.1, 100.0))
def test_wrap_lands_in_half_a_period_and_keeps_the_remainder(value, period):
    wrapped = wrap(value, period)
    assert -0.5 * period - 1e-9 <= wrapped <= 0.5 * period + 1e-9
    turns = (value - wrapped) / period
    assert turns == pytest.approx(round(turns), abs=1e-6)


@given(rates, phases, times)
def test_phase_on_its_line_stays_on_it(rate, phase, start):
    line = PhaseLine(start, phase, rate)
    follower = PhaseFollower(line, start, 8.0, 0.5)
    for tick in range(100):
        follower.advance(start + tick * 20_000)
    assert follower.phase_s == pytest.approx(line.at(start + 100 * 20_000), abs=1e-6)


@given(rates, phases, st.floats(-0.24, 0.24))
def test_phase_catches_up_within_five_seconds_without_jumping(rate, phase, offset):
    line = PhaseLine(0, phase + offset, rate)
    follower = PhaseFollower(PhaseLine(0, phase, rate), 0, 8.0, 0.5)
    follower.retime(line)
    for tick in range(250):
        before = follower.phase_s
        follower.advance(tick * 20_000)
        assert 0.0 < follower.phase_s - before < 0.02 * rate * 1.11
    assert follower.error_s(250 * 20_000) == pytest.approx(0.0, abs=2e-3)


@given(rates, phases, phases)
def test_next_crossing_is_where_it_says(rate, phase, target):
    follower = PhaseFollower(PhaseLine(0, phase, rate), 0, 8.0, 0.5)
    seconds = follower.next_crossing_s(target)
    assert 0.0 <= seconds <= 8.0 / rate
    reached = (phase + seconds * rate - target + 4.0) % 8.0 - 4.0
    assert abs(reached) <= 0.5 * 0.02 * rate + 1e-6


@given(rates, phases, times)
def test_next_beat_is_a_beat_and_not_past(rate, phase, now):
    line = PhaseLine(0, phase, rate)
    beat = next_beat_utime(line, 0.5, now)
    assert now <= beat <= now + 0.5 / rate * 1e6 + 1
    assert wrap(line.at(beat), 0.5) == pytest.approx(0.0, abs=1e-5)


def test_gesture_only_follows_the_rate():
    follower = PhaseFollower(PhaseLine(0, 0.0, 1.0), 0, 4.0, None)
    follower.retime(PhaseLine(0, 2.0, 1.0))
    follower.advance(0)
    assert follower.phase_s == pytest.approx(0.02)
