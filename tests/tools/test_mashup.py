"""Mashups: what is cut, what is true of it, who is chosen."""

import json

import numpy as np
import pytest
import soundfile
from hypothesis import given, settings
from hypothesis import strategies as st

from downbeat.catalog.beatgrid import BeatGrid
from downbeat.catalog.setlist import SetEntry, SetList, load_setlist
from downbeat.catalog.tracks import Rule, Track, load_track
from downbeat.perception.source import Recording
from downbeat.tools.errors import ToolError
from downbeat.tools.mashup import SAMPLE_RATE_HZ, build_mashup, seeded_set_list
from downbeat.tools.recordings import assign_skills, write_track

RATE = 8_000


def recording(name, seconds, rate=RATE, level=0.3):
    """Return a steady tone with noise: sounding all along."""
    random = np.random.default_rng(len(name) + round(seconds))
    return Recording(
        name, (level * random.uniform(-1, 1, round(seconds * rate))).astype(np.float32), rate
    )


def tracks_of(skills, rules=()):
    return {
        name: Track(name, skill, BeatGrid(120.0), tuple(rules), duration_s=60.0)
        for name, skill in skills.items()
    }


SHOW = SetList((SetEntry("one", 5.0, 10.0), SetEntry("two", 0.0, 8.0), SetEntry("three", 2.0, 6.0)))
TRACKS = tracks_of({"one": "a", "two": "b", "three": "b"}, [Rule(9.0, 40.0, "c")])
RECORDINGS = {
    "one": recording("one", 60.0, SAMPLE_RATE_HZ),
    "two": recording("two", 60.0, 22_050),
    "three": recording("three", 60.0),
}


def mashup(announced=False):
    return build_mashup(SHOW, TRACKS, RECORDINGS, announced)


def test_mashup_has_the_length_of_its_set_list():
    assert len(mashup().samples) == 24 * SAMPLE_RATE_HZ
    assert mashup().truth["duration_s"] == 24.0


def test_passage_is_the_tracks_own_sound_from_its_position():
    made = mashup().samples[SAMPLE_RATE_HZ : 2 * SAMPLE_RATE_HZ]
    source = RECORDINGS["one"].samples[6 * SAMPLE_RATE_HZ : 7 * SAMPLE_RATE_HZ]
    np.testing.assert_array_equal(made, source)


def test_cuts_do_not_click():
    for cut_s in (10.0, 18.0):
        middle = round(cut_s * SAMPLE_RATE_HZ)
        around = mashup().samples[middle - 40 : middle + 40]
        assert np.abs(np.diff(around)).max() < 0.5
        assert np.abs(around[39:41]).max() < 0.02


def test_truth_names_every_boundary():
    rows = [
        (row["start_s"], row["end_s"], row["skill"], row["track"], row["boundary"])
        for row in mashup().truth["sections"]
    ]
    assert rows == [
        (0.0, 4.0, "a", "one", "start"),
        (4.0, 10.0, "c", "one", "announced"),
        (10.0, 24.0, "b", "two", "unannounced"),
    ]


def test_with_a_set_list_cuts_are_announced_too(tmp_path):
    made = mashup(announced=True)
    kinds = [row["boundary"] for row in made.truth["sections"]]
    assert kinds == ["start", "announced", "announced"]
    made.write(tmp_path)
    assert load_setlist(tmp_path / "setlist.toml", TRACKS) == SHOW


def test_surprise_show_leaves_no_set_list_behind(tmp_path):
    mashup().write(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mashup.wav", "truth.json"]
    info = soundfile.info(tmp_path / "mashup.wav")
    assert (info.samplerate, info.channels) == (SAMPLE_RATE_HZ, 1)
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert truth["version"] == 1
    assert [s["track_from_s"] for s in truth["segments"]] == [5.0, 0.0, 2.0]


def test_beat_grid_of_a_breathing_track_is_written_beat_by_beat():
    times = (0.5, 1.1, 1.6, 2.2)
    live = {"one": Track("one", "a", BeatGrid(110.0, beat_times_s=times), duration_s=60.0)}
    made = build_mashup(SetList((SetEntry("one", 0.0, 5.0),)), live, RECORDINGS, False)
    assert made.truth["beat_grids"] == {"one": {"beat_times_s": list(times)}}


skill_lists = st.lists(st.sampled_from("abc"), min_size=2, max_size=7)


@settings(max_examples=25)
@given(skill_lists, st.integers(0, 1000), st.integers(2, 9))
def test_neighbours_are_other_tracks_and_other_skills_where_that_is_possible(skills, seed, count):
    tracks = tracks_of({f"t{n}": skill for n, skill in enumerate(skills)})
    recordings = {name: recording(name, 30.0) for name in tracks}
    show, left_out = seeded_set_list(tracks, recordings, 8.0, count, seed)
    assert left_out == ()
    assert len(show.entries) == count
    for entry in show.entries:
        assert 0.0 <= entry.from_s <= 30.0 - 8.0
    for first, second in zip(show.entries, show.entries[1:]):
        assert first.track != second.track
        if len(set(skills)) > 1:
            known = {tracks[first.track].default_skill, tracks[second.track].default_skill}
            assert len(known) == 2


def test_same_seed_same_show_other_seed_other_show():
    tracks = tracks_of({name: name[-1] for name in ("x_a", "x_b", "x_c", "x_d")})
    recordings = {name: recording(name, 40.0) for name in tracks}
    shows = [seeded_set_list(tracks, recordings, 8.0, 6, seed)[0] for seed in (1, 1, 2)]
    assert shows[0] == shows[1] != shows[2]


def test_tracks_without_a_long_enough_passage_are_left_out_and_named():
    tracks = tracks_of({"long": "a", "longer": "b", "short": "c", "pauses": "a"})
    recordings = {name: recording(name, 40.0) for name in tracks}
    recordings["short"] = recording("short", 10.0)
    for start_s in range(5, 40, 7):
        recordings["pauses"].samples[start_s * RATE : (start_s + 4) * RATE] = 0.0
    show, left_out = seeded_set_list(tracks, recordings, 20.0, 6, 0)
    assert set(left_out) == {"short", "pauses"}
    assert {entry.track for entry in show.entries} == {"long", "longer"}


def test_one_long_track_is_not_enough_and_the_sentence_says_so():
    tracks = tracks_of({"long": "a", "short": "b"})
    recordings = {"long": recording("long", 40.0), "short": recording("short", 5.0)}
    with pytest.raises(ToolError, match=r"needs two tracks that long; there are 1 .*short"):
        seeded_set_list(tracks, recordings, 20.0, 6, 0)


def test_every_dance_is_used_before_one_comes_again():
    recordings = {f"t{n}": recording(f"t{n}", 5.0) for n in range(6)}
    grids = {name: BeatGrid(120.0) for name in recordings}
    tracks = assign_skills(recordings, grids, ["a", "b", "c"], seed=4)
    skills = [track.default_skill for track in tracks.values()]
    assert sorted(skills[:3]) == sorted(skills[3:]) == ["a", "b", "c"]
    assert tracks == assign_skills(recordings, grids, ["a", "b", "c"], seed=4)


@pytest.mark.parametrize("name", ["plain", 'with "quotes"', "back\\slash", "café ♥ 音楽"])
def test_written_track_is_read_back(tmp_path, name):
    grid = BeatGrid(97.123456789, 0.1234567891, 3)
    track = Track(name, "a", grid, (Rule(1.0, 2.5, "b", "verse"),), name, None, name, 33.3)
    write_track(tmp_path / "track.toml", track)
    assert load_track(tmp_path / "track.toml") == track
