"""`downbeat bench bridge`: what the bridge adds between a robot on DDS and control on LCM.

Three processes: a robot that writes states, the bridge as it runs on a robot, and a control process
that sends commands (`bench_bridge_worker.py`). Two numbers per direction: *total* is from just
before one end's write to after the other end's read, both networks and two wake-ups included;
*added* is what the bridge itself takes, from its own wake-up to the end of its write.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from downbeat.tools.bench_control import busy_processors
from downbeat.tools.doctor_machine import cpu_times
from downbeat.tools.errors import ToolError

TARGET_ADDED_US, TARGET_CPU_MS = 1000.0, 0.15
CYCLE_MS = 2.0
READY_S = 20.0
LEAD_S = 1.0
SETTINGS = "ramp_s = 1.0\nleave_s = 0.5\nstate_stale_s = 0.5\ncontrol_timeout_s = 10.0\n"


@dataclass(frozen=True)
class BridgeBlock:
    """One measurement.

    Attributes:
        state: "idle" or "loaded".
        seconds: Length [s].
        total_state_us: p50, p99, max from a state's write on DDS to its arrival on LCM [us].
        total_command_us: The same from a command's publication on LCM to its arrival on DDS.
        added_state_us: p50, p99 inside the bridge [us].
        added_command_us: The same.
        cpu_ms_per_cycle: Processor time of all the bridge's threads per 2 ms.
        states_lost: Of those sent, not seen on LCM, as a share.
        commands_lost: Of those sent, not seen on DDS, as a share.
        lowcmd_hz: Rate of LowCmd at the robot.
        others_busy: Share of the processors that others kept busy just before.
    """

    state: str
    seconds: float
    total_state_us: tuple[float, float, float]
    total_command_us: tuple[float, float, float]
    added_state_us: tuple[float, float]
    added_command_us: tuple[float, float]
    cpu_ms_per_cycle: float
    states_lost: float
    commands_lost: float
    lowcmd_hz: float
    others_busy: float


def _worker(*arguments: str) -> subprocess.Popen[str]:
    argv = [sys.executable, "-m", "downbeat.tools.bench_bridge_worker", *arguments]
    return subprocess.Popen(argv, stdout=subprocess.PIPE, text=True)


def _cpu_s(pid: int) -> float:
    """Return the processor time of a process so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _percentiles(samples: list[float], *shares: float) -> tuple[float, ...]:
    if not samples:
        return tuple(float("nan") for _ in shares)
    return tuple(round(float(value), 1) for value in np.percentile(samples, shares))


