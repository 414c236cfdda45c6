"""Robot and bridge on two network stacks with a cable between them, as on a real robot.

Needs root and network namespaces: `pytest -m net`.
"""

import json
import os
import subprocess
import sys
import time

import pytest
from bridge_rig import Child

SETTINGS = "ramp_s = 1.0\nremote_lost_s = 5.0\nleave_s = 0.6\n"
SETUP = """
ip link set lo up && ip route add 239.255.76.67/32 dev lo
ip link add pc type veth peer name robot netns {other}
ip addr add 192.168.123.99/24 dev pc && ip link set pc up
nsenter -t {other} -n sh -c 'ip link set lo up && ip addr add 192.168.123.161/24 dev robot &&
  ip link set robot up && ip route add 239.0.0.0/8 dev robot'
"""


class Cable:
    """Two namespaces, each held by a sleeping process, and a veth pair between them."""

    def __init__(self):
        self.holders = [
            subprocess.Popen(["unshare", "-n", "sleep", "120"], stderr=subprocess.DEVNULL)
            for _ in range(2)
        ]
        time.sleep(0.3)
        pc, robot = (str(holder.pid) for holder in self.holders)
        self.pc, self.robot = (["nsenter", "-t", pid, "-n"] for pid in (pc, robot))
        done = subprocess.run(
            [*self.pc, "sh", "-ec", SETUP.format(other=robot)],
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            self.close()
            pytest.skip(f"no network namespaces here: {done.stderr.strip()}")

    def close(self):
        for holder in self.holders:
            holder.terminate()
            holder.wait()


@pytest.fixture
def cable():
    pytest.importorskip("cyclonedds", reason="cyclonedds (extra g1) is not installed")
    if os.geteuid() != 0:
        pytest.skip("network namespaces need root")
    made = Cable()
    yield made
    made.close()


def ask(robot):
    count = len(robot.read())
    robot.say("report")
    end = time.monotonic() + 10.0
    while len(robot.read(0.1)) == count:
        assert time.monotonic() < end
    return json.loads(robot.lines[-1])


@pytest.mark.net
def test_takeover_over_a_cable_and_what_happens_when_it_is_pulled(cable, tmp_path):
    (tmp_path / "bridge.toml").write_text(SETTINGS)
    robot = Child(
        [*cable.robot, sys.executable, "-m", "downbeat.sim.fake_g1", "--interface", "robot"]
    )
    robot.says("ready")
    argv = [*cable.pc, sys.executable, "-m", "downbeat.tools.cli"]
    auto = subprocess.run(
        [*argv, "bridge", "--interface", "pc", "--auto"], capture_output=True, check=False
    )
    assert auto.returncode == 2  # not on a robot
    settings = ["--settings", str(tmp_path / "bridge.toml")]
    bridge = Child([*argv, "bridge", "--interface", "pc", *settings], "stderr")
    for said in ("release the robot's own", "zero torque", "damping; press", "to pose"):
        bridge.says(said)
        time.sleep(0.4)
        robot.say("press start")
    time.sleep(1.5)
    report = ask(robot)
    assert report["kind"] == "position" and report["first_jump_rad"] < 0.02
    assert report["bad_crc"] == report["bad_mode"] == 0

    subprocess.run([*cable.pc, "ip", "link", "set", "pc", "down"], check=True)
    bridge.says("The robot has not reported")
    # What the motors do now is their own business; ours hold the last command, as simulators do.
    subprocess.run([*cable.pc, "ip", "link", "set", "pc", "up"], check=True)
    end = time.monotonic() + 30.0
    while ask(robot)["kind"] != "damping":
        assert time.monotonic() < end
        time.sleep(0.2)
    assert bridge.stop() == 0
    assert robot.stop() == 0
