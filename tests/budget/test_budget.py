"""The budget table: a synthetic run of which everything is known, and a short run in lockstep."""

import json

import lcm
import numpy as np
import pytest

from downbeat.lcm_types import control_status_t, g1_low_cmd_t, heartbeat_t
from downbeat.lcm_types.channels import CHANNELS
from downbeat.runtime.codec import codec_for
from downbeat.runtime.config import ConfigError
from downbeat.runtime.usage import Usage
from downbeat.tools.budget import BUDGET_PATH, budget_command, compare, load_budget
from downbeat.tools.budget_run import read_costs
from downbeat.tools.cli import main
from downbeat.tools.errors import ToolError

START = 1_700_000_000_000_000
TICK_US = 20_000


class RunWriter:
    """Writes the log of 60 s of control."""

    def __init__(self, folder):
        self.log = lcm.EventLog(str(folder / "run.lcmlog"), "w", overwrite=True)
        self.seqs = {}

    def write(self, channel, utime, msg, skip=0):
        seq = self.seqs.get(channel, -1) + 1 + skip
        self.seqs[channel] = seq
        msg.header.utime, msg.header.seq, msg.header.epoch = utime, seq, 7
        self.log.write_event(utime, channel, codec_for(CHANNELS[channel].type).encode(msg))


def write_run(
    folder,
    cpu_share=0.05,
    growth_mb_per_min=0.0,
    lateness_us=60,
    late_stamps_us=0,
    command_every=1,
    lose_at=(),
    log_lines=0,
    seconds=60,
):
    writer = RunWriter(folder)
    for tick in range(seconds * 50):
        utime = START + tick * TICK_US
        status = control_status_t()
        status.tick, status.lateness_us, status.compute_us = tick, lateness_us, 900
        jitter = late_stamps_us * (tick % 2)
        writer.write("CONTROL_STATUS", utime + jitter, status, skip=int(tick in lose_at))
        if tick % command_every == 0:
            writer.write("G1_LOW_CMD", utime, g1_low_cmd_t())
        if tick % 25 == 0:
            elapsed_s = tick * 0.02
            beat = heartbeat_t()
            beat.process, beat.host, beat.state = "control", "here", heartbeat_t.READY
            memory_kb = 100_000 + elapsed_s / 60.0 * growth_mb_per_min / 1.024e-3
            beat.detail = Usage(3.0 + cpu_share * elapsed_s, round(memory_kb)).text()
            writer.write("HEARTBEAT", utime, beat)
    writer.log.close()
    (folder / "logs").mkdir(exist_ok=True)
    (folder / "logs" / "control.log").write_text("a change\n" * log_lines)
    (folder / "journal").write_bytes(b"x" * 1000 * seconds)
    return folder


def lines_of(folder):
    lines = compare(read_costs(folder), load_budget())
    return {(line.name, line.what): line for line in lines}


def test_good_run_is_within_budget_and_every_figure_is_right(tmp_path):
    lines = lines_of(write_run(tmp_path, growth_mb_per_min=0.6, log_lines=3))
    assert lines["control", "cpu_share"].value == pytest.approx(0.05)
    assert lines["control", "memory_growth_mb_per_min"].value == pytest.approx(0.6, rel=0.01)
    assert lines["control", "memory_mb"].value == pytest.approx(103.0, rel=0.01)
    assert lines["control", "log_lines_per_min"].value == pytest.approx(3.0, rel=0.01)
    assert lines["control", "journal_mb_per_min"].value == pytest.approx(0.06, rel=0.01)
    assert lines["control", "lateness_p99_us"].value == 60.0
    assert lines["G1_LOW_CMD", "rate_error"].value == 0.0
    assert lines["CONTROL_STATUS", "jitter_p99_ms"].value == 0.0
    assert all(line.ok is not False for line in lines.values())


