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
    sound = cut(music["piece0"], 0.0, 12.0).copy()
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


def test_a_drop_out_of_three_seconds_does_not_cost_the_place(matcher, music):
    sound = cut(music["piece0"], 0.0, 16.0).copy()
    sound[6 * RATE : 9 * RATE] = 0.0
    rows = listen(matcher, sound)
    assert all(s.place is not None and s.track == "piece0" for t, s in rows if t > 3.0)
    back = [(t, s) for t, s in rows if t > 10.0]
    assert all(s.lock == Lock.LOCKED for _, s in back)
    assert all(position_s(t, s) == pytest.approx(t, abs=0.02) for t, s in back)


def test_a_dip_of_the_volume_does_not_cost_the_lock(matcher, music):
    sound = cut(music["piece1"], 3.0, 14.0).copy()
    sound[6 * RATE : 8 * RATE] *= 0.1
    rows = listen(matcher, sound)
    assert all(s.track == "piece1" for t, s in rows if t > 3.0)
    assert sum(s.lock == Lock.LOCKED for t, s in rows if t > 3.0) >= 0.8 * (14.0 - 3.0) / HOP_S
    for time_s, state in rows:
        if time_s > 3.0:
            assert position_s(time_s, state) == pytest.approx(3.0 + time_s, abs=0.05)


def test_a_seek_is_followed_within_two_seconds(matcher, music):
    for from_s, to_s in ((2.0, 20.0), (24.0, 9.4)):
        first, then = (cut(music["piece2"], start_s, 7.0) for start_s in (from_s, to_s))
        rows = listen(matcher, np.concatenate([first, then]))
        for time_s, state in rows:
            if time_s >= 9.0:
                assert state.lock == Lock.LOCKED
                assert position_s(time_s, state) == pytest.approx(to_s + time_s - 7.0, abs=0.05)


def test_a_loop_that_jumps_back_is_followed_within_two_seconds(matcher, music):
    loop_s, from_s = 5.0, 11.0
    rows = listen(matcher, np.tile(cut(music["piece1"], from_s, loop_s), 4))
    for time_s, state in rows:
        inside_s = (time_s - 0.001) % loop_s
        if inside_s >= 2.0:
            assert state.lock == Lock.LOCKED
            assert position_s(time_s, state) == pytest.approx(from_s + inside_s, abs=0.05)


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_the_uncertainty_says_how_far_the_position_is_off(matcher, music, noise):
    errors, stds = [], []
    for name, start_s in (("piece0", 3.3), ("piece1", 9.1), ("piece2", 15.7)):
        sound = cut(music[name], start_s, 12.0)
        hiss = np.random.default_rng(4).standard_normal(len(sound)).astype(np.float32)
        for time_s, state in listen(matcher, sound + noise * hiss):
            if state.lock == Lock.LOCKED:
                errors.append(position_s(time_s, state) - start_s - time_s)
                stds.append(state.tau_std_s)
    off = np.abs(errors) / stds
    assert np.mean(off < 2.0) > 0.9 and off.max() < 5.0
    assert np.median(stds) < 0.03


def test_the_uncertainty_grows_while_nothing_can_be_checked(matcher, music):
    sound = cut(music["piece0"], 0.0, 9.0).copy()
    sound[6 * RATE :] = 0.0
    rows = dict(listen(matcher, sound))
    assert rows[8.75].tau_std_s > rows[7.0].tau_std_s > 0.0
    assert np.isnan(rows[0.25].tau_std_s)


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


def test_a_passage_that_repeats_is_ambiguous_until_the_track_goes_on(song):
    matcher, sound = song
    for begin_s, part_s in ((2.0, 10.0), (22.0, 30.0)):
        rows = listen(matcher, cut(sound, begin_s, 14.0))
        locked = [(begin_s + t, s) for t, s in rows if s.lock == Lock.LOCKED]
        assert all(s.ambiguous for at_s, s in locked if at_s < part_s - 0.5)
        assert not any(s.ambiguous for at_s, s in locked if at_s > part_s + 2.0)


def test_who_knew_the_place_before_a_repeat_knows_it_in_the_repeat(song):
    matcher, sound = song
    rows = listen(matcher, cut(sound, 14.0, 14.0))
    assert not any(s.ambiguous for t, s in rows if t > 3.0)


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


def in_noise(sound, seed, level=0.05):
    """Return music as a lock that is used to noise hears it."""
    hiss = np.random.default_rng(seed).standard_normal(len(sound)).astype(np.float32)
    return sound + level * hiss


def test_a_weak_second_in_noise_is_no_doubt_where_three_still_fit(matcher, music):
    for name, seed in (("piece0", 1), ("piece1", 2), ("piece2", 3)):
        sound = in_noise(cut(music[name], 4.0, 12.0), seed)
        burst = slice(round(7.0 * RATE), round(8.0 * RATE))
        sound[burst] = in_noise(sound[burst], seed + 10, 0.3)
        rows = listen(matcher, sound)
        weakest = min(s.similarity for t, s in rows if 7.5 <= t <= 8.5)
        assert weakest < 0.2  # a second alone would be in doubt
        for time_s, state in rows:
            if time_s > 4.0:
                assert state.lock == Lock.LOCKED
                assert position_s(time_s, state) == pytest.approx(4.0 + time_s, abs=0.05)


def test_a_cut_in_noise_is_noticed_within_two_seconds(matcher, music):
    for first, then in (("piece0", "piece1"), ("piece2", None)):
        rest = make_music(78, 8.0) if then is None else cut(music[then], 12.0, 8.0)
        sound = in_noise(np.concatenate([cut(music[first], 4.0, 8.0), rest]), 6)
        rows = listen(matcher, sound)
        assert all(s.lock == Lock.LOCKED for t, s in rows if 4.0 < t <= 8.0)
        for time_s, state in rows:
            if time_s >= 10.0:
                assert state.lock != Lock.LOCKED or state.track == then


