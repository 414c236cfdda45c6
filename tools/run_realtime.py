"""Run a show in real time: every process its own, over LCM, with a live table."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.table import Table

from downbeat.lcm_types import (
    audio_source_t,
    control_status_t,
    heartbeat_t,
    music_match_t,
    operator_command_t,
)
from downbeat.runtime.bus import foreign_traffic, open_udpm
from downbeat.runtime.clock import TimeBase, WallClock
from downbeat.runtime.process import CrashPolicy, ProcessSpec, cli_argv
from downbeat.runtime.supervisor import Supervisor
from downbeat.tools.errors import ToolError
from downbeat.tools.processes import default_url, log_folder
from downbeat.tools.show import SHOW_NAME, Show, has_checker

TABLE = (
    ("sim", "sim", CrashPolicy.STOP_ALL),
    ("control", "control", CrashPolicy.STOP_ALL),
    ("recorder", "record", CrashPolicy.STOP_ALL),
    ("listener", "listen", CrashPolicy.STOP_ALL),
    ("conductor", "conduct", CrashPolicy.RESTART),
    ("checker", "check", CrashPolicy.RESTART),
    ("speech", "speech", CrashPolicy.RESTART),
)
READY_TIMEOUT_S = 60.0
STANDING_S = 1.0
TAIL_S = 2.0
MODES = {v: k for k, v in vars(control_status_t).items() if k.isupper() and isinstance(v, int)}


class Watcher:
    """What the operator's seat sees: the bus, listening only but for the go."""

    def __init__(self, url: str, clock: WallClock, wanted: frozenset[str]) -> None:
        self.wanted = wanted
        self.bus = open_udpm(url, clock, "operator")
        self.clock = clock
        self.bus.subscribe(
            "HEARTBEAT", "CONTROL_STATUS", "MUSIC_MATCH", "SKILL_STATUS", "AUDIO_SOURCE"
        )
        self.ready: set[str] = set()
        self.standing_since: int | None = None
        self.has_gone = False
        self.first_sample_utime: int | None = None
        self.has_finished_utime: int | None = None
        self.last_change = ""

    def pump(self) -> None:
        """Take in what has arrived."""
        self.bus.pump()
        now = self.clock.utime()
        for received in self.bus.take("HEARTBEAT"):
            if received.msg.state in (heartbeat_t.READY, heartbeat_t.DEGRADED):
                self.ready.add(received.msg.process)
        for received in self.bus.take("AUDIO_SOURCE"):
            self.first_sample_utime = received.msg.first_sample_utime
            if received.msg.state == audio_source_t.FINISHED:  # a device that failed may return
                self.has_finished_utime = now
        for received in self.bus.take("SKILL_STATUS"):
            msg = received.msg
            self.last_change = msg.reason or self.last_change
        status = self.status()
        stands = status is not None and status.mode == control_status_t.STAND
        if not stands:
            self.standing_since = None
        elif self.standing_since is None:
            self.standing_since = now

    def status(self) -> Any:
        """Return the newest CONTROL_STATUS, None before the first."""
        received = self.bus.latest("CONTROL_STATUS")
        return None if received is None else received.msg

    def is_ready(self) -> bool:
        """Whether every process is up and the robot has stood for a while."""
        up = self.wanted <= self.ready
        since = self.standing_since
        return up and since is not None and self.clock.utime() - since > STANDING_S * 1e6

    def go(self) -> None:
        """Start the music."""
        msg: Any = operator_command_t()
        msg.header.utime = self.clock.utime()
        msg.command = operator_command_t.CONFIRM
        msg.source = "demo"
        self.bus.publish("OPERATOR_COMMAND", msg)
        self.has_gone = True

    def show_s(self) -> float | None:
        """Return the position in the show [s]."""
        if self.first_sample_utime is None:
            return None
        return (self.clock.utime() - self.first_sample_utime) * 1e-6


def needed_by(show: Show) -> frozenset[str]:
    """Return the processes that must be up before the music starts."""
    names = {"sim", "control", "listener", "conductor"}
    return frozenset(names | set(extra_processes(show)))


def extra_processes(show: Show) -> tuple[str, ...]:
    """Return the processes that not every show has, and this one does."""
    speech = ("speech",) if show.config.speech else ()
    return (*speech, "checker") if has_checker(show) else speech


