"""`downbeat arm`: what a stop, a fall and a cleared trip leave to do, and never on a real robot."""

import os
import signal
import subprocess
import sys
import time

import pytest

from downbeat.control.core import ControlCore, CoreConfig
from downbeat.control.node import ControlNode
from downbeat.control.policy import SkillLibrary
from downbeat.lcm_types import (
    control_status_t,
    estop_t,
    g1_low_state_t,
    operator_command_t,
    skill_request_t,
    skill_status_t,
)
from downbeat.runtime.bus import MemqHub
from downbeat.runtime.clock import SimClock
from downbeat.sim.lockstep import STEP_US
from downbeat.sim.node import SimNode
from downbeat.tools.arming import arm_on
from downbeat.tools.cli import main


@pytest.fixture(scope="module")
def library():
    return SkillLibrary.load(only=frozenset({"stand", "walk", "wave"}))


class World:
    """Control and plant in lockstep, and the operator, while whose bus is pumped time passes."""

    def __init__(self, library, auto_arm=True):
        self.clock, self.hub, self.sent = SimClock(), MemqHub(), []
        self.hub.tap(lambda utime, channel, payload: self.sent.append(channel))
        self.core = ControlCore(library, CoreConfig(auto_arm=auto_arm))
        self.control = ControlNode(self.hub.endpoint("control", self.clock), self.core)
        self.sims, self.sim = 0, None
        self.seat = self.hub.endpoint("operator", self.clock)
        self.seat.subscribe("SKILL_STATUS")
        self.during = lambda: None
        self.start_sim()

    def start_sim(self):
        """End the plant, if there is one, and start one anew: the gantry holds a robot up."""
        if self.sim is not None:
            self.hub.remove(self.end)
        self.end = self.hub.endpoint("sim", self.clock)
        self.sims += 1
        self.end.epoch += self.sims  # another process
        self.sim = SimNode(self.end)

    def run(self, seconds):
        end = self.clock.utime() + round(seconds * 1e6)
        while self.clock.utime() < end:
            utime = self.clock.utime() + STEP_US
            self.clock.advance_to(utime)
            self.sim.step(utime)
            if utime % 20_000 == 0:
                self.control.step(utime)
                self.during()

    def send(self, command):
        msg = operator_command_t()
        msg.header.utime, msg.command = self.clock.utime(), command
        self.seat.publish("OPERATOR_COMMAND", msg)
        self.run(0.1)

    def stop(self):
        msg = estop_t()
        msg.header.utime, msg.level, msg.source = self.clock.utime(), estop_t.DAMP, "kim"
        self.seat.publish("ESTOP", msg)

    def arm(self):
        """Return what `downbeat arm` says, and the channels on which it sent something."""
        bus = self.hub.endpoint("operator 2", self.clock)
        bus.process = "operator"
        bus.pump = lambda timeout_s, take=bus.pump: (self.run(timeout_s), take())[1]
        begin = len(self.sent)
        told = arm_on(bus)
        bus.close()
        return *told, set(self.sent[begin:]) & {"OPERATOR_COMMAND", "ESTOP"}

    def ask(self, skill):
        msg = skill_request_t()
        msg.header.utime, msg.skill, msg.request_id = self.clock.utime(), skill, 7
        msg.source, msg.priority, msg.phase_rate = skill_request_t.SOURCE_OPERATOR, 10, 1.0
        self.seat.publish("OPERATOR_SKILL_REQUEST", msg)
        self.run(2.0)
        self.seat.pump()
        return [received.msg.state for received in self.seat.take("SKILL_STATUS")]


@pytest.fixture
def world(library):
    made = World(library)
    made.run(1.0)
    return made


def test_after_stop_clear_and_a_plant_started_anew_arming_makes_it_stand_and_dance(world):
    assert world.core.mode == control_status_t.STAND
    world.stop()
    world.run(2.5)
    assert world.sim.plant.base_height < 0.3  # damped, it goes down
    is_armed, said, sent = world.arm()
    assert not is_armed and not sent
    order = [said.index(step) for step in ("by kim", "sim` anew", "--level clear", "`downbeat arm")]
    assert order == sorted(order)
    world.send(operator_command_t.CLEAR_TRIP)
    is_armed, said, sent = world.arm()
    assert not is_armed and not sent and "nothing gets it up" in said
    world.start_sim()
    world.run(0.3)
    is_armed, said, sent = world.arm()
    assert is_armed and "stands" in said and sent == {"OPERATOR_COMMAND"}
    assert skill_status_t.RUNNING in world.ask("wave")
    assert world.sim.plant.base_height > 0.7