def measure(seconds: float, is_loaded: bool, domain: int) -> BridgeBlock:
    """Run the three processes once.

    Raises:
        ToolError: The bridge did not take the robot over.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        url = f"udpm://239.255.76.67:{min(probe.getsockname()[1], 65533)}?ttl=0"
    length_s = seconds + 12.0
    others = _busy_share()
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        settings = Path(folder) / "bridge.toml"
        settings.write_text(SETTINGS, encoding="utf-8")
        robot = stack.enter_context(_worker("robot", str(domain), str(length_s)))
        control = stack.enter_context(_worker("control", url, str(length_s)))
        stack.callback(robot.kill)
        stack.callback(control.kill)
        argv = [sys.executable, "-m", "downbeat.tools.cli", "bridge", "--interface", "lo"]
        argv += ["--domain", str(domain), "--url", url, "--auto", "--settings", str(settings)]
        bridge = stack.enter_context(subprocess.Popen(argv, stderr=subprocess.PIPE, text=True))
        stack.callback(bridge.kill)
        assert bridge.stderr is not None
        said = ""
        end = time.monotonic() + READY_S
        while "active" not in said and bridge.poll() is None and time.monotonic() < end:
            said = bridge.stderr.readline()
        if "active" not in said:
            raise ToolError(f"The bridge did not get through to the robot: {said.strip()!r}.")
        with busy_processors() if is_loaded else ExitStack():
            time.sleep(LEAD_S)
            start_ns, start_cpu = time.monotonic_ns(), _cpu_s(bridge.pid)
            time.sleep(seconds)
            end_ns, end_cpu = time.monotonic_ns(), _cpu_s(bridge.pid)
        bridge.terminate()
        summary = bridge.stderr.read().strip().splitlines()[-1]
        ends = [json.loads(_last_line(worker)) for worker in (robot, control)]
    state = "loaded" if is_loaded else "idle"
    cpu_ms = (end_cpu - start_cpu) * 1e3 / ((end_ns - start_ns) * 1e-6 / CYCLE_MS)
    return _block(state, (start_ns, end_ns), (cpu_ms, others), ends[0], ends[1], summary)


def _busy_share() -> float:
    """Watch the machine for half a second."""
    stat = Path("/proc/stat")
    before = cpu_times(stat.read_text(encoding="ascii"))
    time.sleep(0.5)
    spent = np.subtract(cpu_times(stat.read_text(encoding="ascii")), before)
    return round(float(1.0 - (spent[3] + spent[4]) / max(1, spent.sum())), 2)


def _last_line(worker: subprocess.Popen[str]) -> str:
    assert worker.stdout is not None
    lines = worker.stdout.read().strip().splitlines()
    return lines[-1] if lines else "{}"


def _block(
    state: str,
    window: tuple[int, int],
    cost: tuple[float, float],
    robot: dict[str, Any],
    control: dict[str, Any],
    summary: str,
) -> BridgeBlock:
    """Match what was sent with what arrived inside the window [ns]."""
    first, last = window
    seen = dict(control["arrived"])
    states = [(tick + 1, at) for tick, at in enumerate(robot["written"]) if first <= at < last]
    state_us = [(seen[tick] - at) * 1e-3 for tick, at in states if tick in seen]
    commands = [(token, at) for token, at in control["sent"] if first <= at < last]
    command_us = []
    arrivals = iter([(t, at) for t, at in robot["arrived"] if at >= first])
    for token, sent in commands:  # both in order; tokens repeat after 4 s only
        for other, at in arrivals:
            if other == token and at >= sent:
                command_us.append((at - sent) * 1e-3)
                break
    lowcmds = [at for at in robot["lowcmds"] if first <= at < last]
    numbers = [float(word) for word in summary.replace(",", " ").split() if word.isdigit()]
    return BridgeBlock(
        state=state,
        seconds=round((last - first) * 1e-9, 2),
        total_state_us=_percentiles(state_us, 50, 99, 100),  # type: ignore[arg-type]
        total_command_us=_percentiles(command_us, 50, 99, 100),  # type: ignore[arg-type]
        added_state_us=(numbers[-4], numbers[-3]),
        added_command_us=(numbers[-2], numbers[-1]),
        cpu_ms_per_cycle=round(cost[0], 4),
        others_busy=cost[1],
        states_lost=round(1.0 - len(state_us) / max(1, len(states)), 5),
        commands_lost=round(1.0 - len(command_us) / max(1, len(commands)), 5),
        lowcmd_hz=round(len(lowcmds) / ((last - first) * 1e-9), 1),
    )


def bench_bridge(seconds: float, load: bool, as_json: bool) -> int:
    """Measure, print; 0 if the idle block is within the targets, else 1.

    Raises:
        ToolError: No cyclonedds, or the bridge did not get through.
    """
    try:
        import cyclonedds  # noqa: F401
    except ImportError as error:
        raise ToolError(
            "The bench needs cyclonedds; install it with `pip install 'downbeat[g1]'`."
        ) from error
    blocks = [measure(seconds, False, 61)]
    if load:
        blocks.append(measure(seconds, True, 62))
    idle = blocks[0]
    is_good = idle.cpu_ms_per_cycle <= TARGET_CPU_MS and all(
        added[1] <= TARGET_ADDED_US for added in (idle.added_state_us, idle.added_command_us)
    )
    if as_json:
        print(json.dumps({"blocks": [asdict(block) for block in blocks], "good": is_good}))
    else:
        _print(blocks)
    return 0 if is_good else 1


def _print(blocks: list[BridgeBlock]) -> None:
    table = Table("what", *[block.state for block in blocks], "target")
    rows = (
        ("DDS to LCM, added p50/p99 [us]", "added_state_us", f"p99 <= {TARGET_ADDED_US:.0f}"),
        ("LCM to DDS, added p50/p99 [us]", "added_command_us", f"p99 <= {TARGET_ADDED_US:.0f}"),
        ("DDS to LCM, total p50/p99/max [us]", "total_state_us", ""),
        ("LCM to DDS, total p50/p99/max [us]", "total_command_us", ""),
        ("processor time per 2 ms [ms]", "cpu_ms_per_cycle", f"<= {TARGET_CPU_MS}"),
        ("states lost", "states_lost", ""),
        ("commands lost", "commands_lost", ""),
        ("LowCmd at the robot [Hz]", "lowcmd_hz", ""),
        ("kept busy by others before", "others_busy", ""),
    )
    for title, name, target in rows:
        values = [getattr(block, name) for block in blocks]
        cells = [
            " / ".join(f"{v:.0f}" for v in value) if isinstance(value, tuple) else f"{value:g}"
            for value in values
        ]
        table.add_row(title, *cells, target)
    Console().print(table)
