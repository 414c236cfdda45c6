"""`downbeat bench control`: its contract, its arithmetic, and what it leaves running (nothing)."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from downbeat.runtime.bus import MulticastError, parse_udpm_url
from downbeat.runtime.udpm import check_multicast
from downbeat.tools import loop_c
from downbeat.tools.bench_control import ControlBench, busy_processors, measure
from downbeat.tools.bench_control_report import Block, drift, framework_us, report_of
from downbeat.tools.cli import main
from downbeat.tools.errors import ToolError

needs_compiler = pytest.mark.skipif(
    not any(shutil.which(name) for name in loop_c.COMPILERS), reason="no C compiler"
)


@pytest.fixture
def multicast():
    try:
        check_multicast(parse_udpm_url("udpm://239.255.76.68:7667?ttl=0"))
    except MulticastError as error:
        pytest.skip(str(error))


def children():
    """Names of the programs that this process started and that still run."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            stat = (entry / "stat").read_text()
        except OSError:
            continue
        state, parent = stat.rpartition(")")[2].split()[:2]
        if int(parent) == os.getpid() and state != "Z":
            found.append((entry / "cmdline").read_text().replace("\0", " "))
    return found


@needs_compiler
def test_json_has_the_promised_keys(multicast, capsys):
    assert main(["bench", "control", "--json", "--seconds", "1.6"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert set(report["framework_us"]) >= {"p50", "p99"}
    assert set(report["lateness_us"]) == {"p50", "p99", "p999", "max"}
    assert report["lateness_ratio_to_c"] > 0.0
    assert isinstance(report["missed"], int)
    assert report["messages"] == [] or all(isinstance(m, str) for m in report["messages"])
    for state in ("idle", "loaded"):
        details = report[state]
        assert details["control"]["ticks"] > 0
        assert details["c"]["ticks"] == 80
        assert details["network"]["run_us"]["p50"] > 0.0
        assert set(details["control"]["compute_us"]) == {"p50", "p99", "p999", "max"}
        assert details["control"]["cpu_us_per_tick"] > 0.0
    assert set(report["request_ticks"]) == {"p50", "max", "count", "unanswered"}
    assert report["memory_growth_kb"] is not None
    assert len(report["targets"]) >= 4
    assert not any("bench_control" in text or "while True" in text for text in children())


def test_without_a_compiler_the_c_loop_is_left_out_with_one_message(
    multicast, tmp_path, monkeypatch, capsys
):
    monkeypatch.setenv("PATH", "")
    bench = ControlBench(seconds=0.4, load=False, cache=tmp_path)
    report = measure(bench)
    assert report["lateness_ratio_to_c"] is None
    assert report["idle"]["c"] is None and report["loaded"] is None
    assert [m for m in report["messages"] if "compiler" in m] == [loop_c.NO_COMPILER]
    assert report["idle"]["control"]["ticks"] > 0


@needs_compiler
def test_c_loop_is_built_once_and_counts_its_wake_ups(tmp_path, monkeypatch):
    program = loop_c.build_loop(tmp_path / "cache")
    monkeypatch.setenv("PATH", "")
    assert loop_c.build_loop(tmp_path / "cache") == program
    result = loop_c.run_loop(program, 0, 1_000_000, 20, 10, None)
    assert len(result.lateness_us) == 20
    assert all(late >= 0.0 for late in result.lateness_us)
    assert result.missed > 1_000, "a deadline at boot was given up, with all that followed"


@needs_compiler
def test_source_that_does_not_compile_is_one_sentence(tmp_path, monkeypatch):
    monkeypatch.setattr(loop_c, "SOURCE", "int main(void) { return }")
    with pytest.raises(ToolError, match="does not compile with"):
        loop_c.build_loop(tmp_path)


def test_burners_end_even_when_the_block_fails():
    with pytest.raises(RuntimeError), busy_processors():
        assert sum("while True" in text for text in children()) == len(os.sched_getaffinity(0))
        raise RuntimeError
    assert not any("while True" in text for text in children())


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (("--skill", "walk"), "kpop"),
        (("--skill", "stand"), "kpop"),
        (("--seconds", "0"), "--seconds"),
        (("--cpu", "4096"), "--cpu"),
    ],
)
def test_impossible_settings_are_one_sentence(capsys, argv, said):
    assert main(["bench", "control", *argv]) == 2
    assert said in capsys.readouterr().err


def control_block(loaded=False, start=0, compute=500.0, late=50.0, memory_kb=1000, **more):
    ticks = 100
    return Block(
        kind="control",
        loaded=loaded,
        start_utime=start,
        end_utime=start + 2_000_000,
        lateness_us=[late] * ticks,
        compute_us=[compute] * ticks,
        network_us=[80.0] * (ticks - 30) + [160.0] * 30,
        cpu_s=0.1,
        memory_kb=memory_kb,
        **more,
    )


def other_block(kind, value, loaded=False):
    lateness = [value] * 100
    return Block(kind, loaded, 0, 2_000_000, lateness, [value] * 100, network_us=[0.0] * 100)


def test_framework_is_the_tick_without_its_own_network_runs():
    spent = framework_us([control_block()])
    assert spent[0] == 420.0 and spent[-1] == 340.0


def test_states_are_apart_and_pooled_on_top():
    blocks = [
        control_block(late=50.0, memory_kb=1000),
        other_block("c", 25.0),
        other_block("network", 80.0),
        control_block(loaded=True, late=100.0, start=10_000_000, memory_kb=1400, missed=2),
        other_block("c", 100.0, loaded=True),
        other_block("network", 80.0, loaded=True),
    ]
    answers = [(1_005_000, 1_020_000), (10_500_000, 10_540_000), (10_900_000, 0)]
    report = report_of(blocks, answers)
    assert report["idle"]["lateness_ratio_to_c"] == 2.0
    assert report["loaded"]["lateness_ratio_to_c"] == 1.0
    assert report["lateness_ratio_to_c"] == 1.0
    assert report["missed"] == 2 and report["memory_growth_kb"] == 400
    assert report["idle"]["request_ticks"]["max"] == 0.75
    assert report["loaded"]["request_ticks"] == {
        "p50": 2.0,
        "max": 2.0,
        "count": 1,
        "unanswered": 1,
    }
    assert report["idle"]["control"]["cpu_us_per_tick"] == 1000.0
    missed = {row["name"] for row in report["targets"] if row["ok"] is False}
    assert missed == {
        "framework p50 [us]",
        "request to first tick [ticks]",
        "requests without an answer",
    }


def test_request_that_the_end_of_a_block_cut_off_does_not_count():
    report = report_of([control_block()], [(1_990_000, 0)])
    assert report["request_ticks"]["unanswered"] == 0


def test_drift_is_a_trend_and_not_a_single_late_wake_up():
    steady = np.full(300, 40.0)
    steady[290] = 9_000.0
    growing = 40.0 + 0.06 * np.arange(300)  # 3 us/s, relative sleeps of a tight loop
    blocks = [Block("control", False, 0, 0, list(samples)) for samples in (steady, growing)]
    assert drift(blocks[0]) == 0.0
    assert drift(blocks[1]) == pytest.approx(0.18)
