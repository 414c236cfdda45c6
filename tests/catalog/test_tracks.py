"""Track files: rules, resolver, errors that name file and key."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from downbeat.catalog.beatgrid import BeatGrid
from downbeat.catalog.errors import CatalogError
from downbeat.catalog.setlist import SetEntry, SetList, load_setlist
from downbeat.catalog.tracks import Rule, Track, load_tracks
from downbeat.policies.manifest import load_skills

HEAD = 'name = "song"\ncomposition = "song"\ndefault_skill = "sway"\ntempo_bpm = 120.0\n'


def section(start_s, end_s, skill="kpop"):
    return f'[[section]]\nstart_s = {start_s}\nend_s = {end_s}\nskill = "{skill}"\n'


@st.composite
def tracks(draw):
    edges = sorted(draw(st.lists(st.integers(0, 100), min_size=2, max_size=12, unique=True)))
    pairs = list(zip(edges[::2], edges[1::2]))
    skills = draw(st.lists(st.sampled_from("abc"), min_size=len(pairs), max_size=len(pairs)))
    rules = tuple(Rule(float(a), float(b), s) for (a, b), s in zip(pairs, skills))
    return Track("song", "default", BeatGrid(120.0), rules)


@given(tracks(), st.floats(0, 100))
def test_first_matching_rule_decides_else_the_default(track, tau_s):
    matching = [r.skill for r in track.rules if r.start_s <= tau_s < r.end_s]
    assert track.skill_at(tau_s) == (matching[0] if matching else "default")


@given(tracks(), st.floats(0, 60), st.floats(1, 40))
def test_sections_cover_the_passage_without_gap_or_overlap(track, start_s, length_s):
    rows = track.sections(start_s, start_s + length_s)
    assert rows[0][0] == start_s
    assert rows[-1][1] == pytest.approx(start_s + length_s)
    for (_, end_s, skill), (next_start_s, _, next_skill) in zip(rows, rows[1:]):
        assert end_s == next_start_s
        assert skill != next_skill
    for begin_s, end_s, skill in rows:
        assert track.skill_at(0.5 * (begin_s + end_s)) == skill


def test_bundled_tracks_name_only_bundled_skills():
    assert len(load_tracks(skills=load_skills())) == 4


def test_bundled_sections_stand_on_the_bars_of_the_pieces():
    from downbeat.tools.composer.store import form

    for name, track in load_tracks().items():
        piece = form(track.composition)
        assert track.grid.tempo_bpm == piece.bpm, name
        rows = [(rule.name, rule.start_s, rule.end_s) for rule in track.rules]
        for row, want in zip(rows, piece.times_s(), strict=True):
            assert row[0] == want[0]
            assert row[1:] == pytest.approx(want[1:], abs=2e-3)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (HEAD + section(5, 10) + section(8, 12), r"overlaps .*song.toml:section\[1\]"),
        (HEAD + section(5, 5), "start_s must be below end_s"),
        (HEAD + 'colour = "red"\n', "known are .*tempo_bpm.*song.toml:colour"),
        (HEAD.replace('"sway"', "3"), "default_skill' is 3 but must be str"),
        (HEAD.replace("120.0", "0.0"), "valid are 30"),
        (HEAD.replace('name = "song"\n', ""), "'name' is missing"),
        (HEAD.replace("composition", "audio"), "Audio file .* does not exist .*song.toml:audio"),
        (HEAD + section(0, 5, "moonwalk"), r"Skill 'moonwalk' is unknown; skills are kpop, sway"),
        (HEAD + "[[section]]\nstart_s = 1.0\n", "'end_s' is missing"),
        ("= nonsense", "not valid TOML"),
    ],
)
def test_wrong_track_file_is_one_clear_sentence(tmp_path, text, complaint):
    (tmp_path / "song.toml").write_text(text)
    with pytest.raises(CatalogError, match=complaint):
        load_tracks(tmp_path, ["sway", "kpop"])


def test_set_list_survives_its_file(tmp_path):
    show = SetList((SetEntry("a", 1.5, 20.0), SetEntry("b", 0.0, 10.0)))
    (tmp_path / "set.toml").write_text(show.to_toml())
    assert load_setlist(tmp_path / "set.toml", {"a", "b"}) == show
    assert show.starts_s() == [0.0, 20.0]


def test_set_list_with_an_unknown_track_says_where(tmp_path):
    (tmp_path / "set.toml").write_text(SetList((SetEntry("a", 0.0, 5.0),)).to_toml())
    with pytest.raises(CatalogError, match=r"set\[0\].track"):
        load_setlist(tmp_path / "set.toml", {"b"})
