"""The process "bridge": DDS on one side, LCM on the other, the core in between."""

from __future__ import annotations

import logging
import select
import threading
import time
from collections.abc import Callable
from typing import Any, Protocol

from downbeat.control.bridge.core import BridgeCore
from downbeat.control.bridge.counters import BridgeTimes
from downbeat.control.bridge.motion_service import MotionService
from downbeat.control.bridge.stages import NEXT, Stage
from downbeat.lcm_types import estop_t, operator_command_t
from downbeat.runtime.bus import Bus

log = logging.getLogger("downbeat.bridge")

PERIOD_US = 2_000
LATE_US = 1_000
"""A state may be so late before the last command is repeated without it."""
LEAST_GAP_US = 1_500
"""A robot that reports faster than 500 Hz is not answered faster."""
SLOW_PERIOD_US = 100_000
PUMP_EVERY = 5
SILENT_WAIT_S = 0.02
TORSO_STALE_US = 50_000
REPEATED_ESTOPS = 3
BMS_SOC, BMS_BYTES = 104, 105
"""Offset of `soc` [%] in a BmsState on the wire."""


class Samples(Protocol):
    """One topic's samples as bytes."""

    def take(self) -> list[bytes]:
        """Return what has come since the last take."""
        ...


class Motors(Protocol):
    """Where LowCmd goes."""

    def write(self, payload: bytes) -> None:
        """Send one sample."""
        ...


class Waiter(Protocol):
    """What the loop waits for.

    Attributes:
        was_woken: Somebody called `wake` since this was last set to False.
    """

    was_woken: bool

    def wait(self, timeout_s: float) -> None:
        """Return when something has come, or after the time."""
        ...

    def wake(self) -> None:
        """End a wait, from another thread."""
        ...


class RobotTopics:
    """The robot's topics that the bridge reads and writes."""

    def __init__(
        self,
        states: Samples,
        torso_imu: Samples,
        battery: Samples,
        foreign_commands: Samples,
        motors: Motors,
        motion: MotionService,
        waiter: Waiter,
    ) -> None:
        self.states, self.torso_imu, self.battery = states, torso_imu, battery
        self.foreign_commands, self.motors = foreign_commands, motors
        self.motion, self.waiter = motion, waiter


