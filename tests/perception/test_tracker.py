"""The lock: quick to notice a cut, never on the wrong track."""

import numpy as np
import pytest
from synthetic_music import RATE, make_music

from downbeat.perception.source import Ring
from downbeat.perception.tracker import Lock, Tracker

HOP_S = 0.25


def listen(matcher, sound):
    """Return (time, state) per hop."""
    tracker, ring, rows = Tracker(matcher), Ring(6.0, RATE), []
    hop = round(HOP_S * RATE)
    for end in range(hop, len(sound) + 1, hop):
        ring.append(sound[end - hop : end])
        audible = float(np.abs(ring.last(1.0)).max()) > 1e-3
        rows.append(
            (round(end / RATE * 4) / 4, tracker.update(ring, round(end / RATE * 1e6), audible))
        )
    return rows


def first_lock(rows, track, after_s):
    return next(t for t, s in rows if t > after_s and s.lock == Lock.LOCKED and s.track == track)


def test_cut_is_noticed_within_two_seconds(matcher, music):
    sound = np.concatenate([music["piece0"][: 10 * RATE], music["piece1"][5 * RATE : 15 * RATE]])
    rows = listen(matcher, sound)
    assert first_lock(rows, "piece0", 0.0) <= 1.75
    assert first_lock(rows, "piece1", 10.0) - 10.0 <= 2.0
    for time_s, state in rows:
        if state.lock == Lock.LOCKED and time_s > 10.75:
            assert state.track == "piece1"


def test_locked_position_is_true_within_ten_milliseconds(matcher, music):
    start_s = 7.3
    rows = listen(matcher, music["piece2"][round(start_s * RATE) :][: 12 * RATE])
    for time_s, state in rows:
        if state.lock == Lock.LOCKED and time_s > 4.0:
            assert state.track_zero_utime * 1e-6 == pytest.approx(-start_s, abs=0.010)


def test_unknown_music_never_locks(matcher):
    assert all(s.lock != Lock.LOCKED for _, s in listen(matcher, make_music(123, 15.0)))


def test_short_pause_keeps_the_lock_and_a_long_one_loses_it(matcher, music):
    sound = music["piece0"][: 20 * RATE].copy()
    sound[6 * RATE : 8 * RATE] = 0.0
    sound[12 * RATE : 18 * RATE] = 0.0
    rows = dict(listen(matcher, sound))
    assert rows[7.75].lock != Lock.LOST
    assert rows[9.5].lock == Lock.LOCKED
    assert rows[17.5].lock == Lock.LOST


def test_music_that_stops_being_itself_loses_the_lock(matcher, music):
    sound = np.concatenate([music["piece0"][: 6 * RATE], make_music(7, 6.0)])
    rows = listen(matcher, sound)
    lost = next(t for t, s in rows if t > 6.0 and s.lock == Lock.LOST)
    assert lost - 6.0 <= 1.5
