"""Large catalogues: the inverted index proposes, and the answer is that of the whole search."""

import numpy as np
import pytest
import soxr
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_music import RATE, make_music

from downbeat.perception.candidates import ProposedScan, most_voted, prepare
from downbeat.perception.codes import BITS, TABLES, codes_of, make_code_table, query_codes
from downbeat.perception.index import QUANTUM, Index
from downbeat.perception.index_file import HEAD
from downbeat.perception.matcher import AlignmentMatcher
from downbeat.tools.bench_scale_tracks import MadeTracks, make_index


@pytest.fixture(scope="module")
def large(matcher):
    """The three pieces among 120 made tracks of 30 s."""
    return make_index(matcher.index, 120, 30.0, with_landmarks=False)


@pytest.fixture(scope="module")
def proposing(large):
    return AlignmentMatcher(large, max_scanned_tracks=0)


def degraded(music, number, rng):
    """Return name, start and a window of 5 s: clean, noisy, faster, higher in turn."""
    name = f"piece{number % 3}"
    start_s = float(rng.uniform(0, 34))
    rate = {2: 1.03, 3: 0.97}.get(number % 4, 1.0)
    count = round(5.2 * RATE * rate)
    sound = music[name][round(start_s * RATE) :][:count]
    if rate != 1.0:
        sound = soxr.resample(sound, RATE * rate, RATE)
    sound = sound[: 5 * RATE]
    if number % 4 == 1:
        noise = rng.standard_normal(len(sound)).astype(np.float32)
        sound = sound + noise * np.sqrt((sound**2).mean())
    return name, start_s, sound


def test_proposals_find_what_the_whole_search_finds(large, proposing, music):
    scanning = AlignmentMatcher(large, max_scanned_tracks=10**9)
    rng = np.random.default_rng(2)
    same = 0
    for number in range(32):
        name, _, sound = degraded(music, number, rng)
        expected, found = scanning.query(sound, RATE), proposing.query(sound, RATE)
        assert expected.track == name
        is_same = (found.track, found.accepted) == (expected.track, expected.accepted)
        same += is_same and found.tau_s == pytest.approx(expected.tau_s, abs=0.1)
    assert same >= 31


@pytest.mark.parametrize("seed", [90, 91, 92])
def test_unknown_music_is_not_accepted_in_a_large_catalogue(proposing, seed):
    for seconds in (2.0, 3.0, 5.0):
        assert not proposing.query(make_music(seed, seconds), RATE).accepted


def test_chance_is_sampled_as_the_whole_search_measures_it(large, matcher):
    whole, _ = prepare(large, 10**9)
    some, _ = prepare(large, 0)
    rng = np.random.default_rng(4)
    for _ in range(8):
        fine = matcher.index.fine[int(rng.integers(3))]
        first = int(rng.integers(0, len(fine) - 130))
        values = fine[first : first + 124 : 2].astype(np.float32) / np.float32(QUANTUM)
        assert some.search(values, 10)[1] == pytest.approx(whole.search(values, 10)[1], rel=0.15)


def test_short_and_empty_queries_still_get_an_answer(proposing):
    scan = proposing._scan
    assert isinstance(scan, ProposedScan)
    for frames in (8, 62, 200):
        places, chance = scan.search(np.zeros((frames, matcher_bands()), np.float32), 5)
        assert len(places) >= 1 and np.isfinite(chance)


def matcher_bands():
    from downbeat.perception.features import NUM_BANDS

    return NUM_BANDS


def test_a_saved_large_index_answers_the_same(large, proposing, music, tmp_path, monkeypatch):
    monkeypatch.setattr("downbeat.perception.index_file.MAX_SCANNED_TRACKS", 100)
    large.save(tmp_path / "index.bin")
    loaded = Index.load(tmp_path / "index.bin")
    assert loaded.codes is not None
    again = AlignmentMatcher(loaded, max_scanned_tracks=100)
    rng = np.random.default_rng(5)
    for number in range(4):
        sound = degraded(music, number, rng)[2]
        assert again.query(sound, RATE) == proposing.query(sound, RATE)


def test_a_damaged_track_is_silent_and_the_others_go_on(
    large, music, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr("downbeat.perception.index_file.EAGER_BYTES", 0)
    path = tmp_path / "index.bin"
    large.save(path)
    content = bytearray(path.read_bytes())
    content[HEAD.size + 700] ^= 1  # in the first track
    path.write_bytes(content)
    again = AlignmentMatcher(Index.load(path), max_scanned_tracks=100)
    for start_s in (5.0, 15.0):
        first, second = (
            music[name][round(start_s * RATE) :][: 5 * RATE] for name in ("piece0", "piece1")
        )
        assert not again.query(first, RATE).accepted
        assert again.query(second, RATE).accepted
    assert capsys.readouterr().err.count("not recognised") == 1


def test_codes_are_spread_evenly(large):
    """A code that many places had would cost time and tell nothing."""
    keys = np.concatenate([codes_of(track.astype(np.float32)) for track in large.coarse])
    for table in range(len(TABLES)):
        _, counts = np.unique(keys[:, table], return_counts=True)
        share = counts / counts.sum()
        effective = 2 ** -(share * np.log2(share)).sum() / len(counts)
        assert effective > 0.5
        assert counts.max() < 0.02 * counts.sum()


def test_every_moment_is_in_the_table_under_its_code(large):
    tracks = large.coarse[:5]
    table = make_code_table(tracks)
    assert len(table.starts) == (len(TABLES) << BITS) + 1
    begin = 0
    for track in tracks:
        keys = codes_of(track.astype(np.float32))
        for row in range(0, len(keys), 37):
            for key in keys[row]:
                assert begin + row in table.places[table.starts[key] : table.starts[key + 1]]
        begin += len(track)


def test_a_query_looks_up_its_own_codes(matcher):
    fine = matcher.index.fine[1]
    values = fine[400:520:2].astype(np.float32) / np.float32(QUANTUM)
    keys, rows, costs = query_codes(values)
    assert costs.min() == 0.0 and len(keys) == len(rows) == len(costs)
    asked = set(zip(rows.tolist(), keys.tolist()))
    own = codes_of(matcher.index.coarse[1][100:130].astype(np.float32))
    hits = sum((row, int(key)) in asked for row, keys in enumerate(own) for key in keys)
    assert hits >= 0.9 * own.size


@given(st.lists(st.integers(0, 60), min_size=1, max_size=200), st.integers(1, 10))
@settings(max_examples=40)
def test_the_most_voted_place_is_always_proposed(starts, count):
    found = most_voted(np.array(starts, np.int32), count, 61)
    votes = np.bincount(starts, minlength=63)
    pairs = [votes[max(p - 1, 0) : p + 2].sum() if votes[p] else 0 for p in range(61)]
    assert any(pairs[place] == max(pairs) for place in found)
    assert len(found) <= 3 * count and found.min() >= 0 and found.max() < 61


def test_made_tracks_are_always_the_same_and_none_of_the_real_ones(matcher):
    made = MadeTracks(matcher.index.fine, 6, 750)
    assert len(made) == 6 and made[1] is matcher.index.fine[1]
    assert np.array_equal(made[4], made[4])
    assert not np.array_equal(made[4], made[5])
    assert len(made[5]) == 748
