"""The index: on disk and back, and every damage noticed."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_music import RATE, make_music

from downbeat.perception import features as ft
from downbeat.perception.errors import PerceptionError
from downbeat.perception.index import Index, coarse_of_fine, power_of_fine
from downbeat.perception.index_file import HEAD, read_index


@pytest.fixture(scope="module")
def small():
    """Two short tracks."""
    index = Index()
    index.add("one", make_music(1, 4.0), RATE, "digest of one")
    index.add("two, «quoted»", make_music(2, 5.0), RATE)
    return index


@pytest.fixture(scope="module")
def content(small, tmp_path_factory):
    """The bytes of the index of two short tracks."""
    path = tmp_path_factory.mktemp("index") / "index.bin"
    small.save(path)
    return path.read_bytes()


@pytest.fixture
def written(content, tmp_path):
    """Write changed bytes and return their path."""

    def write(changed):
        path = tmp_path / "index.bin"
        path.write_bytes(changed)
        return path

    return write


def same(one, other):
    return (
        (one.names, one.sources) == (other.names, other.sources)
        and all(np.array_equal(a, b) for a, b in zip(one.fine, other.fine, strict=True))
        and all(np.array_equal(a, b) for a, b in zip(one.coarse, other.coarse, strict=True))
        and all(np.array_equal(a, b) for a, b in zip(one.power, other.power, strict=True))
    )


def test_round_trip_keeps_everything(small, written, content):
    loaded = read_index(written(content))
    assert same(loaded, small)
    assert [len(found) > 100 for found in loaded.landmarks] == [True, True]


@given(
    lengths=st.lists(st.integers(1, 9), min_size=1, max_size=5),
    seed=st.integers(0, 1000),
    names=st.lists(st.text(min_size=1, max_size=8), min_size=5, max_size=5, unique=True),
)
@settings(max_examples=15)
def test_any_features_survive_the_round_trip(lengths, seed, names, tmp_path_factory):
    rng = np.random.default_rng(seed)
    fine = [rng.integers(-64, 128, (4 * n, ft.NUM_BANDS)).astype(np.int8) for n in lengths]
    coarse, power = [coarse_of_fine(f) for f in fine], [power_of_fine(f) for f in fine]
    index = Index(names[: len(fine)], fine, coarse, power, [""] * len(fine))
    path = tmp_path_factory.mktemp("index") / "index.bin"
    index.save(path)
    assert same(read_index(path), index)


@given(share=st.floats(0.0, 1.0, exclude_max=True))
@settings(max_examples=40)
def test_truncation_anywhere_is_one_sentence(content, tmp_path_factory, share):
    path = tmp_path_factory.mktemp("cut") / "index.bin"
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(PerceptionError, match="catalog build"):
        read_index(path)


@given(place=st.floats(0.0, 1.0, exclude_max=True), bit=st.integers(0, 7))
@settings(max_examples=80)
def test_a_flipped_bit_anywhere_is_noticed(content, tmp_path_factory, place, bit):
    changed = bytearray(content)
    changed[int(place * len(content))] ^= 1 << bit
    path = tmp_path_factory.mktemp("flip") / "index.bin"
    path.write_bytes(changed)
    with pytest.raises(PerceptionError, match="catalog build"):
        read_index(path)


def test_every_byte_of_the_head_is_guarded(content, written):
    for place in range(HEAD.size):
        changed = bytearray(content)
        changed[place] ^= 0x10
        with pytest.raises(PerceptionError, match="catalog build"):
            read_index(written(changed))


@pytest.mark.parametrize(
    ("bad", "word"),
    [
        (b"", "not an index"),
        (b"nonsense", "not an index"),
        (b"PK\3\4 an archive", "older version"),
        (b"downbeat index\n\x1a", "damaged"),
    ],
)
def test_foreign_and_old_files_say_so(written, bad, word):
    with pytest.raises(PerceptionError, match=f"{word}.*catalog build"):
        read_index(written(bad))


def test_a_missing_index_is_one_sentence(tmp_path):
    with pytest.raises(PerceptionError, match=r"does not exist.*catalog build"):
        Index.load(tmp_path / "index.bin")


def test_features_of_other_constants_are_refused(content, written, monkeypatch):
    monkeypatch.setattr("downbeat.perception.features.FLOOR", 0.3)
    with pytest.raises(PerceptionError, match=r"other features.*catalog build"):
        read_index(written(content))


def test_a_large_index_is_checked_when_touched(content, written, monkeypatch):
    monkeypatch.setattr("downbeat.perception.index_file.EAGER_BYTES", 0)
    changed = bytearray(content)
    changed[HEAD.size + ft.NUM_BANDS * 40] ^= 1  # in the first track
    loaded = read_index(written(changed))
    assert loaded.fine[1].shape[1] == ft.NUM_BANDS
    with pytest.raises(PerceptionError, match=r"number 0 .*catalog build"):
        loaded.fine[0]


def test_a_write_that_fails_leaves_the_old_index(small, tmp_path, monkeypatch):
    path = tmp_path / "index.bin"
    small.save(path)
    before = path.read_bytes()
    monkeypatch.setattr("os.fsync", lambda _number: (_ for _ in ()).throw(OSError(28, "disk full")))
    with pytest.raises(PerceptionError, match="disk full"):
        small.save(path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["index.bin"]


def test_an_index_in_use_may_be_replaced(small, tmp_path):
    path = tmp_path / "index.bin"
    small.save(path)
    loaded = Index.load(path)
    small.subset([0]).save(path)
    assert np.array_equal(loaded.fine[1], small.fine[1])
    assert Index.load(path).names == ["one"]


def test_an_empty_index_is_not_written(tmp_path):
    with pytest.raises(PerceptionError, match="no track"):
        Index().save(tmp_path / "index.bin")
    assert not list(tmp_path.iterdir())
