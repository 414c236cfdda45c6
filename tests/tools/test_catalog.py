"""Catalogues kept up to date: what changed and nothing else, the same as from nothing."""

import json
import re
import shutil

import numpy as np
import pytest
import soundfile

from downbeat.perception.errors import PerceptionError
from downbeat.perception.index import Index
from downbeat.perception.likeness_build import LIKENESS_NAME
from downbeat.perception.likeness_store import LikenessTable
from downbeat.policies.manifest import BUNDLED_SKILLS
from downbeat.runtime.errors import DownbeatError
from downbeat.tools import catalog_build, catalog_tools
from downbeat.tools.catalog_build import add_track, index_path, remove_track, update_catalog
from downbeat.tools.duplicates import find_duplicates
from downbeat.tools.errors import ToolError
from downbeat.tools.recordings import INDEX_NAME

RATE = 16_000
DANCES = ["disco", "salsastep", "thriller"]


def song(seed, seconds=12.0):
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


@pytest.fixture
def audio(tmp_path):
    folder = tmp_path / "audio"
    folder.mkdir()
    for number in range(3):
        soundfile.write(folder / f"song{number}.wav", song(number), RATE)
    return folder


@pytest.fixture
def analysed(monkeypatch):
    """Names of the recordings that were analysed, with beats made up to save time."""
    from downbeat.catalog.beatgrid import BeatGrid

    names = []

    def grid(recording, _say):
        names.append(recording.name)
        return BeatGrid(120.0, 0.0)

    monkeypatch.setattr(catalog_build, "cached_grid", grid)
    return names


def build(audio, out):
    said = []
    index, changes = update_catalog(audio, out, DANCES, 0, said.append, is_quiet=True)
    return index, changes, said


def test_only_new_and_changed_files_are_analysed(audio, tmp_path, analysed):
    out = tmp_path / "out"
    build(audio, out)
    assert sorted(analysed) == ["song0", "song1", "song2"]
    analysed.clear()
    before = (out / INDEX_NAME).stat().st_mtime_ns
    _, changes, _ = build(audio, out)
    assert changes.is_empty and analysed == []
    assert (out / INDEX_NAME).stat().st_mtime_ns == before
    soundfile.write(audio / "song1.wav", song(11), RATE)
    soundfile.write(audio / "song3.wav", song(3), RATE)
    (audio / "song0.wav").unlink()
    _, changes, _ = build(audio, out)
    assert sorted(analysed) == ["song1", "song3"]
    assert (changes.kept, changes.made, changes.dropped) == (
        ["song2"], ["song1", "song3"], ["song0"],
    )  # fmt: skip


def test_updates_equal_a_build_from_nothing_bit_for_bit(audio, tmp_path, analysed):
    out, fresh = tmp_path / "out", tmp_path / "fresh"
    build(audio, out)
    soundfile.write(audio / "aaa.wav", song(8), RATE)
    soundfile.write(audio / "song2.wav", song(12), RATE)
    (audio / "song1.wav").unlink()
    build(audio, out)
    build(audio, fresh)
    assert (out / INDEX_NAME).read_bytes() == (fresh / INDEX_NAME).read_bytes()
    remove_track(out, "aaa")
    assert (out / INDEX_NAME).read_bytes() != (fresh / INDEX_NAME).read_bytes()
    add_track(out, audio / "aaa.wav", DANCES, 0, print)
    assert (out / INDEX_NAME).read_bytes() == (fresh / INDEX_NAME).read_bytes()


def test_a_persons_rules_outlive_an_update(audio, tmp_path, analysed):
    out = tmp_path / "out"
    build(audio, out)
    path = out / "song1.toml"
    text = re.sub(r'default_skill = ".*"', 'default_skill = "wave"', path.read_text())
    rule = '\n[[section]]\nstart_s = 1.0\nend_s = 4.0\nname = "verse"\nskill = "thriller"\n'
    path.write_text(text + rule)
    kept = path.read_text()
    build(audio, out)
    assert path.read_text() == kept
    soundfile.write(audio / "song1.wav", song(1, 14.0), RATE)
    build(audio, out)
    assert '"wave"' in path.read_text() and "duration_s = 14.0" in path.read_text()
    assert '"thriller"' in path.read_text()
    (audio / "song1.wav").unlink()
    build(audio, out)
    assert not path.exists()
    soundfile.write(audio / "song1.wav", song(1, 14.0), RATE)
    build(audio, out)
    assert '"wave"' in path.read_text() and '"thriller"' in path.read_text()


def test_what_is_no_recording_is_left_out_in_one_sentence(audio, tmp_path, analysed):
    (audio / "broken.wav").write_bytes(b"nonsense")
    soundfile.write(audio / "silent.wav", np.zeros(5 * RATE, np.float32), RATE)
    soundfile.write(audio / "song0.flac", song(0), RATE)
    index, changes, _ = build(audio, tmp_path / "out")
    assert index.names == ["song0", "song1", "song2"]
    reasons = " ".join(changes.left_out)
    assert len(changes.left_out) == 3
    for words in ("not an audio file", "silent or shorter", "the name of another recording"):
        assert words in reasons


