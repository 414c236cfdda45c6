"""How the following of a beat is scored."""

import json

import numpy as np
import pytest
import soundfile

from downbeat.catalog.beatgrid import BeatGrid
from downbeat.tools import eval_follow
from downbeat.tools.errors import ToolError
from downbeat.tools.eval_follow import Followed, follow, run_eval_follow, score, total
from downbeat.tools.follow_reference import Reference, f_measure, halved_gaps


def reference(bpm=120.0, first_s=0.2, seconds=60.0, witness=()):
    return Reference(BeatGrid(bpm, first_s), np.array(witness, np.float64), seconds)


def clock(bpm, first_s, from_s=4.0, seconds=60.0):
    """Return a perfect clock that is steady from a time on."""
    now = np.arange(0.1, seconds, 0.1)
    period = 60.0 / bpm
    beat = first_s + np.round((now - first_s) / period) * period
    steady = now >= from_s
    return Followed(now, beat, np.full(len(now), period), steady * 0.9, steady, 1.0)


def test_a_perfect_clock_has_no_error():
    row = score(clock(120.0, 0.2), reference())
    assert row["error_ms"].max() < 0.01
    assert row["f_measure"] > 0.98
    assert row["first_s"] == pytest.approx(4.0, abs=0.11)
    assert not row["offbeat"].any()


def test_a_late_clock_is_as_wrong_as_it_is_late():
    row = score(clock(120.0, 0.235), reference())
    assert row["error_ms"] == pytest.approx(35.0, abs=0.01)


def test_an_offbeat_is_an_error_of_half_a_beat_and_counted():
    row = score(clock(120.0, 0.45), reference())
    assert row["error_ms"] == pytest.approx(250.0, abs=0.01)
    assert row["offbeat"].all()
    assert row["f_measure"] == 0.0


@pytest.mark.parametrize("bpm", [60.0, 240.0])
def test_an_octave_with_the_same_beats_is_no_error(bpm):
    row = score(clock(bpm, 0.2), reference())
    assert row["error_ms"].max() < 0.01
    assert row["f_measure"] > 0.95


def test_another_tempo_is_wrong_even_where_beats_meet():
    row = score(clock(90.0, 0.2), reference())
    assert row["wrong_tempo"].all()
    assert np.percentile(row["error_ms"], 95) > 150.0


def test_never_following_counts_as_never():
    row = score(clock(120.0, 0.2, from_s=99.0), reference())
    figures = total([row, score(clock(120.0, 0.2), reference())])
    assert figures["never"] == 1
    assert figures["first_s"]["p95"] == pytest.approx(4.0, abs=0.11) or None
    assert figures["following"] == pytest.approx(0.5, abs=0.01)


def test_a_steady_beat_needs_a_witness_who_agrees():
    beats = 0.2 + 0.5 * np.arange(119)
    assert reference(witness=beats).is_steady
    assert reference(witness=beats[::2]).is_steady
    assert reference(witness=halved_gaps(beats)).is_steady
    assert not reference(witness=beats + 0.25).is_steady
    assert not reference(witness=0.2 + 0.61 * np.arange(97)).is_steady
    assert not reference(witness=beats, seconds=20.0).is_steady


def test_every_beat_is_counted_once():
    assert f_measure(np.array([1.0, 1.05]), np.array([1.02])) == pytest.approx(2.0 / 3.0)
    assert f_measure(np.array([1.0, 2.0]), np.array([1.05, 2.08])) == pytest.approx(0.5)
    assert f_measure(np.zeros(0), np.array([1.0])) == 0.0


def test_a_moved_and_stretched_reference_names_the_same_beats():
    beats = reference().beats_s
    moved = reference().moved(10.0).stretched(1.1).beats_s
    assert (moved / 1.1 + 10.0)[5:20] == pytest.approx(beats[25:40])


def test_a_folder_is_followed_and_reported(tmp_path, monkeypatch, capsys):
    rng = np.random.default_rng(2)
    rate, bpm = 16_000, 110.0
    sound = 0.003 * rng.standard_normal(30 * rate)
    t = np.arange(rate // 8) / rate
    for beat in range(54):
        start = round((0.3 + beat * 60.0 / bpm) * rate)
        sound[start : start + len(t)] += 0.5 * np.sin(2 * np.pi * 70.0 * t) * np.exp(-t * 25.0)
        sound[start : start + len(t)] += 0.2 * rng.standard_normal(len(t)) * np.exp(-t * 50.0)
    soundfile.write(tmp_path / "drums.wav", sound, rate)
    (tmp_path / "broken.wav").write_bytes(b"no sound")
    truth = Reference(BeatGrid(bpm, 0.3), np.zeros(0), 30.0)
    monkeypatch.setattr(eval_follow, "find_reference", lambda _recording: truth)
    assert run_eval_follow(tmp_path, None, 0.0, True) == 0
    out = capsys.readouterr()
    report = json.loads(out.out)
    assert "broken.wav" in out.err
    assert report["steady"]["error_ms"]["p95"] < 20.0
    assert report["per_track"]["drums"]["followed_bpm"] == pytest.approx(bpm, rel=0.01)


def test_a_start_before_the_beginning_is_refused():
    with pytest.raises(ToolError, match="at least 0"):
        run_eval_follow(None, None, -1.0, False)


def test_too_short_a_sound_is_never_followed():
    assert not follow(np.zeros(100, np.float32)).is_steady.any()
