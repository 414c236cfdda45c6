"""The lock: quick to notice a cut, never on the wrong track."""

import numpy as np
import pytest
import soxr
from synthetic_music import RATE, make_music, make_song

from downbeat.perception.matcher import AlignmentMatcher
from downbeat.perception.source import Ring
from downbeat.perception.tracker import Lock, Place, Tracker

HOP_S = 0.25
HOP = round(HOP_S * RATE)


def listen(matcher, sound):
    """Return (time, state) per hop."""
    tracker, ring, rows = Tracker(matcher), Ring(6.0, RATE), []
    for number in range(1, len(sound) // HOP + 1):
        ring.append(sound[(number - 1) * HOP : number * HOP])
        audible = float(np.abs(ring.last(1.0)).max()) > 1e-3
        now = round(number * HOP / RATE * 1e6)
        rows.append((number * HOP_S, tracker.update(ring, now, audible)))
    return rows


def first_lock(rows, track, after_s):
    return next(t for t, s in rows if t > after_s and s.lock == Lock.LOCKED and s.track == track)


def cut(sound, from_s, seconds):
    return sound[round(from_s * RATE) : round((from_s + seconds) * RATE)]


def position_s(time_s, state):
    """Return where the state says that the track is at the time of its hop."""
    return (time_s - state.track_zero_utime * 1e-6) * state.rate


def test_cut_is_noticed_within_two_seconds(matcher, music):
    sound = np.concatenate([cut(music["piece0"], 0.0, 10.0), cut(music["piece1"], 5.0, 10.0)])
    rows = listen(matcher, sound)
    assert first_lock(rows, "piece0", 0.0) <= 1.75
    assert first_lock(rows, "piece1", 10.0) - 10.0 <= 2.0
    for time_s, state in rows:
        if state.lock == Lock.LOCKED and time_s > 10.75:
            assert state.track == "piece1"


@pytest.mark.parametrize("seed", range(3))
def test_random_cuts_lock_on_what_plays_and_on_nothing_else(matcher, music, seed):
    rng = np.random.default_rng(seed)
    parts, begins, names = [], [], []
    for name in rng.permutation(list(music)).tolist() * 2:
        begins.append(sum(len(p) for p in parts) / RATE)
        names.append((name, float(rng.uniform(0.0, 30.0))))
        parts.append(cut(music[name], names[-1][1], float(rng.uniform(5.0, 7.0))))
    ends = [*begins[1:], sum(len(p) for p in parts) / RATE]
    rows = listen(matcher, np.concatenate(parts))
    for (name, from_s), begin, end in zip(names, begins, ends):
        assert first_lock(rows, name, begin) - begin <= 2.5
        for time_s, state in rows:
            if begin + 1.0 < time_s < end and state.lock == Lock.LOCKED:
                assert state.track == name
                assert position_s(time_s, state) == pytest.approx(from_s + time_s - begin, abs=0.05)


def test_locked_position_is_true_within_ten_milliseconds(matcher, music):
    start_s = 7.3
    rows = listen(matcher, cut(music["piece2"], start_s, 12.0))
    for time_s, state in rows:
        if state.lock == Lock.LOCKED and time_s > 4.0:
            assert state.track_zero_utime * 1e-6 == pytest.approx(-start_s, abs=0.010)
            assert state.rate == 1.0


def test_unknown_music_never_locks(matcher):
    assert all(s.lock != Lock.LOCKED for _, s in listen(matcher, make_music(123, 15.0)))


def test_short_pause_keeps_the_lock_and_a_long_one_loses_it(matcher, music):
    sound = cut(music["piece0"], 0.0, 20.0).copy()
    sound[6 * RATE : 8 * RATE] = 0.0
    sound[12 * RATE : 18 * RATE] = 0.0
    rows = dict(listen(matcher, sound))
    assert rows[7.75].lock != Lock.LOST
    assert rows[9.5].lock == Lock.LOCKED
    assert rows[17.5].lock == Lock.LOST


def test_music_that_stops_being_itself_loses_the_lock(matcher, music):
    sound = np.concatenate([cut(music["piece0"], 0.0, 6.0), make_music(7, 6.0)])
    rows = listen(matcher, sound)
    doubted = next(t for t, s in rows if t > 6.0 and s.lock != Lock.LOCKED)
    lost = next(t for t, s in rows if t > 6.0 and s.lock == Lock.LOST)
    assert doubted - 6.0 <= 0.75
    assert lost - 6.0 <= 4.0
    assert all(s.lock != Lock.LOCKED for t, s in rows if t > doubted)


def test_a_lock_that_was_short_is_not_believed_for_long(matcher, music):
    sound = np.concatenate([cut(music["piece0"], 0.0, 2.5), make_music(8, 6.0)])
    rows = listen(matcher, sound)
    lost = next(t for t, s in rows if t > 2.5 and s.lock == Lock.LOST)
    assert lost - 2.5 <= 2.0


def test_somebody_who_talks_over_the_music_does_not_cost_the_place(matcher, music):
    sound = cut(music["piece0"], 0.0, 12.0)
    voice = np.random.default_rng(3).standard_normal(round(2.0 * RATE)).astype(np.float32)
    sound[round(6.0 * RATE) : round(8.0 * RATE)] += voice
    rows = listen(matcher, sound)
    after_s = {t: s for t, s in rows if t > 4.0}
    assert all(s.place is not None and s.track == "piece0" for s in after_s.values())
    regained = next(t for t, s in after_s.items() if t >= 8.0 and s.lock == Lock.LOCKED)
    assert regained - 8.0 <= 1.25
    for time_s, state in after_s.items():
        if time_s > regained:
            assert position_s(time_s, state) == pytest.approx(time_s, abs=0.05)


@pytest.fixture(scope="module")
def song():
    """Verse 0-10 s, bridge to 20 s, the same verse to 30 s, ending."""
    matcher = AlignmentMatcher()
    sound = make_song(40, 10.0)
    matcher.add("song", sound, RATE)
    matcher.add("other", make_music(41, 30.0), RATE)
    return matcher, sound


def test_position_holds_through_a_repeated_verse(song):
    matcher, sound = song
    rows = listen(matcher, cut(sound, 14.0, 24.0))
    for time_s, state in rows:
        if time_s > 3.0:
            assert state.lock == Lock.LOCKED
            assert position_s(time_s, state) == pytest.approx(14.0 + time_s, abs=0.05)


def test_a_repeat_taken_for_its_twin_is_corrected_where_they_part(song):
    matcher, sound = song
    for begin_s, part_s in ((2.0, 10.0), (22.0, 30.0)):
        rows = listen(matcher, cut(sound, begin_s, 16.0))
        late = [row for row in rows if begin_s + row[0] > part_s + 2.0]
        for time_s, state in late:
            assert state.lock == Lock.LOCKED
            assert position_s(time_s, state) == pytest.approx(begin_s + time_s, abs=0.05)


@pytest.mark.parametrize("speed", [0.98, 1.02])
def test_another_speed_is_followed_and_named(matcher, music, speed):
    played = soxr.resample(cut(music["piece1"], 4.0, 26.0), RATE, RATE / speed)
    rows = listen(matcher, played.astype(np.float32))
    settled = [(t, s) for t, s in rows if t > 15.0]
    for time_s, state in settled:
        assert state.lock == Lock.LOCKED
        assert position_s(time_s, state) == pytest.approx(4.0 + time_s * speed, abs=0.03)
        assert state.rate == pytest.approx(speed, abs=0.005)


def test_a_place_moves_with_its_rate():
    place = Place("any", 10.0, 1_000_000, 1.02)
    assert place.at(3_000_000) == pytest.approx(12.04)
    assert place.is_near(Place("any", 12.04, 3_000_000))
    assert not place.is_near(Place("any", 12.2, 3_000_000))
    assert not place.is_near(Place("another", 12.04, 3_000_000))
    assert Place("any", 0.0, 0, 1.003).used_rate == 1.0
