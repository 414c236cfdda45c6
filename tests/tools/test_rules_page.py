"""docs/timed_rules.md and the code name the same keys; commands of one's own show exist."""

import re
import shlex
import tomllib
from pathlib import Path

import pytest
import tyro

from downbeat.catalog.errors import CatalogError
from downbeat.catalog.tracks import _SECTION_KEYS, _TRACK_KEYS, load_track, parse_track
from downbeat.tools.cli import Command
from downbeat.tools.show import ShowConfig

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE, SHOW_PAGE = DOCS / "timed_rules.md", DOCS / "show_toml.md"
REQUIRED = ("name", "default_skill")


def blocks_of(page):
    return re.findall(r"^```toml\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)


@pytest.fixture(scope="module")
def blocks():
    """A track with its recording and rules, and one without."""
    return blocks_of(PAGE)


def test_every_key_of_a_track_file_is_on_its_page_and_explained(blocks):
    whole, short = (tomllib.loads(block) for block in blocks)
    assert sorted({**whole, **short}) == sorted(_TRACK_KEYS)
    assert sorted(whole["section"][0]) == sorted(_SECTION_KEYS)
    first = blocks[0].split("[[section]]")
    for line in (first[0] + first[1]).splitlines():
        assert not line or re.match(r"\w+ = .* # \S", line), line


def test_what_may_be_left_out_has_the_default_that_the_page_tells(blocks, tmp_path):
    told = dict(re.findall(r"^(\w+) = .*left out: (?:the |it )?(\w+)", blocks[0], re.MULTILINE))
    short = tomllib.loads(blocks[1])
    track = parse_track(short, "song.toml", tmp_path)
    grid = track.grid
    assert told.pop("title") == "name" and track.title == track.name
    assert told.pop("duration_s") == "endless" and track.duration_s == float("inf")
    assert told.pop("beat_times_s") == "is" and grid.beat_times_s == ()
    numbers = {key: float(told.pop(key)) for key in ("tempo_bpm", "first_beat_s", "beats_per_bar")}
    assert numbers == {key: getattr(grid, key) for key in numbers}
    section = {"start_s": 1.0, "end_s": 2.0, "skill": "sway"}
    (rule,) = parse_track({**short, "section": [section]}, "song.toml", tmp_path).rules
    assert told == {"name": "none"} and rule.name == ""
    for key in (*REQUIRED, "composition"):
        assert f"`{key}`" in PAGE.read_text()
        with pytest.raises(CatalogError, match=key.replace("composition", "either 'audio'")):
            parse_track({k: v for k, v in short.items() if k != key}, "song.toml", tmp_path)
    for key in section:
        with pytest.raises(CatalogError, match=f"'{key}' is missing"):
            lacking = {k: v for k, v in section.items() if k != key}
            parse_track({**short, "section": [lacking]}, "song.toml", tmp_path)


def test_what_the_page_shows_is_read_and_its_rules_stand_on_downbeats(blocks, tmp_path):
    (tmp_path / "song.ogg").write_bytes(b"")
    (tmp_path / "song.toml").write_text(blocks[0])
    track = load_track(tmp_path / "song.toml")
    assert [track.skill_at(t) for t in (1.0, 2.28, 11.41, 11.42, 20.57)] == [
        "disco", "sway", "sway", "kpop", "disco",
    ]  # fmt: skip
    bars = [track.grid.beats_at(rule.start_s) / track.grid.beats_per_bar for rule in track.rules]
    assert bars == pytest.approx([0.0, 4.0], abs=0.01)
    assert "a bar has 2.286 s, and 11.42 s is bar 4" in PAGE.read_text()
    assert track.grid.beats_per_bar * 60.0 / track.grid.tempo_bpm == pytest.approx(2.286, abs=5e-4)


def test_the_show_of_ones_own_names_keys_and_commands_that_exist():
    text = SHOW_PAGE.read_text().split("## A show of your own")[1]
    (block,) = re.findall(r"^```toml\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    ShowConfig(**tomllib.loads(block))
    lines = re.findall(r"^    (downbeat .*)$", text, re.MULTILINE)
    lines += re.findall(r"`(downbeat [^`]* [^`]*)`", text.replace("\n", " "))
    commands = [shlex.split(line.split("#")[0].replace("&", ""))[1:] for line in lines]
    assert len(commands) > 12
    for argv in commands:
        tyro.cli(
            Command, args=argv, config=(tyro.conf.OmitSubcommandPrefixes, tyro.conf.OmitArgPrefixes)
        )


def test_pages_that_it_points_to_exist():
    for name in re.findall(r"\(((?:\w+)\.md)\)", PAGE.read_text()):
        assert (DOCS / name).is_file(), name
