"""The evaluation of likeness finds likeness where there is some, and chance where there is none."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import soundfile

from downbeat.perception.likeness import unit
from downbeat.perception.likeness_store import LikenessTable
from downbeat.tools.errors import ToolError
from downbeat.tools.eval_likeness import LikenessOptions, eval_likeness, read_groups
from downbeat.tools.likeness_score import Heard, score
from downbeat.tools.train_likeness import main as train

RATE = 16_000


def piece(seed: int, is_noisy: bool) -> np.ndarray:
    """Twenty seconds of quick noise bursts, or of slow low chords."""
    rng = np.random.default_rng(seed)
    t = np.arange(21 * RATE) / RATE
    if is_noisy:
        beat = np.exp(-20.0 * (t * rng.uniform(3.0, 5.0) % 1.0))
        return (0.2 * rng.normal(size=len(t)) * beat).astype(np.float32)
    chord = sum(np.sin(2 * np.pi * f * t) for f in rng.uniform(80, 400, 4))
    return (0.05 * chord * (1 + 0.3 * np.sin(2 * np.pi * 0.4 * t))).astype(np.float32)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recordings")
    lines = []
    for seed in range(8):
        group = "drums" if seed % 2 else "organ"
        soundfile.write(folder / f"piece{seed}.wav", piece(seed, seed % 2 == 1), RATE)
        lines.append(f"piece{seed}\t{group}")
    soundfile.write(folder / "short.wav", piece(9, True)[: 10 * RATE], RATE)
    lines.append("short\tdrums")
    (folder / "groups.tsv").write_text("\n".join(lines) + "\n")
    return folder


def test_plainly_different_groups_are_told_apart(folder: Path, capsys) -> None:
    assert eval_likeness(LikenessOptions(folder, folder / "groups.tsv"), True) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["group_top1"]["mean"] == 1.0
    assert report["group_top1"]["chance"] == pytest.approx(3 / 7, abs=1e-3)
    assert report["group_rank"]["mean"] > 0.9
    assert report["left_out"] == ["short"]
    assert report["permutation_p"] < 0.1
    assert set(report["group_top1_by_group"]) == {"drums", "organ"}
    low, high = report["other_half_top1"]["ci95"]
    assert 0.0 <= low <= report["other_half_top1"]["mean"] <= high <= 1.0
    assert 0.0 < report["query_ms"]["p50"] <= report["query_ms"]["p99"]


def test_vectors_drawn_at_random_score_chance() -> None:
    rng = np.random.default_rng(0)
    rows = [[unit(rng.normal(size=(6, 16))) for _ in range(24)] for _ in range(2)]
    whole = [np.concatenate(pair) for pair in zip(*rows)]
    names = [f"t{i}" for i in range(24)]
    tables = tuple(LikenessTable("", names, [""] * 24, v) for v in (whole, *rows))
    owners = np.repeat(np.arange(24), 8)
    queries = unit(rng.normal(size=(len(owners), 16)))
    groups = ["abc"[i % 3] for i in range(24)]
    report = score(Heard(groups, tables, queries, owners, [1.0]), 0)
    for key in ("group_top1", "group_rank", "halves_kendall", "other_half_top1"):
        low, high = report[key]["ci95"]
        assert low - 0.02 <= report[key]["chance"] <= high + 0.02, key
    assert report["permutation_p"] > 0.05


def test_wrong_files_are_refused_in_a_sentence(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ToolError, match="cannot be read"):
        read_groups(tmp_path / "none.tsv")
    (tmp_path / "bad.tsv").write_text("only one cell\n")
    with pytest.raises(ToolError, match=r"bad\.tsv:1"):
        read_groups(tmp_path / "bad.tsv")
    (tmp_path / "two.tsv").write_text("piece0\ta\npiece1\tb\n")
    with pytest.raises(ToolError, match="at least 3"):
        eval_likeness(LikenessOptions(folder, tmp_path / "two.tsv"), True)
    with pytest.raises(ToolError, match="No condition 'mars'"):
        options = LikenessOptions(folder, folder / "groups.tsv", condition="mars")
        eval_likeness(options, True)


@pytest.mark.slow
def test_training_writes_weights_that_hear(folder: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "weights.npz"
    arguments = ["--tracks", str(folder), "--groups", str(folder / "groups.tsv"), "--out", str(out)]
    train(arguments)
    said = capsys.readouterr().out
    right, chance = (float(said.split(key)[1].split()[0]) for key in ("own group ", "chance: "))
    assert 3 / 8 < chance < 4 / 8 < right
    from downbeat.perception.likeness_embedded import EmbeddedDescriptor

    embedder = EmbeddedDescriptor(out)
    starts = ((101, 0), (101, 12 * RATE), (103, 0))  # one unheard piece twice, and another
    cuts = [piece(seed, True)[start : start + 5 * RATE] for seed, start in starts]
    here, there, other = (embedder.embed(cut, RATE) for cut in cuts)
    assert here @ there > here @ other
    assert EmbeddedDescriptor().digest != embedder.digest
