"""Passages that two recordings share: named with their places, the same after every update."""

import numpy as np
import pytest

from downbeat.perception.index import Index
from downbeat.perception.passages import Passage, Twins
from downbeat.tools import catalog_build, catalog_tools
from downbeat.tools.passages import find_passages, update_passages

RATE = 16_000
SHARED_S = 8.0


def notes(seed, seconds):
    """Plucked notes drawn from a seed."""
    rng = np.random.default_rng(seed)
    out = np.zeros(round(seconds * RATE), np.float32)
    for start_s in np.arange(0.0, seconds - 0.6, 0.2):
        t = np.arange(round(0.6 * RATE)) / RATE
        hertz = 110.0 * 2 ** (rng.integers(0, 48) / 12)
        note = sum(np.sin(2 * np.pi * hertz * k * t) / k for k in range(1, 6)) * np.exp(-5 * t)
        first = round(start_s * RATE)
        out[first : first + len(t)] += 0.1 * note.astype(np.float32)
    return out


def quoting():
    """Eight seconds of one piece, from 12 s on, are in another from 5.3 s on."""
    shared = notes(5, SHARED_S)
    return {
        "b": np.concatenate([notes(1, 12.0), shared, notes(2, 14.0)]),
        "a": np.concatenate([notes(3, 5.3), shared * 0.7, notes(4, 12.7)]),
        "c": notes(6, 20.0),
    }


def indexed(sounds):
    index = Index()
    for name, samples in sorted(sounds.items()):
        index.add(name, samples, RATE)
    return index


@pytest.fixture(scope="module")
def index():
    made = indexed(quoting())
    made.shared = find_passages(made)
    return made


def test_a_shared_passage_is_named_with_both_places(index):
    (passage,) = index.shared
    assert (passage.one, passage.other) == ("a", "b")
    assert passage.one_s == pytest.approx(5.3, abs=1.1)
    assert passage.other_s - passage.one_s == pytest.approx(12.0 - 5.3, abs=0.05)
    assert passage.seconds == pytest.approx(SHARED_S, abs=2.1)


def test_tracks_that_share_nothing_name_nothing():
    assert find_passages(indexed({str(seed): notes(seed, 20.0) for seed in range(4)})) == ()
    assert find_passages(indexed({"alone": notes(0, 20.0)})) == ()


def test_another_track_asks_only_what_concerns_it_and_finds_the_same(index):
    for new in "abc":
        late = indexed(quoting())
        rest = [number for number, name in enumerate(index.names) if name != new]
        late.shared = index.subset(rest).shared
        assert update_passages(late, [new]) == index.shared
    assert update_passages(index, []) == index.shared


def test_passages_are_kept_in_the_index(index, tmp_path):
    index.save(tmp_path / "index.bin")
    assert Index.load(tmp_path / "index.bin").shared == index.shared
    indexed(quoting()).save(tmp_path / "old.bin")
    assert Index.load(tmp_path / "old.bin").shared is None


def test_a_track_that_is_gone_shares_nothing(index):
    assert index.subset([1, 2]).shared == ()


def test_a_window_has_twins_only_inside_the_passage():
    twins = Twins(["x", "y"], [Passage("x", 10.0, "y", 40.0, 8.0)])
    assert twins.of(0, 12.0, 5.0) == {1}
    assert twins.of(1, 42.0, 5.0) == {0}
    assert twins.of(0, 16.0, 5.0) == twins.of(1, 12.0, 5.0) == set()


def test_build_add_and_show_say_what_is_shared(tmp_path, capsys, monkeypatch):
    import soundfile

    from downbeat.catalog.beatgrid import BeatGrid

    monkeypatch.setattr(catalog_build, "cached_grid", lambda _recording, _say: BeatGrid(120.0))
    audio, out = tmp_path / "audio", tmp_path / "out"
    audio.mkdir()
    sounds = quoting()
    for name in "bc":
        soundfile.write(audio / f"{name}.wav", sounds[name], RATE)
    catalog_tools.build(audio, out, 0)
    assert "is in" not in capsys.readouterr().out
    soundfile.write(tmp_path / "a.wav", sounds["a"], RATE)
    catalog_tools.add(out, tmp_path / "a.wav", 0)
    said = capsys.readouterr().out
    assert "'a' 0:0" in said and " is in 'b' 0:1" in said
    catalog_tools.show(out)
    assert " is in 'b' 0:1" in capsys.readouterr().out
