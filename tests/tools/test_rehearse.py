"""The rehearsal of what speech may ask for, beside what the music does; what is not there."""

import json

import numpy as np
import pytest
import soundfile

from downbeat.catalog.tracks import BUNDLED_TRACKS, load_tracks
from downbeat.control.atlas import Atlas
from downbeat.perception.index import Index
from downbeat.tools import rehearse
from downbeat.tools.rehearse import Rehearsals, run_rehearse, skills_in, spoken_changes
from downbeat.tools.rehearse_rows import AMBER, GREEN, RED, Row, indirect
from downbeat.tools.show import load_show, show_atlas, show_speech

TRACKS = load_tracks(BUNDLED_TRACKS)
DANCED = set().union(*(skills_in(track) for track in TRACKS.values()))
UNDANCED = ("walk", "wave")
RATE = 16_000


@pytest.fixture(scope="module")
def sounds(tmp_path_factory):
    """A sound file, and an index that has something by the name of every bundled track."""
    folder = tmp_path_factory.mktemp("sounds")
    noise = 0.1 * np.random.default_rng(0).standard_normal(3 * RATE).astype(np.float32)
    soundfile.write(folder / "x.wav", noise, RATE)
    index = Index()
    for name in TRACKS:
        index.add(name, noise, RATE)
    index.save(folder / "index.bin")
    return folder


@pytest.fixture
def show(tmp_path, sounds):
    """show.toml of the bundled tracks, whose speech may ask for a wave and the twist."""
    (tmp_path / "speech.toml").write_text('skills = ["wave", "twist"]\n')
    path = tmp_path / "show.toml"
    path.write_text(
        f'audio = "{sounds}/x.wav"\nindex = "{sounds}/index.bin"\n'
        f'tracks = "{BUNDLED_TRACKS}"\nspeech = "speech.toml"\n'
    )
    return path


def rows_of(path, capsys):
    code = run_rehearse(path, 64, True)
    return code, json.loads(capsys.readouterr().out)


def test_into_and_out_of_what_speech_asks_for_every_change_is_rehearsed(show, capsys):
    assert not DANCED & set(UNDANCED)
    code, rows = rows_of(show, capsys)
    assert code == 0
    spoken = {(row["source"], row["target"]) for row in rows if row["asked_by"] == "speech"}
    for skill in ("wave", "talk", "stand"):  # a command, the gesture of an answer, a stop
        for danced in DANCED:
            assert {(danced, skill), (skill, danced)} <= spoken
    assert {("wave", "talk"), ("talk", "wave"), ("stand", "wave")} <= spoken
    pairs = [(row["source"], row["target"]) for row in rows]
    assert len(set(pairs)) == len(pairs)  # the twist is danced anyway
    assert not any("walk" in pair for pair in pairs)  # speech may not ask for it
    show.write_text(show.read_text().replace('speech = "speech.toml"\n', ""))
    assert {row["asked_by"] for row in rows_of(show, capsys)[1]} == {"music"}


def test_a_spoken_skill_that_is_not_proven_fails_the_rehearsal(show, capsys, monkeypatch):
    whole = show_atlas(load_show(show))
    cells = [cell for cell in whole.cells.values() if cell.target != "wave"]
    monkeypatch.setattr(rehearse, "show_atlas", lambda show: Atlas(cells, whole.meta))
    assert run_rehearse(show, 64, False) == 1
    said = " ".join(capsys.readouterr().out.split())
    count = len(DANCED) + 2  # stand and talk, too
    assert f"by speech any of {count} wave direct from 0 of {count}" in said
    assert said.count("never swept (downbeat sweep); not through stand either") == 1
    assert f"{count} not proven of" in said


def test_with_a_set_list_only_what_it_plays_is_danced_before(show):
    track = TRACKS["neon_parade"]
    (show.parent / "set.toml").write_text(
        f'[[set]]\ntrack = "neon_parade"\nfrom_s = 0.0\nseconds = {track.duration_s!r}\n'
    )
    show.write_text(show.read_text() + 'set_list = "set.toml"\n')
    opened = load_show(show)
    rows = Rehearsals(opened, show_atlas(opened), 64).spoken_rows(show_speech(opened))
    played = skills_in(track)
    assert {row.source for row in rows} == {*played, "wave", "twist", "talk", "stand"}
    assert {row.state for row in rows} <= {"direct", "via_stand"}


def test_spoken_changes_are_into_and_out_of_what_is_spoken_for():
    assert set(spoken_changes(("wave",), ("disco", "sway"))) == {
        ("disco", "wave"), ("sway", "wave"), ("stand", "wave"), ("wave", "disco"), ("wave", "sway"),
        ("wave", "stand"), ("stand", "disco"), ("stand", "sway"), ("disco", "stand"),
        ("sway", "stand"),
    }  # fmt: skip


def faults_of(path, capsys):
    assert run_rehearse(path, 64, True) == 2
    said = capsys.readouterr()
    assert said.out == ""
    return said.err.splitlines()