def test_a_damaged_index_is_said_and_built_again(audio, tmp_path, analysed):
    out = tmp_path / "out"
    build(audio, out)
    good = (out / INDEX_NAME).read_bytes()
    (out / INDEX_NAME).write_bytes(good[:-50])
    analysed.clear()
    _, _, said = build(audio, out)
    assert sorted(analysed) == ["song0", "song1", "song2"]
    assert "damaged" in said[0] and "catalog build" not in said[0]
    assert (out / INDEX_NAME).read_bytes() == good


def test_a_track_of_a_damaged_index_whose_recording_is_gone_is_put_aside(audio, tmp_path, analysed):
    out = tmp_path / "out"
    build(audio, out)
    (audio / "song1.wav").unlink()
    (out / INDEX_NAME).write_bytes((out / INDEX_NAME).read_bytes()[:-50])
    index, changes, _ = build(audio, out)
    assert changes.dropped == ["song1"] and index.names == ["song0", "song2"]
    assert sorted(path.stem for path in out.glob("*.toml")) == index.names
    assert (out / "song1.toml.removed").is_file()


def test_a_folder_without_recordings_is_one_sentence(tmp_path, analysed):
    (tmp_path / "audio").mkdir()
    (tmp_path / "audio" / "a.wav").write_bytes(b"nonsense")
    with pytest.raises(PerceptionError, match="no recording that can be used"):
        build(tmp_path / "audio", tmp_path / "out")


def test_removing_what_is_not_there_names_what_is(audio, tmp_path, analysed):
    out = tmp_path / "out"
    build(audio, out)
    with pytest.raises(ToolError, match="holds song0, song1, song2"):
        remove_track(out, "song9")
    with pytest.raises(ToolError, match="it holds 'song1', named without the ending of its file"):
        remove_track(out, "song1.wav")
    remove_track(out, "song0")
    remove_track(out / INDEX_NAME, "song1")
    with pytest.raises(ToolError, match="only track"):
        remove_track(out, "song2")
    assert Index.load(index_path(out)).names == ["song2"]


def test_the_same_recording_under_two_names_is_named(audio, tmp_path, analysed):
    loud = song(1)[2 * RATE :] * 0.5
    noise = np.random.default_rng(0).standard_normal(len(loud)).astype(np.float32)
    soundfile.write(audio / "copy of 1.wav", loud + 0.005 * noise, RATE)
    index, _, _ = build(audio, tmp_path / "out")
    assert find_duplicates(index) == [("copy of 1", "song1")]


@pytest.mark.parametrize("matcher", ["alignment", "constellation"])
def test_match_prints_its_answer_as_json(audio, tmp_path, analysed, capsys, matcher):
    out = tmp_path / "out"
    build(audio, out)
    code = catalog_tools.match(out, audio / "song2.wav", 3.0, 5.0, True, matcher)
    found = json.loads(capsys.readouterr().out)
    assert code == 0
    assert {"track", "tau_s", "confidence", "votes", "rate", "accepted"} <= set(found)
    assert (found["track"], found["accepted"]) == ("song2", True)
    assert found["tau_s"] == pytest.approx(3.0, abs=0.05)


def test_match_says_where_else_the_track_has_the_passage(audio, tmp_path, analysed, capsys):
    looped = np.concatenate([song(7, 6.0), song(8, 6.0), song(7, 6.0)])
    soundfile.write(audio / "looped.wav", looped, RATE)
    out = tmp_path / "out"
    build(audio, out)
    assert catalog_tools.match(out, audio / "looped.wav", 1.0, 3.0, False, "alignment") == 0
    said = capsys.readouterr().out
    places = re.search(r"looped at ([\d.]+) s.*the track repeats it at ([\d.]+) s", said).groups()
    assert sorted(float(place) for place in places) == pytest.approx([1.0, 13.0], abs=0.05)
    catalog_tools.match(out, audio / "song2.wav", 3.0, 5.0, False, "alignment")
    assert "repeats" not in capsys.readouterr().out


def test_a_catalogue_is_shown_by_its_folder_and_by_its_index(audio, tmp_path, analysed, capsys):
    out = tmp_path / "out"
    build(audio, out)
    said = []
    for where in (out, out / INDEX_NAME):
        assert catalog_tools.show(where) == 0
        said.append(capsys.readouterr().out)
    assert "song1" in said[0] and said[0] == said[1]