def run_realtime(show: Show, run_dir: Path, duration_s: float, url: str) -> None:
    """Start the process table, wait for the robot to stand, play, stop.

    Raises:
        DownbeatError: No multicast, somebody else on the channels, or a process failed.
    """
    url = default_url(url)
    refuse_company(url)
    base = TimeBase.now()
    watcher = Watcher(url, WallClock(base), needed_by(show))
    logs = log_folder(run_dir)
    specs = [
        ProcessSpec(
            name,
            cli_argv(command, "--show", str(run_dir / SHOW_NAME), "--url", url, base=base),
            policy,
            log_path=logs / f"{name}.log",
        )
        for name, command, policy in TABLE
        if name not in ("checker", "speech") or name in extra_processes(show)
    ]
    supervisor = Supervisor(specs)
    console = Console(stderr=True)
    started = time.monotonic()
    report = None
    with Live(console=console, refresh_per_second=4, transient=True) as live:

        def on_change(_table: Any) -> None:
            watcher.pump()
            if not watcher.has_gone and watcher.is_ready():
                watcher.go()
            live.update(live_table(watcher, supervisor, duration_s))

        def should_stop() -> bool:
            if not watcher.has_gone:
                return time.monotonic() - started > READY_TIMEOUT_S
            end = watcher.has_finished_utime
            return end is not None and watcher.clock.utime() - end > TAIL_S * 1e6

        report = supervisor.run(should_stop, on_change)
    watcher.bus.close()
    _relay_logs(logs)
    if not watcher.has_gone:
        raise ToolError(
            f"The show did not start within {READY_TIMEOUT_S:.0f} s: "
            f"{report.reason}; ready were {', '.join(sorted(watcher.ready)) or 'none'}; "
            f"the processes' output is in {logs}."
        )
    if not report.is_good:
        raise ToolError(f"The show ended early: {report.reason}; see {logs}.")


def refuse_company(url: str) -> None:
    """Refuse to start when somebody else publishes on our channels.

    Raises:
        ToolError: Another robot, simulator or show is on this group.
    """
    seen = foreign_traffic(url, 0.5)
    if seen:
        names = ", ".join(f"{channel} ({count})" for channel, count in sorted(seen.items()))
        raise ToolError(
            f"Another publisher is on {url}: {names}; stop it, or take another group with --url."
        )


def _relay_logs(logs: Path) -> None:
    """Show what the processes had to say, each line once."""
    for path in sorted(logs.glob("*.log")):
        for line in dict.fromkeys(path.read_text(errors="replace").splitlines()):
            print(f"{path.stem}: {line}", file=sys.stderr)


def live_table(watcher: Watcher, supervisor: Supervisor, duration_s: float) -> Table:
    """Return the live picture: what is heard, what is danced, how the processes are."""
    table = Table(title="Downbeat", expand=False)
    table.add_column("what", style="bold")
    table.add_column("now", min_width=56)
    show_s = watcher.show_s()
    if show_s is None:
        missing = watcher.wanted - watcher.ready
        wait = f"waiting for {', '.join(sorted(missing))}" if missing else "the robot gets up"
        table.add_row("show", wait)
    else:
        table.add_row("show", f"{max(show_s, 0.0):6.1f} / {duration_s:.0f} s")
    match = watcher.bus.latest("MUSIC_MATCH")
    if match is not None and match.msg.lock != music_match_t.LOST:
        lock = "locked" if match.msg.lock == music_match_t.LOCKED else "unsure"
        text = f"{match.msg.track} at {match.msg.tau_s:.1f} s ({lock}, {match.msg.similarity:.2f})"
        table.add_row("hears", text)
    else:
        table.add_row("hears", "nothing it knows")
    status = watcher.status()
    if status is not None:
        blend = f" <- {status.previous_skill}" if status.previous_skill else ""
        table.add_row("dances", f"{status.skill or '-'}{blend}  {MODES.get(status.mode, '?')}")
        table.add_row(
            "control",
            f"tick {status.tick}, missed {status.missed}, late {status.lateness_us} us, "
            f"compute {status.compute_us} us, tilt {status.tilt:.2f} rad",
        )
        if status.fault:
            table.add_row("fault", status.fault_text, style="red")
    for state in supervisor.snapshot():
        table.add_row(state.name, f"{state.state}, pid {state.pid}, up {state.uptime_s:.0f} s")
    return table