def test_every_file_that_a_show_names_and_is_not_there_is_named_with_its_key(show, capsys):
    show.write_text(
        'audio = "no.ogg"\ntracks = "no"\nindex = "no.bin"\nset_list = "no.toml"\n'
        'hearing = "none.toml"\nspeech = "none.toml"\nimported = "none"\nfallback = "moonwalk"\n'
        'atlas = "none"\ntransitions = "soft"\n'
    )
    lines = faults_of(show, capsys)
    for key in ("audio", "tracks", "index", "set_list", "hearing", "speech", "transitions"):
        assert sum(f"({show}:{key})" in line for line in lines) == 1, (key, lines)
    assert all(line.startswith("downbeat: ") and line.endswith(".") for line in lines)
    show.write_text(show.read_text().replace('imported = "none"\n', ""))
    assert any("'moonwalk' is unknown" in line for line in faults_of(show, capsys))


def test_a_sound_that_cannot_be_read_and_a_damaged_index_are_named(show, capsys, tmp_path):
    (tmp_path / "letter.wav").write_text("no sound")
    (tmp_path / "letter.bin").write_text("no index")
    show.write_text(f'audio = "letter.wav"\nindex = "letter.bin"\ntracks = "{BUNDLED_TRACKS}"\n')
    sound, index = faults_of(show, capsys)
    assert "letter.wav" in sound and sound.endswith(f"({show}:audio).")
    assert "letter.bin" in index and index.endswith(f"({show}:index).")


def test_a_microphone_is_no_file_and_is_not_looked_for(show, sounds):
    show.write_text(show.read_text().replace(f"{sounds}/x.wav", "mic:"))
    assert run_rehearse(show, 64, True) == 0


def test_tracks_that_the_index_lacks_would_never_be_recognised(show, capsys, tmp_path):
    index = Index()
    noise = np.random.default_rng(1).standard_normal(3 * RATE).astype(np.float32)
    index.add("neon_parade", noise, RATE)
    index.save(tmp_path / "one.bin")
    show.write_text(f'audio = "mic:"\nindex = "one.bin"\ntracks = "{BUNDLED_TRACKS}"\n')
    (line,) = faults_of(show, capsys)
    assert "'midnight_bones', 'salsa_del_puerto', 'tide_runner'" in line and ":index)" in line


def test_passages_of_a_set_list_that_do_not_exist_are_named_entry_by_entry(show, capsys):
    length_s = TRACKS["neon_parade"].duration_s
    (show.parent / "set.toml").write_text(
        "".join(
            f'[[set]]\ntrack = "{track}"\nfrom_s = {from_s}\nseconds = {seconds}\n'
            for track, from_s, seconds in (
                ("neon_parade", 0.0, length_s),
                ("neon_parody", 0.0, 10.0),
                ("neon_parade", length_s + 1.0, 10.0),
                ("neon_parade", length_s - 5.0, 10.0),
            )
        )
    )
    show.write_text(show.read_text() + 'set_list = "set.toml"\n')
    lines = faults_of(show, capsys)
    wrong = ((1, "track"), (2, "from_s"), (3, "seconds"))
    for line, (number, key) in zip(lines, wrong, strict=True):
        assert f"set.toml:set[{number}].{key})" in line
    assert "tracks are midnight_bones, neon_parade" in lines[0]
    assert f"valid are positions below {length_s:.1f} s" in lines[1]
    assert "valid are 5.0 seconds or less" in lines[2]


def test_a_track_file_without_a_length_has_that_of_the_index(show, capsys, sounds):
    tracks = show.parent / "tracks"
    tracks.mkdir()
    (tracks / "neon.toml").write_text(
        'name = "neon_parade"\ncomposition = "neon_parade"\ndefault_skill = "kpop"\n'
    )
    set_list = show.parent / "set.toml"
    show.write_text(
        f'audio = "mic:"\nindex = "{sounds}/index.bin"\ntracks = "tracks"\nset_list = "set.toml"\n'
    )
    entry = '[[set]]\ntrack = "neon_parade"\nfrom_s = 0.0\nseconds = {}\n'
    set_list.write_text(entry.format(3.0))
    assert run_rehearse(show, 64, True) == 0
    capsys.readouterr()
    set_list.write_text(entry.format(3.5))
    (line,) = faults_of(show, capsys)
    assert "set[0].seconds" in line


def test_what_is_not_direct_is_said_in_a_line_per_reason(show, capsys):
    rows = [
        Row(None, "kpop", "walk", AMBER, "via stand", 0.0, 0, 0, "no proven slot"),
        Row(None, "kpop", "twist", AMBER, "via stand", 0.0, 0, 0, "no proven slot"),
        Row(None, "disco", "walk", AMBER, "via stand", 0.0, 0, 0, "no proven slot"),
        Row(None, "disco", "wave", RED, "via stand", 0.0, 0, 0, "never swept"),
        Row(None, "disco", "kpop", GREEN, "fade_0.3", 0.0, 0, 0),
        Row(9.0, "disco", "pump", AMBER, "via stand", 0.0, 0, 0, "in the order of the show"),
        Row(None, "disco", "talk", AMBER, "via stand", 0.0, 0, 0, "x", asked_by="speech"),
    ]
    assert indirect(rows) == [
        "not proven (never swept): disco to wave",
        "through stand (no proven slot): kpop to walk, twist; disco to walk",
    ]
    show.write_text(show.read_text().replace('speech = "speech.toml"\n', ""))
    assert run_rehearse(show, 64, False) == 0
    said = capsys.readouterr().out
    count = int(said.split(" through stand, ")[0].split()[-1])
    assert count > 0
    lines = [line for line in said.splitlines() if line.startswith("through stand (")]
    pairs = [to for line in lines for to in line.split("): ")[1].replace(";", ",").split(",")]
    assert len(pairs) == count
