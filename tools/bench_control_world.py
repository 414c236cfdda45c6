"""The world around control in `downbeat bench control`: a robot that stands, and somebody who asks.

A process of its own: `python -m downbeat.tools.bench_control_world SETTINGS.json`. It publishes
G1_LOW_STATE at 500 Hz and, whenever control has stood for a while, asks for a skill and notes the
first tick that shows it. On SIGTERM it prints what it noted as one line of JSON.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from downbeat.catalog.robot import load_g1
from downbeat.lcm_types import control_status_t, g1_low_state_t, skill_request_t
from downbeat.runtime.bus import Bus, open_udpm
from downbeat.runtime.clock import TimeBase, WallClock
from downbeat.runtime.config import load_config
from downbeat.runtime.node import run_node
from downbeat.runtime.realtime import configure_real_time

STATE_PERIOD_US = 2_000
TICK_US = 20_000
STANDING_US = 300_000
"""Control stands for this long before it is asked."""
PATIENCE_US = 1_000_000
"""A request that shows no effect for this long counts as not answered."""
SKILL_S = 2.0
"""The skill is asked for this long; then control goes back to stand by itself."""


@dataclass(frozen=True)
class BenchSettings:
    """What the processes of the bench share, as TOML.

    Attributes:
        url: LCM URL.
        skill: The skill that is asked for.
        epoch_utime: Time base [us].
        epoch_monotonic_ns: Time base [ns].
        priority: SCHED_FIFO priority of control and of the C loop.
        world_priority: The same of the world; it must go on under load, and stand back for control.
        cpu: Processor of control and of the C loop; -1: any.
    """

    url: str
    skill: str
    epoch_utime: int
    epoch_monotonic_ns: int
    priority: int
    world_priority: int
    cpu: int = -1

    @property
    def clock(self) -> WallClock:
        """The bench's clock."""
        return WallClock(TimeBase(self.epoch_utime, self.epoch_monotonic_ns))


def standing_state() -> Any:
    """Return a G1_LOW_STATE of a robot that stands in its default pose."""
    msg: Any = g1_low_state_t()
    for imu in (msg.imu_pelvis, msg.imu_torso):
        imu.quat = np.array([1.0, 0.0, 0.0, 0.0], np.float32)
        imu.gyro = np.zeros(3, np.float32)
        imu.accel = np.array([0.0, 0.0, 9.81], np.float32)
        imu.rpy = np.zeros(3, np.float32)
    msg.battery_soc = float("nan")
    msg.joint_pos = np.asarray(load_g1().default_joint_pos, np.float32)  # (29,)
    msg.joint_vel = np.zeros(29, np.float32)
    msg.joint_torque_est = np.zeros(29, np.float32)
    msg.temperature_case = np.full(29, 35, np.int16)
    msg.temperature_winding = np.full(29, 40, np.int16)
    msg.motor_fault = np.zeros(29, np.int32)
    msg.wireless_remote = bytes(40)
    return msg


def tremble(state: Any, utime: int) -> None:
    """Move the gyro a little: a robot whose numbers stand still is taken for dead."""
    state.imu_pelvis.gyro[:] = 1e-4 * (utime // STATE_PERIOD_US % 7)


class WorldNode:
    """Node "sim" of the bench; every request it makes ends up in `answers`."""

    name = "sim"
    period_us = STATE_PERIOD_US

    def __init__(self, sim: Bus, conductor: Bus, skill: str) -> None:
        """Wire it.

        Args:
            sim: Endpoint that publishes the state.
            conductor: Endpoint that asks and listens.
            skill: What to ask for.
        """
        self._sim = sim
        self._conductor = conductor
        self._skill = skill
        self._state = standing_state()
        self._standing_since = 0
        self._asked_utime = 0
        self._count = 0
        self.answers: list[tuple[int, int]] = []
        """(utime of the request, utime of the first tick that plays it); 0: not answered."""
        conductor.subscribe("CONTROL_STATUS")

    def step(self, utime: int) -> None:
        """Publish the state; ask, or look for the answer."""
        self._state.header.utime = utime
        self._state.tick += 1
        tremble(self._state, utime)
        self._sim.publish("G1_LOW_STATE", self._state)
        self._conductor.pump()
        for received in self._conductor.take("CONTROL_STATUS"):
            self._look_at(received.msg)
        if self._asked_utime and utime - self._asked_utime > PATIENCE_US:
            self._note(0)
        elif self._may_ask(utime):
            self._ask()

    def _look_at(self, status: Any) -> None:
        stands = status.mode == control_status_t.STAND and not status.previous_skill
        if not stands:
            self._standing_since = 0
        elif self._standing_since == 0:
            self._standing_since = int(status.header.utime)
        if self._asked_utime and status.skill == self._skill:
            self._note(int(status.header.utime))

    def _note(self, tick_utime: int) -> None:
        self.answers.append((self._asked_utime, tick_utime))
        self._asked_utime = self._standing_since = 0

    def _may_ask(self, utime: int) -> bool:
        # Every request comes at another moment between two ticks.
        offset = STATE_PERIOD_US * (7 * self._count % 10)
        latest = self._conductor.latest("CONTROL_STATUS")
        if self._asked_utime or not self._standing_since or latest is None:
            return False
        is_alive = utime - latest.recv_utime < 2 * TICK_US
        if not is_alive:
            self._standing_since = 0
            return False
        return utime - self._standing_since >= STANDING_US + offset

    def _ask(self) -> None:
        self._count += 1
        msg: Any = skill_request_t()
        msg.request_id = self._count
        msg.skill = self._skill
        msg.phase_rate = 1.0
        msg.duration_s = SKILL_S
        msg.source = skill_request_t.SOURCE_SCRIPT
        self._asked_utime = self._conductor.clock.utime()
        msg.header.utime = self._asked_utime
        self._conductor.publish("SKILL_REQUEST", msg)

    def close(self) -> None:
        """Nothing to release."""


def main(argv: list[str]) -> int:
    """Run until SIGTERM."""
    settings = load_config(Path(argv[1]), BenchSettings)
    clock = settings.clock
    sim = open_udpm(settings.url, clock, "sim")
    conductor = open_udpm(settings.url, clock, "conductor")
    node = WorldNode(sim, conductor, settings.skill)
    configure_real_time(settings.world_priority)
    print(json.dumps({"ready": True}), flush=True)
    run_node(node, clock)
    print(json.dumps({"answers": node.answers}), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv))
