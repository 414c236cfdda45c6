"""Start one process of a show: its bus endpoint, its clock, its loop."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from downbeat.lcm_types import operator_command_t
from downbeat.runtime.bus import DEFAULT_URL, Bus, open_udpm
from downbeat.runtime.clock import TimeBase, WallClock
from downbeat.runtime.node import Node, run_node
from downbeat.runtime.rate import RateKeeper
from downbeat.runtime.realtime import configure_real_time
from downbeat.tools.commands.processes import ProcessArgs
from downbeat.tools.errors import ToolError
from downbeat.tools.show import (
    SHOW_NAME,
    Show,
    load_show,
    make_checker,
    make_conductor,
    make_control,
    make_core,
    make_listener,
    make_sim,
    make_speech,
)

MUSIC_DELAY_US = 1_000_000
"""From the operator's go to the first sample."""
SIM_PRIORITY, CONTROL_PRIORITY = 60, 50
"""The plant stands for the world, which does not wait; control comes next."""
SIM_CATCH_UP = 25


class DeferredListener:
    """The listener, whose music starts when the operator says so (OPERATOR_COMMAND CONFIRM)."""

    name = "listener"
    period_us = 50_000

    def __init__(self, bus: Bus, start: Callable[[int], Any]) -> None:
        self._bus = bus
        self._start = start
        self._node: Any = None
        bus.subscribe("OPERATOR_COMMAND")

    def step(self, utime: int) -> None:
        """Wait for the go, then listen."""
        if self._node is not None:
            self._node.step(utime)
            return
        self._bus.pump()
        for received in self._bus.take("OPERATOR_COMMAND"):
            if received.msg.command == operator_command_t.CONFIRM:
                self._node = self._start(utime + MUSIC_DELAY_US)
                return

    def close(self) -> None:
        """Close the listener."""
        if self._node is not None:
            self._node.close()


def run_process(name: str, args: ProcessArgs) -> int:
    """Run the process `name` until it is told to stop."""
    show = load_show(args.show)
    base = TimeBase(args.epoch_utime, args.epoch_monotonic_ns) if args.epoch_utime else None
    clock = WallClock(base)
    url = args.url or DEFAULT_URL
    if name == "recorder":
        from downbeat.runtime.log import RecorderNode

        recorder = RecorderNode(url, clock, show.folder / "run.lcmlog")
        run_node(recorder, clock, open_udpm(url, clock, name))
        return 0
    bus = open_udpm(url, clock, name)
    if name == "checker":
        return _checker(show, bus, clock, getattr(args, "engine", "native"))
    starters = {
        "sim": _sim,
        "control": _control,
        "listener": partial(_listener, is_alone=base is None),
        "conductor": _conductor,
        "speech": _speech,
    }
    return starters[name](show, bus, clock)


def _sim(show: Show, bus: Bus, clock: WallClock) -> int:
    node = make_sim(show, bus)
    _announce(node.name, configure_real_time(SIM_PRIORITY))
    keeper = RateKeeper(clock, node.period_us, max_catch_up=SIM_CATCH_UP)
    run_node(node, clock, bus, rate=keeper)
    return 0


def _control(show: Show, bus: Bus, clock: WallClock) -> int:
    from downbeat.tools.control_journal import JOURNAL_NAME, ControlJournal

    core = make_core(show)
    journal = ControlJournal(show.folder / JOURNAL_NAME, show, core)
    keeper = RateKeeper(clock, 20_000)
    node = make_control(show, bus, journal.record, keeper.timing, core)
    cpu = None if show.config.control_cpu < 0 else show.config.control_cpu
    _announce(node.name, configure_real_time(CONTROL_PRIORITY, cpu=cpu))
    try:
        run_node(node, clock, bus, rate=keeper)
    finally:
        journal.close()
    return 0


def _listener(show: Show, bus: Bus, clock: WallClock, is_alone: bool) -> int:
    """Listen: to a file when the operator says so, to what is live and by itself at once."""
    from downbeat.perception.source_spec import is_live

    if not is_alone and not is_live(show.config.audio):
        node: Node = DeferredListener(bus, lambda start: make_listener(show, bus, start))
        make_listener(show, bus, 2**62)  # load files and warm up now, not at the go
        run_node(node, clock, bus)
        return 0
    from downbeat.tools.hearing import Narrator

    narrator = Narrator(lambda line: print(line, flush=True))
    listener = make_listener(show, bus, clock.utime())
    bus.tap = narrator
    run_node(listener, clock, bus, should_stop=lambda: is_alone and narrator.is_finished)
    return 0


def _conductor(show: Show, bus: Bus, clock: WallClock) -> int:
    run_node(make_conductor(show, bus), clock, bus)
    return 0


def _speech(show: Show, bus: Bus, clock: WallClock) -> int:
    def say(line: str) -> None:
        print(line, flush=True)

    node = make_speech(show, bus, clock.utime(), is_simulated_time=False, say=say)
    if node is None:
        raise ToolError(f"{show.folder / SHOW_NAME} has no speech; name a speech.toml (speech).")
    run_node(node, clock, bus)
    return 0


def _checker(show: Show, bus: Bus, clock: WallClock, engine: str = "native") -> int:
    become_idle()
    node = make_checker(show, bus, is_simulated_time=False, engine=engine)
    if node is None:
        raise ToolError(f"{show.folder / SHOW_NAME} asks for no checker (checker, transitions).")
    run_node(node, clock, bus)
    return 0


def become_idle() -> None:
    """Take only the time that nobody else wants."""
    os.nice(19)
    if hasattr(os, "SCHED_IDLE"):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))


def _announce(name: str, report: Any) -> None:
    """Say once what real-time rights were not granted."""
    for message in report.messages:
        print(f"{name}: {message}", file=sys.stderr, flush=True)


def default_url(url: str) -> str:
    """Return the URL to use."""
    return url or DEFAULT_URL


def log_folder(run_dir: Path) -> Path:
    """Return where the processes' own output goes."""
    folder = run_dir / "logs"
    folder.mkdir(exist_ok=True)
    return folder
