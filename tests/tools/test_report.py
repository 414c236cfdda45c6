import io

import pytest
from rich.console import Console
from synthetic_run import Script, skill_tables, write_run

from downbeat.tools.metrics import compute_metrics
from downbeat.tools.report import is_good, print_report


def printed(metrics):
    console = Console(width=120, record=True, file=io.StringIO())
    print_report(metrics, console)
    return console.export_text()


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    return compute_metrics(write_run(tmp_path_factory.mktemp("run")), skill_tables())


def test_a_good_run_is_called_good(good):
    assert is_good(good)
    assert "4 of 4 sections followed, 0 falls" in printed(good)


def test_the_table_shows_signed_onsets_and_reactions(good):
    text = printed(good)
    assert "+40 ms" in text
    assert "-20 ms" in text
    assert "+2.50 s" in text


def test_a_missed_section_is_never_hidden(tmp_path):
    script = Script(onsets_s=(2.0, None, 22.5, 29.98))
    metrics = compute_metrics(write_run(tmp_path, script), skill_tables())
    assert not is_good(metrics)
    assert "missed" in printed(metrics)


def test_a_fall_is_never_hidden(tmp_path):
    metrics = compute_metrics(write_run(tmp_path, Script(fall_s=(12.0, 13.0))), skill_tables())
    assert not is_good(metrics)
    assert "fell" in printed(metrics)


def test_a_run_without_measurements_prints_all_the_same(tmp_path):
    script = Script(onsets_s=(None, None, None, None))
    metrics = compute_metrics(write_run(tmp_path, script), skill_tables())
    assert metrics["beat_phase_error_ms"]["p50"] is None
    assert "0 of 4 sections followed" in printed(metrics)
