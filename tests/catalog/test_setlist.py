"""Set lists: strict files, and a file survives its writer."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from downbeat.catalog.setlist import SetEntry, SetList, load_setlist
from downbeat.runtime.errors import DownbeatError

names = st.text(st.characters(codec="utf-8", exclude_characters="\x7f"), min_size=1, max_size=12)
entries = st.builds(SetEntry, names, st.floats(0, 1e4), st.floats(0.01, 1e4))
ENTRY = '[[set]]\ntrack = "one"\nfrom_s = 1.0\nseconds = 20.0\n'


@given(st.lists(entries, min_size=1, max_size=5))
def test_written_set_list_is_read_back_exactly(tmp_path_factory, rows):
    path = tmp_path_factory.mktemp("set") / "set.toml"
    show = SetList(tuple(rows))
    path.write_text(show.to_toml(), encoding="utf-8")
    assert load_setlist(path) == show


@given(st.lists(entries, min_size=1, max_size=8))
def test_each_entry_starts_where_the_one_before_ends(rows):
    starts = SetList(tuple(rows)).starts_s()
    ends = [start + row.seconds for start, row in zip(starts, rows)]
    assert starts[0] == 0.0
    assert starts[1:] == pytest.approx(ends[:-1])


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "set is missing"),
        ("set = 3\n", "set is 3"),
        ("set = []\n", r"no \[\[set\]\] entry"),
        (ENTRY + "loud = true\n", r"set\[0\].loud is not known here; known are from_s, seconds"),
        (ENTRY.replace("20.0", '"long"'), r"set\[0\].seconds is 'long', valid is a number"),
        (ENTRY.replace("20.0", "0.0"), "valid are from_s >= 0 and seconds > 0"),
        (ENTRY.replace("1.0", "nan"), "valid are from_s >= 0 and seconds > 0"),
        (ENTRY + ENTRY.replace("one", "two"), r"'two' is not in the catalogue; tracks are one"),
        ("=", "is not TOML"),
    ],
)
def test_wrong_set_list_is_one_sentence_with_file_and_key(tmp_path, text, complaint):
    path = tmp_path / "set.toml"
    path.write_text(text)
    with pytest.raises(DownbeatError, match=complaint) as caught:
        load_setlist(path, ["one"])
    assert "set.toml" in str(caught.value)


def test_missing_set_list_is_named(tmp_path):
    with pytest.raises(DownbeatError, match="none.toml cannot be read"):
        load_setlist(tmp_path / "none.toml")
