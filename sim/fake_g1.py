"""A G1 on DDS: `python -m downbeat.sim.fake_g1 --interface lo` is what the bridge sees as a robot.

Our plant hangs on a crane behind rt/lowcmd and rt/lowstate (500 Hz, real time); the motion switcher
and the voice answer. Standard input takes one word per line (`downbeat.sim.motor_side`): a button,
a broken checksum, a hot motor. `quit` ends it; so do SIGTERM and the end of the input.
"""

from __future__ import annotations

import argparse
import json
import os
import select
import sys
import time
from typing import Any

from downbeat.runtime.node import stop_signals
from downbeat.runtime.realtime import configure_real_time
from downbeat.sim.errors import SimError
from downbeat.sim.fake_services import FakeMotionSwitcher, FakeVoice, ServiceHost
from downbeat.sim.motor_side import MotorSide

PERIOD_NS = 2_000_000
MAX_BEHIND = 50
"""Steps that are made up for after a stall; beyond, the robot's time stands still."""
PLANT_PRIORITY = 60
SLOW_STEPS = 50


class FakeG1:
    """The robot's side of DDS around a `MotorSide`."""

    def __init__(self, link: Any, robot: MotorSide, motion: FakeMotionSwitcher) -> None:
        """Open the robot's topics.

        Args:
            link: Participant (`downbeat.control.bridge.dds.Link`).
            robot: The plant.
            motion: The motion switcher's state.
        """
        from downbeat.control.bridge import idl

        self.robot, self.motion, self.voice = robot, motion, FakeVoice()
        self._commands = link.reader("rt/lowcmd", idl.LowCmd_)
        self._states = link.writer("rt/lowstate", idl.LowState_)
        self._torso = link.writer("rt/secondary_imu", idl.IMUState_)
        self._battery = link.writer("rt/lf/bmsstate", idl.BmsState_)
        self._hosts = [
            ServiceHost(
                service,
                link.reader(f"rt/api/{service.name}/request", idl.Request_),
                link.writer(f"rt/api/{service.name}/response", idl.Response_),
            )
            for service in (self.motion, self.voice)
        ]
        self._count = 0

    def step(self) -> None:
        """Take commands, integrate 2 ms, report."""
        robot = self.robot
        for payload in self._commands.take():
            robot.take_command(payload)
        robot.step()
        self._count += 1
        if not robot.is_dropped:
            self._torso.write(robot.torso_imu())
            self._states.write(robot.lowstate())
        if self._count % SLOW_STEPS == 0:
            self._battery.write(robot.battery())
            for host in self._hosts:
                host.serve()

    def do(self, line: str) -> str:
        """Obey one line of the standard input."""
        if line.split()[:1] == ["voice"]:
            record = self.voice.record
            return json.dumps(
                {
                    "pcm_bytes": len(record.pcm),
                    "streams": record.streams,
                    "texts": record.texts,
                    "stops": record.stops,
                    "volume": record.volume,
                    "lights": record.lights,
                    "motion": self.motion.active,
                }
            )
        return self.robot.do(line)


class Lines:
    """Standard input as lines, without waiting."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._rest = b""
        self.is_over = False

    def take(self) -> list[str]:
        """Return the lines that have come."""
        if self.is_over or not select.select([self._descriptor], [], [], 0)[0]:
            return []
        chunk = os.read(self._descriptor, 65536)
        self.is_over = not chunk
        *lines, self._rest = (self._rest + chunk).split(b"\n")
        return [line.decode(errors="replace").strip() for line in lines if line.strip()]


def run(fake: FakeG1) -> None:
    """Run in real time until told to stop."""
    lines = Lines(sys.stdin.fileno())
    next_ns = time.monotonic_ns()
    with stop_signals() as is_signalled:
        while not is_signalled() and not lines.is_over:
            for line in lines.take():
                if line == "quit":
                    return
                try:
                    answer = fake.do(line)
                except SimError as error:
                    answer = json.dumps({"error": str(error)})
                if answer:
                    print(answer, flush=True)
            fake.step()
            next_ns = max(next_ns + PERIOD_NS, time.monotonic_ns() - MAX_BEHIND * PERIOD_NS)
            wait_ns = next_ns - time.monotonic_ns()
            if wait_ns > 0:
                time.sleep(wait_ns * 1e-9)


def main() -> int:
    """Parse and run."""
    parser = argparse.ArgumentParser(prog="fake_g1", description=__doc__)
    parser.add_argument("--interface", default="lo")
    parser.add_argument("--domain", type=int, default=0)
    parser.add_argument("--motion", default="ai", help="active motion service, empty: none")
    parser.add_argument("--mode-machine", type=int, default=5)
    parser.add_argument("--operator", action="store_true", help="the crane works by itself")
    arguments = parser.parse_args()
    from downbeat.control.bridge.dds import Link

    link = Link(arguments.interface, arguments.domain)
    robot = MotorSide(mode_machine=arguments.mode_machine)
    robot.has_operator = arguments.operator
    fake = FakeG1(link, robot, FakeMotionSwitcher(arguments.motion))
    configure_real_time(PLANT_PRIORITY)
    print(json.dumps({"ready": True}), flush=True)
    run(fake)
    link.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
