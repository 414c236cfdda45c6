"""Unknown music is compared with a catalogue; nothing that it is given takes it down."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from synthetic_music import make_music

from downbeat.perception.errors import PerceptionError
from downbeat.perception.likeness import CatalogLikeness, Similar
from downbeat.perception.likeness_build import build_likeness, load_likeness, skill_sentences
from downbeat.perception.likeness_embedded import WEIGHTS, EmbeddedDescriptor
from downbeat.perception.likeness_features import describe
from downbeat.perception.likeness_store import LikenessTable
from downbeat.perception.source import Recording, load_recording
from downbeat.policies.manifest import load_skills

RATE = 16_000


def pieces(count: int = 4) -> dict[str, Recording]:
    sounds = [make_music(seed, 15.0, RATE) for seed in range(count)]
    return {f"piece{i}": Recording(f"piece{i}", s, RATE) for i, s in enumerate(sounds)}


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("catalogue") / "likeness.npz"
    build_likeness(pieces(), path)
    return path


@pytest.fixture(scope="module")
def likeness(catalogue: Path) -> CatalogLikeness:
    return load_likeness(catalogue)


def test_the_track_itself_is_the_nearest(likeness: CatalogLikeness) -> None:
    for name, recording in pieces().items():
        found = likeness.nearest(recording.samples[3 * RATE : 9 * RATE], RATE)
        assert found is not None
        assert found.track == name
        assert found.runner_up != name
        assert 0.0 < found.margin <= 2.0
        assert found.similarity <= 1.0 + 1e-5


def test_volume_and_rate_of_the_sound_do_not_matter(likeness: CatalogLikeness) -> None:
    sound = make_music(1, 15.0, 44_100)[: 6 * 44_100]
    loud = likeness.nearest(sound, 44_100)
    quiet = likeness.nearest(0.05 * sound, 44_100)
    assert loud is not None and quiet is not None
    assert loud.track == quiet.track
    assert loud.similarity == pytest.approx(quiet.similarity, abs=0.01)


def test_a_transposed_piece_is_more_like_itself_than_other_pieces_are() -> None:
    embedder = EmbeddedDescriptor()
    sound = make_music(0, 6.0, 22_050)
    up = embedder.embed(sound, 23_361)  # a semitone and 6 % faster
    own, others = (
        [float(up @ embedder.embed(make_music(s, 6.0, 22_050), 22_050)) for s in seeds]
        for seeds in ((0,), (1, 2, 3))
    )
    assert own[0] > max(others)


@pytest.mark.parametrize(
    "sound",
    [
        np.zeros(0, np.float32),
        np.zeros(10 * RATE, np.float32),
        np.full(10 * RATE, 0.7, np.float32),
        np.full(10 * RATE, np.nan, np.float32),
        make_music(0, 4.9, RATE),
        1e-4 * make_music(0, 6.0, RATE),
    ],
    ids=["nothing", "silence", "constant", "not a number", "too short", "too quiet"],
)
def test_what_is_no_music_has_no_likeness(likeness: CatalogLikeness, sound: np.ndarray) -> None:
    assert likeness.nearest(sound, RATE) is None


def test_clipped_and_noisy_sound_is_answered(likeness: CatalogLikeness) -> None:
    rng = np.random.default_rng(0)
    clipped = np.clip(100.0 * make_music(0, 6.0, RATE), -1.0, 1.0).astype(np.float32)
    one_click = np.zeros(6 * RATE, np.float32)
    one_click[3 * RATE] = 1.0
    for sound in (clipped, rng.normal(size=6 * RATE).astype(np.float32), one_click):
        found = likeness.nearest(sound, RATE)
        assert found is not None
        assert np.isfinite([found.similarity, found.margin]).all()


def test_only_the_newest_sound_is_heard(likeness: CatalogLikeness) -> None:
    old, new = make_music(0, 10.0, RATE), make_music(2, 10.0, RATE)
    found = likeness.nearest(np.concatenate([old, old, new, new]), RATE)
    assert found is not None
    assert found.track == "piece2"


def test_unchanged_tracks_are_not_embedded_again(catalogue: Path, tmp_path: Path) -> None:
    class Counting(EmbeddedDescriptor):
        calls = 0

        def embed(self, samples: np.ndarray, sample_rate_hz: int) -> np.ndarray:
            Counting.calls += 1
            return super().embed(samples, sample_rate_hz)

    path = tmp_path / "likeness.npz"
    path.write_bytes(catalogue.read_bytes())
    tracks = pieces(5)
    renamed = {("other" if n == "piece0" else n): r for n, r in tracks.items() if n != "piece1"}
    table = build_likeness(renamed, path, Counting())
    assert Counting.calls == 5  # piece4 alone: 15 s, every 2.5 s
    assert table.names == ["other", "piece2", "piece3", "piece4"]
    again = LikenessTable.load(path)
    assert again.names == table.names
    np.testing.assert_array_equal(again.vectors[3], table.vectors[3])


def test_silent_and_short_tracks_are_named_and_left_out(tmp_path: Path) -> None:
    said: list[str] = []
    tracks = pieces(1) | {
        "silent": Recording("silent", np.zeros(10 * RATE, np.float32), RATE),
        "short": Recording("short", make_music(0, 3.0, RATE), RATE),
    }
    table = build_likeness(tracks, tmp_path / "likeness.npz", say=said.append)
    assert table.names == ["piece0"]
    assert ["silent" in said[0], "short" in said[1]] == [True, True]
    alone = CatalogLikeness(table, EmbeddedDescriptor()).nearest(make_music(9, 6.0, RATE), RATE)
    assert isinstance(alone, Similar)
    assert (alone.track, alone.runner_up) == ("piece0", "")


def test_an_empty_catalogue_is_like_nothing(tmp_path: Path) -> None:
    build_likeness({}, tmp_path / "likeness.npz")
    empty = load_likeness(tmp_path / "likeness.npz")
    assert empty.nearest(make_music(0, 6.0, RATE), RATE) is None


@pytest.mark.parametrize("damage", ["missing", "noise", "cut", "changed", "foreign", "other model"])
def test_a_wrong_table_says_so(catalogue: Path, tmp_path: Path, damage: str) -> None:
    path = tmp_path / "likeness.npz"
    content = bytearray(catalogue.read_bytes())
    if damage == "changed":
        content[len(content) // 2] ^= 0xFF
    if damage == "noise":
        content = bytearray(b"\0" * 100)
    if damage == "cut":
        content = content[: len(content) // 2]
    if damage != "missing":
        path.write_bytes(content)
    if damage == "foreign":
        with path.open("wb") as file:
            np.savez(file, header=np.array(["downbeat-alignment-index-2", "", ""]))
    if damage == "other model":
        LikenessTable("clap-0123").save(path)
    with pytest.raises(PerceptionError, match="downbeat catalog build"):
        load_likeness(path)


def test_the_embedded_descriptor_says_that_it_has_no_words(
    likeness: CatalogLikeness, catalogue: Path
) -> None:
    with pytest.raises(PerceptionError, match=r"no words.*models export clap"):
        likeness.skills_by_text(make_music(0, 6.0, RATE), RATE)
    with pytest.raises(PerceptionError, match="no words"):
        load_likeness(catalogue, skills={"salsa": ["latin dance"]})


def test_every_dance_is_described_in_words_and_nothing_else_is() -> None:
    sentences = skill_sentences(load_skills())
    assert "music to dance to: latin dance" in sentences["salsa"]
    assert set(sentences) == {n for n, m in load_skills().items() if m.bpm > 0}
    assert "stand" not in sentences


def test_the_weights_are_small_and_foreign_ones_are_refused(tmp_path: Path) -> None:
    assert WEIGHTS.stat().st_size < 200_000
    np.savez(tmp_path / "weights.npz", format=np.array("other"))
    for path in (tmp_path / "weights.npz", tmp_path / "none.npz"):
        with pytest.raises(PerceptionError, match="train_likeness"):
            EmbeddedDescriptor(path)


def test_a_query_costs_no_more_than_20_ms_of_one_core(likeness: CatalogLikeness) -> None:
    sound = make_music(0, 5.0, RATE)
    times = []
    for _ in range(8):
        began = time.process_time()
        likeness.nearest(sound, RATE)
        times.append(time.process_time() - began)
    assert min(times) < 0.020


def test_descriptors_are_finite_for_any_sound() -> None:
    rng = np.random.default_rng(0)
    tone = np.sin(np.arange(5 * RATE) * 0.3).astype(np.float32)
    noise = rng.normal(size=5 * RATE).astype(np.float32)
    for sound in (tone, noise, np.sign(tone), 1e-6 * noise, np.eye(1, 5 * RATE)[0]):
        assert np.isfinite(describe(np.asarray(sound, np.float32))).all()


def test_halves_of_real_recordings_find_each_other(real_music: Path) -> None:
    files = sorted(real_music.iterdir())[:6]
    embedder = EmbeddedDescriptor()
    first, second = [], []
    for path in files:
        recording = load_recording(path)
        third = min(30 * recording.sample_rate_hz, len(recording.samples) // 2)
        parts = recording.samples[:third], recording.samples[-third:]
        for rows, part in zip((first, second), parts):
            window = 5 * recording.sample_rate_hz
            cuts = [part[i : i + window] for i in range(0, third - window + 1, window)]
            mean = np.mean([embedder.embed(c, recording.sample_rate_hz) for c in cuts], axis=0)
            rows.append(mean / np.linalg.norm(mean))
    found = np.argmax(np.array(second) @ np.array(first).T, axis=1)
    assert np.mean(found == np.arange(len(files))) >= 0.5  # by chance: 0.17
