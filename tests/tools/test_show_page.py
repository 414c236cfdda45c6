"""docs/show_toml.md and the code name the same keys, with the same defaults."""

import dataclasses
import re
import tomllib
from pathlib import Path

import pytest

from downbeat.catalog.setlist import SetEntry, SetList, load_setlist
from downbeat.runtime.config import ConfigError, load_config
from downbeat.tools.show import TRANSITIONS, ShowConfig

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = DOCS / "show_toml.md"
FIELDS = {field.name: field for field in dataclasses.fields(ShowConfig)}
REQUIRED = {name for name, field in FIELDS.items() if field.default is dataclasses.MISSING}


@pytest.fixture(scope="module")
def blocks():
    """The page's TOML: a show and a set list."""
    return re.findall(r"^```toml\n(.*?)^```", PAGE.read_text(), re.DOTALL | re.MULTILINE)


def test_every_key_of_a_show_is_on_its_page_with_its_default(blocks):
    told = tomllib.loads(blocks[0])
    assert sorted(told) == sorted(FIELDS)
    assert {name: told[name] for name in FIELDS.keys() - REQUIRED} == {
        name: field.default for name, field in FIELDS.items() if name not in REQUIRED
    }
    assert all(f"`{name}`" in PAGE.read_text() for name in REQUIRED)


def test_every_key_is_explained_where_it_stands(blocks):
    lines = [line for line in blocks[0].splitlines() if re.match(r"\w+ = ", line)]
    assert all(re.search(r" # \S", line) for line in lines), lines
    transitions = next(line for line in lines if line.startswith("transitions"))
    assert all(f'"{word}"' in transitions for word in TRANSITIONS)


def test_what_the_page_shows_can_be_read(blocks, tmp_path):
    (tmp_path / "show.toml").write_text(blocks[0])
    (tmp_path / "set.toml").write_text(blocks[1])
    (entry,) = tomllib.loads(blocks[1])["set"]
    assert sorted(entry) == sorted(field.name for field in dataclasses.fields(SetEntry))
    assert isinstance(load_config(tmp_path / "show.toml", ShowConfig), ShowConfig)
    assert isinstance(load_setlist(tmp_path / "set.toml", {"neon_parade"}), SetList)
    (tmp_path / "show.toml").write_text(blocks[0] + "volume = 1\n")
    with pytest.raises(ConfigError, match=r"volume is not known here; known are atlas, .*, tracks"):
        load_config(tmp_path / "show.toml", ShowConfig)


def test_pages_that_it_points_to_exist():
    for name in re.findall(r"\((\w+\.md)\)", PAGE.read_text()):
        assert (DOCS / name).is_file(), name
