"""Two windows that were not enough: when they are, together."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from downbeat.perception.match import MatchResult
from downbeat.perception.suspicion import (
    LEAST_CONFIDENCE,
    LEAST_SUM,
    MEMORY_US,
    OVERLAP_US,
    Suspicions,
)
from downbeat.perception.track_state import Place

SECOND = 1_000_000
WEAK = MatchResult(track="track", confidence=-0.5, similarity=0.2)


def place(zero_s, now, track="track"):
    """Return where a track is that began at `zero_s`."""
    return Place(track, now * 1e-6 - zero_s, now)


def ask(second, first_now=3 * SECOND, now=6 * SECOND, moved_s=0.0, first=WEAK, seconds=2.0):
    """Return whether a second window confirms a first."""
    suspicions = Suspicions()
    assert not suspicions.confirm(first, place(-20.0, first_now), first_now, seconds)
    there = place(-20.0 + moved_s, now, second.track)
    return suspicions.confirm(second, there, now, seconds)


def test_the_same_place_twice_is_enough():
    assert ask(WEAK)


@pytest.mark.parametrize("moved_s", [-3.0, -0.2, 0.2, 3.0])
def test_another_place_is_not(moved_s):
    assert not ask(WEAK, moved_s=moved_s)


def test_another_track_is_not():
    assert not ask(replace(WEAK, track="another"))


def test_what_may_be_one_of_two_tracks_is_not():
    assert not ask(replace(WEAK, twins=(("twin", 1.0),)))
    assert not ask(WEAK, first=replace(WEAK, twins=(("twin", 1.0),)))


@pytest.mark.parametrize("rate", [0.95, 0.96, 1.04, 1.05])
def test_what_fits_at_another_speed_is_not(rate):
    assert not ask(replace(WEAK, rate=rate))


@given(st.floats(0.5, 8.0), st.floats(0.25, 9.0))
def test_windows_that_share_sound_confirm_nothing(seconds, later_s):
    now = 10 * SECOND + round(later_s * 1e6)
    shares = round(seconds * 1e6) - OVERLAP_US > now - 10 * SECOND
    assert ask(WEAK, 10 * SECOND, now, seconds=seconds) == (not shares)


def test_what_was_heard_long_ago_is_forgotten():
    assert not ask(WEAK, now=3 * SECOND + MEMORY_US)


@given(st.floats(-8.0, 4.0), st.floats(-8.0, 4.0))
def test_neither_window_may_be_weak_and_both_together_not_either(first, second):
    result = ask(replace(WEAK, confidence=second), first=replace(WEAK, confidence=first))
    assert result == (min(first, second) >= LEAST_CONFIDENCE and first + second > LEAST_SUM)
