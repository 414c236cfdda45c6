"""What the verdict learns from is what its labels say, and what it learns is written whole."""

import sys
from pathlib import Path

import numpy as np
import pytest
import soundfile

from downbeat.perception.features import features, to_matcher_rate
from downbeat.perception.verdict import MEASURES, WITNESSES, Verdict, learned, with_length
from downbeat.runtime.errors import DownbeatError
from downbeat.tools.errors import ToolError
from downbeat.tools.sparse_sounds import PIECE_S, sparse_pieces
from downbeat.tools.train_verdict import fit, main
from downbeat.tools.verdict_windows import VerdictStudy, random_condition

sys.path.insert(0, str(Path(__file__).parents[1] / "perception"))
from synthetic_music import RATE, make_music

ROWS = 400


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Two folders of two pieces each; in the second, one piece twice."""
    root = tmp_path_factory.mktemp("music")
    for number, folder in enumerate(("one", "two")):
        (root / folder).mkdir()
        for piece in range(2):
            name = f"piece{piece}"
            samples = make_music(10 * number + piece, 14.0)
            soundfile.write(root / folder / f"{name}.flac", samples, RATE)
    again = make_music(10, 14.0)
    soundfile.write(root / "two" / "again.flac", again, RATE)
    return root


def test_strangers_are_never_right_and_copies_are_no_strangers(folders):
    rows = VerdictStudy(folders / "two", [], None).windows(2, seed=3).arrays()
    assert rows["measures"].shape == (len(rows["frames"]), MEASURES)
    assert not (rows["is_right"] & ~rows["is_known"]).any()
    known = rows["is_known"]
    assert rows["is_right"][known].mean() > 0.7  # windows of a second in loud noise among them
    # Voices, tones and single sounds are strangers to every catalogue, and some pieces are sparse.
    made = np.array([name.startswith("sparse") for name in rows["track"]])
    assert known[made].any() and (~known[made]).mean() > 0.5
    assert "tone 1000" in rows["track"] and not rows["is_right"][rows["track"] == "tone 1000"].any()
    # "again" is left out together with the piece that it repeats, both times.
    copies = np.isin(rows["track"], ["again", "piece0"])
    assert copies.any() and not rows["is_right"][copies & ~known].any()


def test_every_second_sparse_piece_is_mostly_pause_and_no_two_are_alike():
    pieces = [piece.samples for piece in sparse_pieces(24, 1, RATE)]
    quiet = [np.mean(np.abs(samples) < 0.03 * np.abs(samples).max()) for samples in pieces]
    assert np.median(quiet[::2]) > 0.5
    assert all(len(samples) == round(PIECE_S * RATE) for samples in pieces)
    assert all(0.1 < np.abs(samples).max() <= 1.0 for samples in pieces)
    assert len({samples.tobytes() for samples in pieces}) == len(pieces)
    again = sparse_pieces(24, 1, RATE)
    np.testing.assert_array_equal(pieces[5], again[5].samples)


def test_the_others_are_drum_loops_that_repeat_themselves():
    """A few different spectra, over and over: a bar later they sound as they did."""

    def likeness(piece):
        x = features(to_matcher_rate(piece.samples, RATE))
        x = np.maximum(x - x.mean(0), 0.0)
        energy = np.square(x).sum()
        return max(2.0 * np.sum(x[lag:] * x[:-lag]) / energy for lag in range(4, 80))

    pieces = sparse_pieces(24, 1, RATE)
    loops = [likeness(piece) for piece in pieces[1::2]]
    assert np.median(loops) > 0.6
    assert np.median([likeness(piece) for piece in pieces[::2]]) < np.median(loops)


def test_the_same_seed_gathers_the_same_rows(folders):
    one, other = (VerdictStudy(folders / "one", [], None).windows(1, 5).arrays() for _ in "ab")
    for name, values in one.items():
        np.testing.assert_array_equal(values, other[name])


def test_conditions_are_many_and_leave_something_to_hear():
    rng = np.random.default_rng(0)
    samples = make_music(1, 3.0, 44_100)
    names = set()
    for _ in range(60):
        drawn = random_condition([samples], rng)
        heard = drawn.apply(samples, 44_100, rng)
        names.add(drawn.name)
        assert np.isfinite(heard).all() and np.abs(heard).max() > 1e-3
    assert {"clean", "robot", "babble", "pink", "white"} < names and len(names) > 8


def test_regression_finds_what_decides():
    rng = np.random.default_rng(1)
    measures = rng.normal(size=(ROWS, MEASURES))
    frames = rng.integers(12, 100, ROWS)
    is_right = measures[:, 7] + 0.3 * rng.normal(size=ROWS) > 0.5
    model = fit([{"measures": measures, "frames": frames, "is_right": is_right}])
    found = model.weights[:MEASURES]
    assert int(np.abs(found).argmax()) == 7 and found[7] > 0
    row = with_length(measures, frames)
    assert ((row @ model.weights + model.bias > 0.0) == is_right).mean() > 0.9


def test_the_script_writes_weights_that_the_matcher_reads(folders, tmp_path, capsys):
    out = tmp_path / "verdict.npz"
    tracks = [str(folders / name) for name in ("one", "two")]
    kept = ["--windows", str(tmp_path / "kept"), "--sounds", "2"]
    main(["--tracks", *tracks, "--out", str(out), *kept])
    first = out.read_bytes()
    verdict = Verdict(out)
    assert verdict.lock.of(3.0) > verdict.accept.of(3.0)
    said = capsys.readouterr().out
    assert "strangers" in said and "single sounds" in said
    main(["--tracks", *tracks, "--out", str(out), *kept])  # of what was kept
    assert out.read_bytes() == first


def test_to_agree_over_more_is_never_learned_to_speak_against_a_fit():
    """Rows in which what agrees less is right: the weights stop at nothing, at every length."""
    rng = np.random.default_rng(4)
    measures = rng.normal(size=(ROWS, MEASURES))
    is_right = measures[:, WITNESSES].sum(1) < 0.0
    rows = {"measures": measures, "is_right": is_right, "frames": rng.integers(12, 100, ROWS)}
    for model in (fit([rows]).weights, learned()._weights):
        assert (model[:MEASURES][WITNESSES] >= 0.0).all()
        assert not model[MEASURES:-1][WITNESSES].any()


def test_folders_and_groups_must_pair(folders, tmp_path):
    with pytest.raises(ToolError, match="1 group files for 2 folders"):
        main(["--tracks", str(folders / "one"), str(folders / "two"), "--groups", "x.tsv"])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--sounds", "0"], "--sounds 0 gathers nothing"),
        (["--out", "nowhere/x.npz"], "cannot be written"),
        (["--out", "weights.txt"], "cannot be written"),
        (["--speech", "nowhere"], "nowhere"),
    ],
)
def test_what_cannot_work_is_refused_before_the_work_in_a_sentence(folders, options, said):
    with pytest.raises(DownbeatError, match=said):
        main(["--tracks", str(folders / "one"), str(folders / "two"), *options])


def test_the_same_folder_twice_is_no_two_folders(folders):
    with pytest.raises(ToolError, match="names a folder twice"):
        main(["--tracks", str(folders / "one"), str(folders / "two" / ".." / "one")])


def test_what_was_kept_is_used_only_for_the_same_folders_and_counts(folders, tmp_path, capsys):
    for options in (["--sounds", "1"], ["--sounds", "2"], ["--sounds", "1"]):
        tracks = ["--tracks", str(folders / "one")]
        main([*tracks, *options, "--windows", str(tmp_path), "--out", str(tmp_path / "v.npz")])
    assert capsys.readouterr().out.count("gathering") == 2
    assert len(list(tmp_path.glob("one-*.npz"))) == 2
