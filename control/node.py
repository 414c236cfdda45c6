"""The control process: wires the bus to the pure core, 50 times a second."""

from __future__ import annotations

import math
from collections.abc import Callable

from downbeat.control.blackbox import BlackBox
from downbeat.control.core import ControlCore, TickInput, TickOutput
from downbeat.control.phase import TICK_US
from downbeat.lcm_types import skill_status_t
from downbeat.runtime.bus import Bus

SUBSCRIPTIONS = (
    "SKILL_REQUEST",
    "OPERATOR_SKILL_REQUEST",
    "OPERATOR_COMMAND",
    "ESTOP",
    "TRANSITION_VERDICT",
)
NEVER_US = 2**31 - 1
LARGEST_COUNT = 2**31 - 1


class ControlNode:
    """Node "control": pump, tick, publish, journal. Everything that decides is in the core."""

    name = "control"
    period_us = TICK_US

    def __init__(
        self,
        bus: Bus,
        core: ControlCore,
        journal: Callable[[TickInput, TickOutput], None] | None = None,
        timing: Callable[[], tuple[int, int, int]] | None = None,
        blackbox: BlackBox | None = None,
    ) -> None:
        """Wire the process.

        Args:
            bus: Endpoint of the process "control".
            core: The core, loaded and warm.
            journal: Writes one record per tick.
            timing: Returns (lateness_us, compute_us, missed) of the loop; zeros in lockstep.
            blackbox: Keeps the last seconds and writes them when the robot trips.
        """
        self._bus = bus
        self.core = core
        self._journal = journal
        self._timing = timing or (lambda: (0, 0, 0))
        self._blackbox = blackbox
        if blackbox is not None:
            bus.tap = blackbox.note
        self._tick = 0
        bus.subscribe(*SUBSCRIPTIONS)
        bus.subscribe_newest("G1_LOW_STATE")  # ten arrive in a tick, one is used

    def step(self, utime: int) -> None:
        """Run one tick at `utime` [us]."""
        self._bus.pump()
        inputs = self._gather(utime)
        output = self.core.tick(inputs)
        self._bus.publish("G1_LOW_CMD", output.command)
        self._publish_status(output)
        if output.query is not None:
            self._bus.publish("TRANSITION_QUERY", output.query)
        if self._journal is not None:
            self._journal(inputs, output)
        if self._blackbox is not None:
            self._blackbox.after_tick(inputs, output)
        self._tick += 1

    def _gather(self, utime: int) -> TickInput:
        latest = self._bus.latest("G1_LOW_STATE")
        age_us = NEVER_US if latest is None else utime - latest.msg.header.utime
        requests = self._bus.take("SKILL_REQUEST") + self._bus.take("OPERATOR_SKILL_REQUEST")
        return TickInput(
            utime=utime,
            tick=self._tick,
            state=None if latest is None else latest.msg,
            state_age_us=age_us,
            requests=tuple(r.msg for r in requests),
            operator=tuple(r.msg for r in self._bus.take("OPERATOR_COMMAND")),
            estops=tuple(r.msg for r in self._bus.take("ESTOP")),
            foreign_states=self._bus.counters.foreign_on("G1_LOW_STATE"),
            verdicts=tuple(r.msg for r in self._bus.take("TRANSITION_VERDICT")),
        )

    def _publish_status(self, output: TickOutput) -> None:
        status = output.status
        status.lateness_us, status.compute_us, status.missed = self._timing()
        counters = self._bus.counters
        status.states_lost = min(counters.lost_on("G1_LOW_STATE"), LARGEST_COUNT)
        status.rejected = min(counters.rejected, LARGEST_COUNT)
        self._bus.publish("CONTROL_STATUS", status)
        for change in output.changes:
            msg = skill_status_t()
            msg.header.utime = status.header.utime
            msg.source, msg.request_id = change.key
            msg.skill = change.skill
            msg.state = change.state
            msg.phase_s = change.phase_s if math.isfinite(change.phase_s) else math.nan
            msg.planned_start_utime = change.planned_start_utime
            msg.onset_utime = change.onset_utime
            msg.plan = change.plan
            msg.reason = change.reason
            self._bus.publish("SKILL_STATUS", msg)

    def close(self) -> None:
        """Finish the black box; the robot goes to damping when commands expire."""
        if self._blackbox is not None:
            self._blackbox.close()