def test_a_build_names_what_it_drops(audio, tmp_path, analysed, capsys, monkeypatch):
    monkeypatch.setattr(catalog_tools, "dance_names", lambda: DANCES)
    out = tmp_path / "out"
    catalog_tools.build(audio, out, 0)
    assert "dropped, as" not in capsys.readouterr().out
    (audio / "song1.wav").unlink()
    catalog_tools.build(audio, out, 0)
    said = capsys.readouterr().out
    assert "dropped, as" in said and "rules are put aside: song1" in said


def test_near_its_end_a_recording_is_asked_with_the_rest(audio, tmp_path, analysed, capsys):
    out = tmp_path / "out"
    build(audio, out)
    clip = audio / "song2.wav"  # 12 s
    assert catalog_tools.match(out, clip, 9.0, 5.0, True, "alignment") == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["tau_s"] == pytest.approx(9.0, abs=0.05)
    assert "ends after 3.0 s of the window" in said.err
    catalog_tools.match(out, clip, 11.0, 5.0, True, "alignment")
    assert "ends after 1.0 s" in capsys.readouterr().err
    for at_s, seconds, said in (
        (11.5, 5.0, "no start of a window in .*song2.wav, which lasts 12.0 s; valid are 0 to 11.0"),
        (30.0, 5.0, "--at 30 s is beyond the end of .*song2.wav, which lasts 12.0 s; valid are 0"),
        (-1.0, 5.0, "--at -1 s is no start"),
        (float("nan"), 5.0, "--at nan s is no start"),
        (0.0, 0.5, "--seconds 0.5 is no length of a window; valid are 1 to 10 s"),
    ):
        with pytest.raises(ToolError, match=said):
            catalog_tools.match(out, clip, at_s, seconds, True, "alignment")


def test_a_match_of_a_folder_a_damaged_file_or_a_snippet_says_what_it_is(audio, tmp_path, analysed):
    out = tmp_path / "out"
    build(audio, out)
    (tmp_path / "song.ogg").write_bytes(b"OggS" + bytes(2_000))
    soundfile.write(tmp_path / "snip.wav", song(1)[: RATE // 2], RATE)
    for path, said in (
        (audio, "is a folder, and one audio file is wanted; valid are .wav"),
        (tmp_path / "song.ogg", "cannot be read: it is damaged, or not an audio file in spite of"),
        (tmp_path / "snip.wav", "lasts 0.50 s; valid are recordings of 1 s or more"),
    ):
        with pytest.raises(DownbeatError, match=said):
            catalog_tools.match(out, path, 0.0, 5.0, True, "alignment")


def test_what_tracks_sound_like_is_kept_up_to_date_beside_the_index(
    audio, tmp_path, analysed, capsys
):
    out = tmp_path / "catalog"
    catalog_tools.build(audio, out, 0)
    before = LikenessTable.load(out / LIKENESS_NAME)
    assert before.names == ["song0", "song1", "song2"]
    soundfile.write(audio / "song1.wav", song(7), RATE)
    catalog_tools.build(audio, out, 0)
    after = LikenessTable.load(out / LIKENESS_NAME)
    assert [a == b for a, b in zip(after.sounds, before.sounds)] == [True, False, True]
    catalog_tools.remove(out, "song0")
    soundfile.write(tmp_path / "song9.wav", song(9), RATE)
    catalog_tools.add(out, tmp_path / "song9.wav", 0)
    assert LikenessTable.load(out / LIKENESS_NAME).names == ["song1", "song2", "song9"]
    with pytest.raises(PerceptionError, match="clap"):
        catalog_tools.build(audio, out, 0, clap=tmp_path)


def test_skills_that_do_not_exist_are_named_where_a_catalogue_is_shown(tmp_path, capsys):
    (tmp_path / "song.toml").write_text(
        'name = "song"\ncomposition = "song"\ndefault_skill = "moonwalk"\n'
        '[[section]]\nstart_s = 0.0\nend_s = 5.0\nskill = "kpop"\n'
        '[[section]]\nstart_s = 5.0\nend_s = 9.0\nskill = "kpopp"\n'
    )
    assert catalog_tools.show(tmp_path) == 0
    said = capsys.readouterr().out
    assert (
        f"'kpopp' does not exist, so no show can play it ({tmp_path}/song.toml:section[1]" in said
    )
    assert (
        f"'moonwalk' does not exist, so no show can play it ({tmp_path}/song.toml:default" in said
    )
    assert "'kpop' does not" not in said and said.count("Skills are armwave, boxstep") == 1
    own = tmp_path / "own" / "moonwalk"
    shutil.copytree(BUNDLED_SKILLS / "stand", own)
    manifest = (own / "manifest.toml").read_text()
    (own / "manifest.toml").write_text(manifest.replace('name = "stand"', 'name = "moonwalk"', 1))
    catalog_tools.show(tmp_path, imported=tmp_path / "own")
    said = capsys.readouterr().out
    assert "'kpopp' does not exist" in said and "'moonwalk' does not exist" not in said
    catalog_tools.show(None)
    assert "does not exist" not in capsys.readouterr().out
