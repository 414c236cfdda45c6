"""Play a scenario on a running bus, in real time, beside the processes of a simulated robot.

What it sends stays on this machine (ttl=0), and never reaches a real robot: it listens before it
speaks, and falls silent as soon as a state comes from hardware.
"""

from __future__ import annotations

import math
import secrets
from typing import Any

import lcm

from downbeat.lcm_types import g1_low_state_t
from downbeat.lcm_types.channels import CHANNELS
from downbeat.runtime.bus import open_udpm, parse_udpm_url
from downbeat.runtime.clock import WallClock
from downbeat.runtime.errors import one_of
from downbeat.runtime.traffic import Impairer, Injector
from downbeat.tools.errors import ToolError
from downbeat.tools.scenario import Scenario
from downbeat.tools.traffic_judge import Outcome, Seen, judge, judge_always

LISTEN_S = 0.5
MAX_WAIT_S = 0.005
HEARD = ("CONTROL_STATUS", "SKILL_STATUS", "G1_LOW_CMD", "SIM_TRUTH")
HARDWARE = int(g1_low_state_t.SOURCE_HARDWARE)


def play_on_bus(scenario: Scenario, url: str) -> tuple[Outcome, int]:
    """Publish a scenario's requests and injections on a running bus, and judge what follows.

    Args:
        scenario: What happens; impairments apply to its own messages.
        url: LCM URL with ttl=0.

    Returns:
        What happened (no ticks if no control was heard), and how many messages were sent.

    Raises:
        ToolError: It would leave this machine, reach a real robot, command motors without saying
            so, or impair messages that it does not carry.
    """
    refuse_unfit(scenario, url)
    witness = Witness(url)
    try:
        witness.listen(LISTEN_S)
        witness.refuse_robot(scenario)
        count = _publish(scenario, url, witness)
    finally:
        witness.close()
    outcome = witness.outcome
    if outcome.ticks:
        outcome.problems += judge_always(outcome)
        for one in scenario.expect:
            outcome.problems += judge(one, outcome)
    return outcome, count


def refuse_unfit(scenario: Scenario, url: str) -> None:
    """Refuse what may not be played on a running bus, before anything is opened.

    Raises:
        ToolError: See `play_on_bus`.
    """
    if parse_udpm_url(url).ttl > 0:
        raise ToolError(
            f"Traffic is not played on {url}: with ttl > 0 it leaves this machine, and a robot may "
            "be listening; valid is ttl=0 (--url)."
        )
    own = {one.channel for one in (*scenario.requests, *scenario.inject)}
    others = {one.channel for one in scenario.impair} - own
    if others:
        raise ToolError(
            f"Messages of {one_of(others)} cannot be impaired on a running bus: nobody but the "
            "network stands between its processes. Without --url the scenario is played in "
            "lockstep (impair.channel)."
        )
    if "G1_LOW_CMD" in own and not scenario.may_command_motors:
        raise ToolError(
            "The scenario injects G1_LOW_CMD; on a running bus that needs "
            "`may_command_motors = true` (inject.channel)."
        )


