"""`downbeat bridge`: open both buses, run, and say in one sentence why it ended."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from downbeat.control.bridge.core import BridgeCore
from downbeat.control.bridge.dds_config import LOOPBACK, port_clash
from downbeat.control.bridge.loop import open_service, robot_topics, run_bridge
from downbeat.control.bridge.node import BridgeNode, WakeOnLcm
from downbeat.control.bridge.settings import BridgeSettings
from downbeat.control.bridge.stages import Stage
from downbeat.runtime.bus import DEFAULT_URL, open_udpm, parse_udpm_url
from downbeat.runtime.clock import TimeBase, WallClock
from downbeat.runtime.config import load_config
from downbeat.runtime.node import stop_signals
from downbeat.runtime.realtime import configure_real_time
from downbeat.tools.errors import ToolError

BRIDGE_PRIORITY = 65
"""Above control: the last command must be repeated also while control thinks."""


@dataclass(frozen=True)
class BridgeOptions:
    """What the command line says; see `downbeat bridge --help`."""

    interface: str
    domain: int = 0
    url: str = ""
    settings: Path | None = None
    auto: bool = False
    compat: bool = False
    lights: bool = True
    patience_s: float = 120.0
    base: TimeBase | None = None


def open_link(interface: str, domain: int) -> Any:
    """Join the robot's DDS domain.

    Raises:
        DownbeatError: No cyclonedds, no such interface or domain.
    """
    try:
        from downbeat.control.bridge.dds import Link
    except ImportError as error:
        raise ToolError(
            f"The bridge needs cyclonedds, and it cannot be loaded ({error}); install it with "
            "`pip install 'downbeat[g1]'`."
        ) from error
    return Link(interface, domain)


def say(text: str) -> None:
    """Tell the operator."""
    print(f"bridge: {text}", file=sys.stderr, flush=True)


def bridge(options: BridgeOptions) -> int:
    """Run the bridge until it is told to stop.

    Returns:
        0: told to stop; 1: the robot could not be taken over within the patience.

    Raises:
        DownbeatError: Wrong options, no multicast, no DDS.
    """
    lenient = options.interface == LOOPBACK
    if options.auto and not lenient:
        raise ToolError(
            f"--auto is for simulators on {LOOPBACK!r}, not for {options.interface!r}; on a robot "
            "every step is confirmed on the remote."
        )
    settings = load_config(options.settings, BridgeSettings) if options.settings else None
    url = parse_udpm_url(options.url or DEFAULT_URL)
    if clash := port_clash(options.domain, url.port):
        say(f"warning: {clash}.")
    # LCM first: Cyclone then skips the port, where LCM would only print a line and hear nothing.
    clock = WallClock(options.base)
    bus = open_udpm(url.text(), clock, "bridge")
    link = open_link(options.interface, options.domain)
    core = BridgeCore(settings or BridgeSettings(), lenient, options.auto)
    node = BridgeNode(bus, robot_topics(link, lenient), core, say)
    extras = _extras(options, link, bus, node)
    waker = WakeOnLcm(bus.fileno(), link)
    waker.start()
    for message in configure_real_time(BRIDGE_PRIORITY).messages:
        say(message)
    patience = _Patience(core, options.patience_s)
    with stop_signals() as is_signalled:
        run_bridge(node, bus, waker, lambda: is_signalled() or patience.is_over(), extras)
    say(summary(node))
    if patience.has_given_up:
        say(f"gave up: {core.missing(clock.utime())}.{_hint(link, core)}")
    link.close()
    return 1 if patience.has_given_up else 0


def _extras(
    options: BridgeOptions, link: Any, bus: Any, node: BridgeNode
) -> Callable[[int], None] | None:
    """Return what runs beside the bridge proper, None for nothing."""
    runs: list[Callable[[int], None]] = []
    if options.lights:
        from downbeat.control.bridge.lights import Lights
        from downbeat.control.bridge.voice import SERVICE, RobotSpeaker

        runs.append(Lights(bus, node.core, RobotSpeaker(open_service(link, SERVICE))))
    if options.compat:
        from downbeat.control.bridge.compat import open_compat

        url = parse_udpm_url(options.url or DEFAULT_URL)
        node.obeys_control = False
        runs.append(open_compat(url.text(), node.core))
    if not runs:
        return None

    def run_all(utime: int) -> None:
        for run in runs:
            run(utime)

    return run_all


class _Patience:
    """How long the bridge may look for a robot that it can command."""

    def __init__(self, core: BridgeCore, seconds: float) -> None:
        self._core = core
        self._end = time.monotonic() + seconds if seconds > 0.0 else float("inf")
        self.has_given_up = False

    def is_over(self) -> bool:
        """Whether it has not been taken over in time; asked every cycle."""
        if self._core.stage is Stage.CHECKING and time.monotonic() > self._end:
            self.has_given_up = True
        elif self._core.stage is not Stage.CHECKING:
            self._end = float("inf")
        return self.has_given_up


def _hint(link: Any, core: BridgeCore) -> str:
    """Say more when a robot is there and nothing can be read from it."""
    if core.watch.num_states or core.decoder.counters.rejected:
        return ""
    writers = link.publishers_of("rt/lowstate")
    if not writers:
        return " Nobody publishes rt/lowstate here: check --interface and --domain."
    return (
        " Somebody publishes rt/lowstate, but with another type: programs on cyclonedds 11 with "
        "the vendor's Python types (uint8) are not understood, nor do they understand the robot."
    )


def summary(node: BridgeNode) -> str:
    """Return what happened, in one line."""
    times, counters = node.times, node.core.decoder.counters
    state, command = times.state_us.stats(), times.command_us.stats()
    rejected = ", ".join(f"{reason}: {count}" for reason, count in counters.rejected.items())
    return (
        f"{times.states} states, {counters.lost} lost, {times.superseded} superseded, "
        f"rejected {rejected or 'none'}; {times.writes} commands written; state to LCM p50 "
        f"{state.p50_us:.0f} p99 {state.p99_us:.0f} us, command to DDS p50 {command.p50_us:.0f} "
        f"p99 {command.p99_us:.0f} us"
    )