@pytest.mark.parametrize(
    ("fault", "name", "what"),
    [
        ({"cpu_share": 0.5}, "control", "cpu_share"),
        ({"growth_mb_per_min": 5.0}, "control", "memory_growth_mb_per_min"),
        ({"log_lines": 500}, "control", "log_lines_per_min"),
        ({"lateness_us": 9_000}, "control", "lateness_p99_us"),
        ({"late_stamps_us": 4_000}, "CONTROL_STATUS", "jitter_p99_ms"),
        ({"command_every": 2}, "G1_LOW_CMD", "rate_error"),
        ({"lose_at": range(0, 3000, 100)}, "CONTROL_STATUS", "lost"),
    ],
)
def test_each_excess_is_over_its_own_budget_alone(tmp_path, fault, name, what):
    lines = lines_of(write_run(tmp_path, **fault))
    over = {key for key, line in lines.items() if line.ok is False}
    assert (name, what) in over
    assert {key[0] for key in over} == {name}


def test_over_budget_is_exit_code_1_and_good_is_0(tmp_path, capsys):
    assert main(["budget", str(write_run(tmp_path)), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["ok"] is True
    write_run(tmp_path, cpu_share=0.9)
    assert main(["budget", str(tmp_path)]) == 1
    assert "OVER" in capsys.readouterr().out
    assert budget_command(tmp_path, None, as_json=True) == 1
    report = json.loads(capsys.readouterr().out)
    assert report["over"] == 1 and report["ok"] is False
    (over,) = (line for line in report["lines"] if line["ok"] is False)
    assert (over["group"], over["name"], over["what"]) == ("process", "control", "cpu_share")


def test_run_in_lockstep_has_exact_rates_and_no_processor_time(tmp_path):
    from downbeat.runtime.bus import MemqHub
    from downbeat.runtime.clock import SimClock
    from downbeat.runtime.log import LogWriter
    from downbeat.sim.lockstep import Lockstep
    from downbeat.tools.show import Show, ShowConfig, make_control, make_sim

    show = Show(ShowConfig(audio="", tracks="", index=""), tmp_path)
    clock, hub = SimClock(), MemqHub()
    log = LogWriter(tmp_path / "run.lcmlog")
    hub.tap(log.write)
    nodes = (
        make_sim(show, hub.endpoint("sim", clock)),
        make_control(show, hub.endpoint("control", clock)),
    )
    scheduler = Lockstep(clock, nodes)
    scheduler.run_until(clock.utime() + 3_000_000, lambda _utime: True)
    scheduler.close()
    log.close()
    lines = lines_of(tmp_path)
    for channel in ("G1_LOW_STATE", "G1_LOW_CMD", "SIM_TRUTH", "CONTROL_STATUS"):
        assert lines[channel, "rate_error"].value == 0.0, channel
        assert lines[channel, "lost"].value == 0.0, channel
    assert ("control", "cpu_share") not in lines
    assert lines["control", "missed"].value == 0.0


def test_bundled_table_names_processes_and_channels_that_exist():
    from downbeat.tools.run_realtime import TABLE

    budget = load_budget(BUDGET_PATH)
    assert set(budget.process) - {"default"} <= {name for name, *_ in TABLE}
    assert set(budget.channel) - {"default"} <= {n for n, row in CHANNELS.items() if row.rate_hz}


def test_wrong_tables_name_file_and_key(tmp_path):
    text = BUDGET_PATH.read_text()
    table = tmp_path / "budget.toml"
    table.write_text(text.replace("[process.default]", "[process.other]"))
    with pytest.raises(ToolError, match=r"budget.toml:process.default is missing"):
        load_budget(table)
    table.write_text(text.replace("[channel.HEARTBEAT]", "[channel.HEARTBEET]"))
    with pytest.raises(ToolError, match=r"budget.toml:channel.HEARTBEET"):
        load_budget(table)
    table.write_text(text.replace("compute_p99_us", "compute_us"))
    with pytest.raises(ConfigError, match=r"budget.toml:control.compute_us"):
        load_budget(table)


def test_folder_without_a_log_is_one_sentence(tmp_path, capsys):
    assert main(["budget", str(tmp_path)]) == 2
    assert "run.lcmlog" in capsys.readouterr().err


def test_old_runs_without_usage_are_not_measured(tmp_path):
    writer = RunWriter(tmp_path)
    beat = heartbeat_t()
    beat.process, beat.state = "sim", heartbeat_t.READY
    writer.write("HEARTBEAT", START, beat)
    writer.log.close()
    costs = read_costs(tmp_path)
    assert costs.processes == {} and np.size(costs.lateness_us) == 0
    assert all(line.value is None for line in compare(costs, load_budget()))
