import json

import numpy as np
import pytest
from synthetic_run import Script, skill_tables, write_run

from downbeat.tools.errors import ToolError
from downbeat.tools.metrics import compute_metrics, percentiles, write_metrics
from downbeat.tools.metrics_beats import phase_error_s
from downbeat.tools.truth import TrueBeats

CONTRACT_KEYS = {
    "falls",
    "safety_trips",
    "announced",
    "unannounced",
    "beat_phase_error_ms",
    "physical_lag_ms",
    "transitions",
    "control",
    "bus",
    "chunks",
    "plant_realtime_factor",
    "replay_equal",
    "versions",
    "seed",
    "sections",
}


def metrics_of_script(folder, **changes):
    return compute_metrics(write_run(folder, Script(**changes)), skill_tables())


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    return compute_metrics(write_run(tmp_path_factory.mktemp("run")), skill_tables())


def test_every_key_of_the_contract_is_there_and_json_can_hold_it(good, tmp_path):
    assert set(good) >= CONTRACT_KEYS
    path = write_metrics(tmp_path, good)
    assert json.loads(path.read_text()) == good


def test_onset_errors_and_reactions_are_those_of_the_script(good):
    errors = [row["onset_error_ms"] for row in good["sections"]]
    reactions = [row["reaction_s"] for row in good["sections"]]
    assert errors == [None, 40.0, None, -20.0]
    assert reactions == [2.0, None, 2.5, None]
    assert good["announced"] == {
        "total": 2,
        "followed": 2,
        "onset_error_ms": {"p50": 30.0, "p95": 39.0, "max": 40.0},
    }
    assert good["unannounced"]["reaction_s"]["max"] == 2.5


def test_a_good_run_is_followed_everywhere_and_upright(good):
    assert good["falls"] == 0
    assert good["safety_trips"] == 0
    assert all(row["followed"] and row["upright"] for row in good["sections"])


def test_a_dance_on_the_beat_has_no_phase_error(good):
    assert good["beat_phase_error_ms"]["max"] < 0.1


def test_a_body_behind_the_music_is_measured_as_such(good):
    assert good["physical_lag_ms"] == pytest.approx(100.0, abs=3.0)


def test_transitions_and_control_are_counted(good):
    assert good["transitions"] == {"direct": 0, "blended": 4, "via_stand": 0, "refused": 1}
    assert good["control"]["ticks"] == 2075
    assert good["control"]["missed"] == 0
    assert good["control"]["lateness_us"]["p50"] == pytest.approx(104, abs=1)
    assert set(good["control"]["lateness_us"]) == {"p50", "p99", "p999", "max"}
    assert good["bus"] == {"lost": 0, "rejected": 0}
    assert good["chunks"] == {"total": 80, "correct": 80}
    assert good["plant_realtime_factor"] == 1.0
    assert good["seed"] == 7


def test_a_dance_ahead_of_the_beat_is_off_by_that_much(tmp_path):
    metrics = metrics_of_script(tmp_path, phase_offset_s=0.03)
    assert metrics["beat_phase_error_ms"]["p50"] == pytest.approx(30.0, abs=0.2)
    assert metrics["physical_lag_ms"] == pytest.approx(100.0, abs=3.0)  # against the music, still


def test_a_skill_that_never_comes_is_not_followed_and_has_no_onset(tmp_path):
    metrics = metrics_of_script(tmp_path, onsets_s=(2.0, None, 22.5, 29.98))
    assert metrics["announced"]["followed"] == 1
    row = metrics["sections"][1]
    assert row["onset_error_ms"] is None
    assert not row["followed"]


def test_a_late_announced_skill_is_not_followed_but_a_late_surprise_is(tmp_path):
    metrics = metrics_of_script(tmp_path, onsets_s=(2.9, 12.9, 22.9, 30.0))
    assert [row["followed"] for row in metrics["sections"]] == [True, False, True, True]


def test_a_fall_counts_once_and_spoils_its_section(tmp_path):
    metrics = metrics_of_script(tmp_path, fall_s=(12.0, 14.0))
    assert metrics["falls"] == 1
    assert [row["upright"] for row in metrics["sections"]] == [True, False, True, True]
    assert metrics["announced"]["followed"] == 1


def test_truth_that_ends_early_is_a_fall(tmp_path):
    metrics = metrics_of_script(tmp_path, truth_until_s=33.0)
    assert metrics["falls"] == 1
    assert not metrics["sections"][3]["upright"]


def test_a_tripped_fault_counts_once(tmp_path):
    assert metrics_of_script(tmp_path, faults=((31.0, 35.0),))["safety_trips"] == 1


def test_wrong_windows_are_not_correct(tmp_path):
    assert metrics_of_script(tmp_path, wrong_windows=8)["chunks"] == {"total": 80, "correct": 72}


def test_a_slow_plant_shows(tmp_path):
    metrics = metrics_of_script(tmp_path, stall_s=(10.0, 14.0))
    assert metrics["plant_realtime_factor"] == pytest.approx(1 - 4 / 41.4, abs=1e-3)


def test_a_missing_log_is_answered_with_what_a_run_folder_holds(tmp_path):
    with pytest.raises(ToolError, match=r"run\.lcmlog"):
        compute_metrics(tmp_path, skill_tables())


def test_a_truth_file_without_sections_is_named(tmp_path):
    write_run(tmp_path)
    raw = json.loads((tmp_path / "truth.json").read_text())
    del raw["sections"]
    (tmp_path / "truth.json").write_text(json.dumps(raw))
    with pytest.raises(ToolError, match="sections"):
        compute_metrics(tmp_path, skill_tables())


def test_an_unknown_boundary_is_answered_with_the_valid_ones(tmp_path):
    write_run(tmp_path)
    text = (tmp_path / "truth.json").read_text().replace("unannounced", "sudden")
    (tmp_path / "truth.json").write_text(text)
    with pytest.raises(ToolError, match="announced, start, unannounced"):
        compute_metrics(tmp_path, skill_tables())


@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.0])
def test_half_and_double_time_are_in_time(ratio):
    beats = TrueBeats.constant(100.0, 0.4)
    track_s = np.arange(0.0, 20.0, 0.02)
    rate = np.full(track_s.size, ratio * 100.0 / 120.0)
    phase_s = beats.at(track_s) * ratio * 0.5  # one skill beat is 0.5 s
    error = phase_error_s(phase_s, rate, 120.0, beats, track_s)
    assert np.abs(error).max() < 1e-9
    late = phase_error_s(phase_s - 0.02 * rate, rate, 120.0, beats, track_s)
    np.testing.assert_allclose(late, -0.02, atol=1e-9)


def test_beat_times_and_a_constant_tempo_mean_the_same():
    times = 0.3 + np.arange(50) * 0.5
    recorded, constant = TrueBeats(times), TrueBeats.constant(120.0, 0.3)
    track_s = np.linspace(-1.0, 30.0, 200)
    np.testing.assert_allclose(recorded.at(track_s), constant.at(track_s), atol=1e-9)
    np.testing.assert_allclose(recorded.bpm(track_s), 120.0, rtol=1e-9)


def test_percentiles_of_nothing_are_unknown():
    assert percentiles([], (50, 99.9)) == {"p50": None, "p999": None, "max": None}