class Witness:
    """Hears what control and the plant say, and who the robot is."""

    def __init__(self, url: str) -> None:
        """Open the bus, listening only.

        Raises:
            BusError: The URL is not one, or this machine carries no multicast.
        """
        self.clock = WallClock()
        self.outcome = Outcome()
        self.start_utime = 0
        """Scenario time 0 on the time base of the bus [us]."""
        self.ahead_us = 0
        """What the time base of the bus is ahead of ours; follows CONTROL_STATUS."""
        self.own_epochs: frozenset[int] = frozenset()
        self.sources: set[int] = set()
        self._bus = open_udpm(url, self.clock, "traffic")
        self._bus.tap = self._look
        self._bus.subscribe(*HEARD)
        self._bus.subscribe_newest("G1_LOW_STATE")
        self._commands: dict[int, Any] = {}
        self._height_m = math.nan

    def _look(self, channel: str, payload: bytes) -> None:
        """Note where every state comes from, valid or not, whoever publishes it."""
        if channel != "G1_LOW_STATE":
            return
        try:
            msg = g1_low_state_t.decode(payload)
        except Exception:  # garbage has no source
            return
        if msg.header.epoch not in self.own_epochs:
            self.sources.add(msg.source)

    def utime(self) -> int:
        """Return now on the time base of the bus [us]; our own where nobody speaks."""
        return self.clock.utime() + self.ahead_us

    def listen(self, seconds: float) -> None:
        """Hear who is there, and what time it is on their base."""
        end = self.clock.utime() + round(seconds * 1e6)
        while self.clock.utime() < end:
            self.pump(MAX_WAIT_S)
        self.outcome = Outcome()

    def refuse_robot(self, scenario: Scenario) -> None:
        """Refuse to speak when a real robot listens.

        Raises:
            ToolError: The state comes from hardware; or motors shall be commanded and nothing says
                that they are simulated.
        """
        if HARDWARE in self.sources:
            raise ToolError(
                "G1_LOW_STATE on this bus comes from a real robot; traffic is only played beside a "
                "simulated one (--url)."
            )
        commands = any(one.channel == "G1_LOW_CMD" for one in scenario.inject)
        if commands and g1_low_state_t.SOURCE_SIM not in self.sources:
            raise ToolError(
                "The scenario injects G1_LOW_CMD, and no simulated robot is heard on this bus; "
                "start `downbeat sim` first (--url)."
            )

    def pump(self, wait_s: float) -> None:
        """Take in what has arrived; waits for it at most `wait_s`."""
        bus = self._bus
        bus.pump(wait_s)
        for received in bus.take("G1_LOW_CMD"):
            self._commands[received.msg.header.utime] = received.msg
        for received in bus.take("SIM_TRUTH"):
            self._height_m = float(received.msg.qpos[2])
        for received in bus.take("CONTROL_STATUS"):
            utime = received.msg.header.utime
            if received.msg.header.epoch not in self.own_epochs:
                self.ahead_us = utime - received.recv_utime
            command = self._commands.pop(utime, None)
            if command is not None:
                time_s = (utime - self.start_utime) * 1e-6
                seen = Seen(time_s, received.msg, command, self._height_m)
                self.outcome.ticks.append(seen)
        for received in bus.take("SKILL_STATUS"):
            msg = received.msg
            self.outcome.add_change(msg.request_id, msg.state, msg.reason)

    def close(self) -> None:
        """Leave the bus."""
        self._bus.close()


def _publish(scenario: Scenario, url: str, witness: Witness) -> int:
    """Send everything at its time; returns how many messages were sent."""
    start = witness.start_utime = witness.utime()
    offset = secrets.randbits(40)
    injections = (*scenario.requests, *scenario.inject)
    witness.own_epochs = frozenset(one.epoch + offset for one in injections)
    injector = Injector(injections, start, scenario.seed, epoch_offset=offset)
    impairer = Impairer(scenario.impair, start, scenario.seed)
    parsed = parse_udpm_url(url)
    links = {"main": lcm.LCM(parsed.text())}
    if any(CHANNELS[one.channel].group == "audio" for one in injections):
        links["audio"] = lcm.LCM(parsed.audio.text())
    end = start + round(scenario.seconds * 1e6)
    count = 0
    while (now := witness.utime()) < end:
        for utime, channel, payload in injector.take(now):
            impairer.feed(utime, channel, payload)
        for channel, payload in impairer.take(now):
            links[CHANNELS[channel].group].publish(channel, payload)
            count += 1
        due = [one for one in (injector.next_utime, impairer.next_utime) if one is not None]
        wait_s = (min(due, default=end) - witness.utime()) * 1e-6
        witness.pump(min(max(wait_s, 0.0), MAX_WAIT_S))
        witness.refuse_robot(scenario)
    return count
