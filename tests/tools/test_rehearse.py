"""The rehearsal of what speech may ask for, beside what the music does."""

import json

import pytest

from downbeat.catalog.tracks import BUNDLED_TRACKS, load_tracks
from downbeat.control.atlas import Atlas
from downbeat.tools import rehearse
from downbeat.tools.rehearse import Rehearsals, run_rehearse, skills_in, spoken_changes
from downbeat.tools.show import load_show, show_atlas, show_speech

TRACKS = load_tracks(BUNDLED_TRACKS)
DANCED = set().union(*(skills_in(track) for track in TRACKS.values()))
UNDANCED = ("walk", "wave")


@pytest.fixture
def show(tmp_path):
    """show.toml of the bundled tracks, whose speech may ask for a wave and the twist."""
    (tmp_path / "speech.toml").write_text('skills = ["wave", "twist"]\n')
    path = tmp_path / "show.toml"
    path.write_text(
        f'audio = "x.wav"\nindex = "i"\ntracks = "{BUNDLED_TRACKS}"\nspeech = "speech.toml"\n'
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