class BridgeNode:
    """Node "bridge": woken by the robot's states and by control's commands, 500 times a second.

    Every state is decoded, judged and passed on; every LowCmd answers one, or comes 3 ms after
    the last when none arrives. A new command goes out at once, between two states too.
    """

    name = "bridge"
    period_us = PERIOD_US

    def __init__(
        self,
        bus: Bus,
        topics: RobotTopics,
        core: BridgeCore,
        say: Callable[[str], None],
    ) -> None:
        """Wire the process.

        Args:
            bus: Endpoint of the process "bridge".
            topics: Of the robot.
            core: Decides.
            say: Tells the operator one line, once per change.
        """
        self._bus, self._topics, self.core, self._say = bus, topics, core, say
        self._clock = bus.clock
        self.times = BridgeTimes()
        self.obeys_control = True
        """G1_LOW_CMD counts; not when another controller takes its place (`--compat`)."""
        self._next_slow = 0
        self._last_write = 0
        self._torso_utime = 0
        self._said = ""
        self._estop_left: list[str] = []
        self._stamp = 0
        self._unpumped = 0
        bus.subscribe("G1_LOW_CMD", "OPERATOR_COMMAND", "ESTOP")

    def cycle(self) -> None:
        """Wait for the next thing to happen and deal with it; about 500 times a second."""
        self._topics.waiter.wait(self._patience_s())
        arrived = self._clock.utime()
        has_state = self._take_states(arrived)
        has_command = self._take_bus(arrived)
        core = self.core
        core.update(arrived)
        self._write(arrived, has_state, has_command)
        if arrived >= self._next_slow:
            self._next_slow = arrived + SLOW_PERIOD_US
            self._slow(arrived)
        elif core.outbox.estops or core.outbox.operator:
            self._publish_events(arrived)

    def _patience_s(self) -> float:
        if self.core.is_silent:
            return SILENT_WAIT_S
        due = self._last_write + PERIOD_US + LATE_US
        return max(0.0, (due - self._clock.utime()) * 1e-6)

    # ------------------------------------------------------------------ in

    def _take_states(self, arrived: int) -> bool:
        """Judge what the robot sent; publish the newest good state."""
        core = self.core
        good = 0
        for payload in self._topics.states.take():
            good += core.take_state(payload, arrived)
        if not good:
            return False
        decoder = core.decoder
        for payload in self._topics.torso_imu.take()[-1:]:
            if decoder.take_torso_imu(payload):
                self._torso_utime = arrived
        if self._torso_utime and arrived - self._torso_utime > TORSO_STALE_US:
            decoder.forget_torso_imu()
            self._torso_utime = 0
        # Stamps on one channel never repeat, however fast a simulator is.
        self._stamp = max(arrived, self._stamp + 1)
        self._bus.publish_encoded("G1_LOW_STATE", decoder.message(self._stamp))
        self.times.states += 1
        self.times.superseded += good - 1
        self.times.state_us.add(self._clock.utime() - arrived)
        return True

    def _take_bus(self, arrived: int) -> bool:
        """Take control's commands, the operator's, and emergency stops."""
        # Woken for it, or to be on the safe side: most cycles have nothing on LCM.
        waiter = self._topics.waiter
        self._unpumped += 1
        if not waiter.was_woken and self._unpumped < PUMP_EVERY:
            return False
        waiter.was_woken = False
        self._unpumped = 0
        if not self._bus.pump():
            return False
        core = self.core
        for received in self._bus.take("ESTOP"):
            core.take_estop(received.msg, arrived)
        for received in self._bus.take("OPERATOR_COMMAND"):
            core.take_operator(received.msg.command, arrived)
        commands = self._bus.take("G1_LOW_CMD")
        if not self.obeys_control:
            core.commands_refused += len(commands)
            return False
        for received in commands[-1:]:
            core.take_command(received.msg, arrived)
        return bool(commands)

    # ------------------------------------------------------------------ out

    def _write(self, arrived: int, has_state: bool, has_command: bool) -> None:
        since = arrived - self._last_write
        is_due = since >= PERIOD_US or (has_state and since >= LEAST_GAP_US)
        if not (is_due or (has_command and self.core.stage is Stage.ACTIVE)):
            return
        payload = self.core.output(arrived)
        if payload is None:
            return
        self._topics.motors.write(payload)
        self._last_write = arrived
        self.times.writes += 1
        if has_command:
            self.times.command_us.add(self._clock.utime() - arrived)

    def brake(self) -> None:
        """Send damping once and wait a period: when nothing else works any more."""
        payload = self.core.output(self._clock.utime())
        if payload is not None:
            self._topics.motors.write(payload)
        time.sleep(PERIOD_US * 1e-6)

    def _slow(self, utime: int) -> None:
        """Ten times a second: battery, other commanders, services, messages, one line of text."""
        core, topics = self.core, self._topics
        for payload in topics.battery.take()[-1:]:
            if len(payload) >= BMS_BYTES and payload[BMS_SOC] <= 100:
                core.watch.battery_soc = core.decoder.battery_soc = payload[BMS_SOC] * 0.01
        core.note_foreign(len(topics.foreign_commands.take()), utime)
        if core.is_silent:
            topics.motion.update(utime, core.wants_release)
            core.motion_service = topics.motion.active
        self._publish_events(utime)
        text = self.text(utime)
        if text != self._said:
            self._said = text
            self._say(text)

    def _publish_events(self, utime: int) -> None:
        outbox = self.core.outbox
        for command in outbox.operator:
            msg: Any = operator_command_t()
            msg.header.utime = utime
            msg.command, msg.source = command, "bridge"
            self._bus.publish("OPERATOR_COMMAND", msg)
        outbox.operator.clear()
        for reason in outbox.estops:
            self._estop_left += [reason] * REPEATED_ESTOPS
        outbox.estops.clear()
        if self._estop_left:  # one each time: UDP may lose one, not three
            stop: Any = estop_t()
            stop.header.utime = utime
            stop.level, stop.source = estop_t.DAMP, "bridge"
            stop.reason = self._estop_left.pop()
            self._bus.publish("ESTOP", stop)

    def text(self, utime: int) -> str:
        """Say where the bridge is and what it waits for."""
        core = self.core
        if core.stage is Stage.CHECKING:
            return f"checking: {core.missing(utime) or 'all is well'}"
        if core.stage is Stage.TRIPPED:
            return f"DAMPING: {core.trip} It stays so until `downbeat stop --level clear`."
        following = NEXT.get(core.stage)
        stage = core.stage.name.lower().replace("_", " ")
        if following is None:
            return stage
        if hindrance := core.hindrance(utime):
            return f"{stage}: {hindrance}"
        return f"{stage}; press {core.settings.confirm_button} to {following}"

    @property
    def detail(self) -> str:
        """For the heartbeat."""
        core, counters = self.core, self.core.decoder.counters
        bad = sum(counters.rejected.values())
        return (
            f"stage={core.stage.name} states={self.times.states} lost={counters.lost} "
            f"rejected={bad} writes={self.times.writes} refused={core.commands_refused}"
            + (f" last_rejected={counters.last_reason!r}" if bad else "")
            + (f" trip={core.trip!r}" if core.trip else "")
        )

    def close(self) -> None:
        """Nothing to release; the loop has left through damping."""


class WakeOnLcm(threading.Thread):
    """Ends the loop's wait when LCM has something: 50 commands a second, not 500 states."""

    def __init__(self, descriptor: int, waiter: Waiter) -> None:
        super().__init__(name="wake-on-lcm", daemon=True)
        self._waiter = waiter
        self._poll = select.epoll()
        # Edge-triggered: LCM's pipe stays readable until the loop has drained it.
        self._poll.register(descriptor, select.EPOLLIN | select.EPOLLET)
        self.is_stopped = False

    def run(self) -> None:
        """Wake until stopped."""
        while not self.is_stopped:
            if self._poll.poll(0.5) and not self.is_stopped:
                self._waiter.wake()
        self._poll.close()