def test_a_trip_of_a_robot_that_is_held_up_only_has_to_be_cleared(library):
    world = World(library, auto_arm=False)
    world.run(0.5)
    world.stop()
    world.run(0.2)
    is_armed, said, sent = world.arm()
    assert not is_armed and not sent and "first `downbeat stop --level clear`, then" in said
    world.send(operator_command_t.CLEAR_TRIP)
    assert world.arm()[0]
    assert world.core.mode == control_status_t.STAND


def test_an_armed_robot_is_left_alone(world):
    is_armed, said, sent = world.arm()
    assert is_armed and "already" in said and not sent
    world.ask("wave")
    assert "plays wave" in world.arm()[1]


@pytest.mark.parametrize("is_cleared", [False, True])
def test_a_real_robot_is_sent_nothing_and_the_remote_is_named(library, is_cleared):
    world = World(library)
    world.sim._state.source = g1_low_state_t.SOURCE_HARDWARE
    world.run(0.5)
    world.stop()
    world.run(0.1)
    if is_cleared:
        world.send(operator_command_t.CLEAR_TRIP)
    is_armed, said, sent = world.arm()
    assert not is_armed and not sent
    assert "press start on the remote" in said and "bridge" in said
    world.run(1.0)
    assert world.core.mode in (control_status_t.ESTOP, control_status_t.DAMPING)


def test_control_without_a_robot_is_told_from_control_that_tripped(library):
    world = World(library)
    world.sim.step = lambda utime: None
    world.run(0.2)
    is_armed, said, sent = world.arm()
    assert not is_armed and "no robot is on the bus; first start `downbeat sim`," in said
    assert not sent


def test_an_emergency_stop_that_is_held_wins_and_is_named(library):
    world = World(library, auto_arm=False)
    world.run(0.5)
    world.during = world.stop
    is_armed, said, sent = world.arm()
    assert not is_armed and "let kim release the emergency stop" in said
    assert "OPERATOR_COMMAND" not in sent


def test_a_robot_that_trips_as_soon_as_it_is_armed_is_not_called_armed(library):
    world = World(library, auto_arm=False)
    world.run(0.5)

    ticks_on_feet = []

    def stop_what_stands():
        if world.core.mode == control_status_t.STAND:
            ticks_on_feet.append(world.clock.utime())
        if len(ticks_on_feet) == 10:  # a fifth of a second
            world.stop()

    world.during = stop_what_stands
    is_armed, said, sent = world.arm()
    assert not is_armed and "Emergency stop by kim" in said
    assert "OPERATOR_COMMAND" in sent


def test_two_robots_on_one_bus_are_not_armed(library):
    world = World(library, auto_arm=False)
    other = world.hub.endpoint("second", world.clock)
    other.process = "sim"
    second = SimNode(other)
    world.during = lambda: second.step(world.clock.utime())
    world.run(0.2)
    is_armed, said, sent = world.arm()
    assert not is_armed and "two processes" in said and not sent


def test_without_control_one_sentence_says_so(capsys, free_url):
    assert main(["arm", "--url", free_url]) == 1
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 1 and "no control process answers" in said[0]


@pytest.mark.slow
def test_processes_are_stopped_cleared_and_armed_from_the_command_line(tmp_path, free_url):
    """Only the plant is started anew; control keeps its journal."""
    url = free_url
    (tmp_path / "show.toml").write_text('audio = "none.wav"\ntracks = "none"\nindex = "none"\n')

    def start(name):
        argv = [sys.executable, "-m", "downbeat.tools.cli", name, "--show", "show.toml"]
        return subprocess.Popen([*argv, "--url", url], cwd=tmp_path, stderr=subprocess.DEVNULL)

    def downbeat(*argv):
        return main([*argv, "--url", url])

    def until(what, argv):
        end = time.monotonic() + 30
        while downbeat(*argv) != what:
            assert time.monotonic() < end, argv

    processes = [start("control"), start("sim")]
    try:
        until(0, ["arm"])  # it stands by itself
        downbeat("stop")
        until(1, ["arm"])
        time.sleep(2.0)
        processes[1].send_signal(signal.SIGINT)
        processes[1].wait(timeout=20)
        processes.append(start("sim"))
        downbeat("stop", "--level", "clear")
        until(0, ["arm"])
        assert downbeat("ask", "wave", "--seconds", "1") == 0
    finally:
        for process in processes:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        for process in processes:
            process.wait(timeout=20)
    assert os.path.getsize(tmp_path / "journal") > 0