@pytest.fixture(scope="module")
def quoting():
    """Two pieces of 30 s; 8 s of one, from 10 s on, are in the other from 14 s on."""
    from downbeat.tools.passages import find_passages

    shared = make_music(50, 8.0)
    sounds = {
        "early": np.concatenate([make_music(51, 10.0), shared, make_music(52, 12.0)]),
        "late": np.concatenate([make_music(53, 14.0), shared, make_music(54, 8.0)]),
        "third": make_music(55, 30.0),
    }
    made = AlignmentMatcher()
    for name, samples in sounds.items():
        made.add(name, samples, RATE)
    made.index.shared = find_passages(made.index)
    made.finish()
    return made, sounds


@pytest.mark.parametrize(("name", "begin_s"), [("early", 11.0), ("late", 15.0)])
def test_a_passage_of_two_tracks_is_no_lock_until_they_part(quoting, name, begin_s):
    matcher, sounds = quoting
    rows = listen(matcher, cut(sounds[name], begin_s, 13.0))
    inside = [s for t, s in rows if 3.0 < t <= 7.0]
    assert all(s.lock == Lock.CANDIDATE and s.ambiguous for s in inside)
    for time_s, state in rows:
        if state.lock == Lock.LOCKED:
            assert state.track == name
            assert position_s(time_s, state) == pytest.approx(begin_s + time_s, abs=0.05)
        assert state.lock == Lock.LOCKED or time_s < 9.0


@pytest.mark.parametrize(("name", "begin_s"), [("early", 4.0), ("late", 8.0)])
def test_who_knew_the_track_before_a_shared_passage_knows_it_in_the_passage(quoting, name, begin_s):
    matcher, sounds = quoting
    rows = listen(matcher, cut(sounds[name], begin_s, 16.0))
    for time_s, state in rows:
        if time_s > 3.0:
            assert (state.lock, state.track) == (Lock.LOCKED, name)


def bare_note(seconds, fades_s=np.inf):
    """Return a sine, as a piece may begin and as every test tone is."""
    t = np.arange(round(seconds * RATE)) / RATE
    return (0.1 * np.sin(2 * np.pi * 411.0 * t) * np.exp(-t / fades_s)).astype(np.float32)


@pytest.mark.parametrize("pause_s", [0.0, 0.2, 0.5])
def test_a_test_tone_is_not_the_piece_that_begins_with_that_note(pause_s):
    matcher = AlignmentMatcher()
    pause = np.zeros(round(pause_s * RATE), np.float32)
    piece = np.concatenate([pause, bare_note(3.0, fades_s=1.5), make_music(31, 30.0)])
    matcher.add("begins with a note", piece, RATE)
    for seed in range(6):
        matcher.add(f"piece{seed}", make_music(seed, 30.0), RATE)
    rows = listen(matcher, np.concatenate([np.zeros(RATE, np.float32), bare_note(6.0)]))
    assert not any(state.lock == Lock.LOCKED for _, state in rows)
    rows = listen(matcher, piece[: 10 * RATE])
    assert rows[-1][1].lock == Lock.LOCKED and rows[-1][1].track == "begins with a note"


NOISE_TOO_LOUD = 0.2
"""For any one window of these pieces to be enough for a lock."""


def test_two_windows_that_share_no_sound_and_agree_are_a_lock(matcher, music):
    """Where no single window is enough: without the second rule none of these ever locks."""
    for name, seed in (("piece0", 0), ("piece0", 1), ("piece1", 1), ("piece1", 2)):
        sound = in_noise(cut(music[name], 4.0, 10.0), seed, NOISE_TOO_LOUD)
        rows = listen(matcher, sound)
        time_s, state = next((t, s) for t, s in rows if s.lock == Lock.LOCKED)
        assert state.track == name
        assert position_s(time_s, state) == pytest.approx(4.0 + time_s, abs=0.06)


@pytest.mark.parametrize("name, seed", [("piece0", 0), ("piece1", 0), ("piece1", 2)])
def test_what_was_heard_before_a_lock_that_was_lost_still_counts(matcher, music, name, seed):
    """Who had to hear two windows to lock, and is drowned at once, needs one afterwards."""
    sound = in_noise(cut(music[name], 4.0, 16.0), seed, 0.19)
    locked_s = first_lock(listen(matcher, sound), name, 0.0)
    drowned = slice(round((locked_s + 0.25) * RATE), round((locked_s + 2.25) * RATE))
    sound[drowned] = in_noise(np.zeros(drowned.stop - drowned.start, np.float32), 99, 0.4)
    rows = listen(matcher, sound)
    assert any(state.lock != Lock.LOCKED for time_s, state in rows if time_s > locked_s)
    assert first_lock(rows, name, locked_s + 2.25) < locked_s + 2.25 + 4.0


@pytest.mark.parametrize("level, fall_db", [(0.06, 14.0), (0.1, 10.0)])
def test_music_that_fades_in_its_noise_is_held(matcher, music, level, fall_db):
    sound = cut(music["piece1"], 4.0, 16.0)
    falling = np.clip((np.arange(len(sound)) / RATE - 5.0) / 3.0, 0.0, 1.0)
    faded = (sound * 10.0 ** (-falling * fall_db / 20.0)).astype(np.float32)
    rows = listen(matcher, in_noise(faded, 1, level))
    after = [state.lock == Lock.LOCKED for time_s, state in rows if time_s > 8.0]
    assert sum(after) > len(after) / 2
