"""Scenarios on a real LCM bus (ttl=0), and what may never be played there."""

import json
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest

from downbeat.lcm_types import control_status_t, g1_low_state_t
from downbeat.runtime.bus import open_udpm
from downbeat.runtime.clock import WallClock
from downbeat.runtime.traffic import Impairment, Injection
from downbeat.tools.cli import main
from downbeat.tools.errors import ToolError
from downbeat.tools.scenario import Expectation, Scenario, load_scenario
from downbeat.tools.traffic_bus import play_on_bus

FOLDER = Path(__file__).parent
FILES = sorted((FOLDER / "bus").glob("*.toml"))
START_S = 30.0
ESTOP = Scenario(
    "Somebody presses the button.",
    0.5,
    inject=(Injection("ESTOP", 0.1, fields={"level": 1}),),
    expect=(Expectation(after_s=0.4, mode="ESTOP"),),
)


@pytest.fixture
def url(free_url):
    return free_url


@pytest.fixture
def robot(url):
    """URL of a bus with a simulated robot that stands."""
    child = subprocess.Popen([sys.executable, str(FOLDER / "robot_on_bus.py"), url])
    bus = open_udpm(url, WallClock(), "operator")
    bus.subscribe("CONTROL_STATUS")
    end = time.monotonic() + START_S
    stands = False
    try:
        while not stands:
            assert child.poll() is None and time.monotonic() < end, "the robot did not get up"
            bus.pump(0.05)
            status = bus.latest("CONTROL_STATUS")
            stands = status is not None and status.msg.mode == control_status_t.STAND
        bus.close()
        yield url
        assert child.poll() is None, "a process of the robot died"
    finally:
        child.terminate()
        child.wait()


@pytest.fixture
def speaker(url):
    """Publish states of a chosen source on the bus until the test ends."""
    stop, threads = threading.Event(), []

    def start(source, after_s=0.0):
        bus, clock = open_udpm(url, WallClock(), "bridge"), WallClock()

        def talk():
            msg = g1_low_state_t()
            msg.source = source
            stop.wait(after_s)
            while not stop.wait(0.01):
                msg.header.utime = clock.utime()
                bus.publish("G1_LOW_STATE", msg)

        threads.append(threading.Thread(target=talk))
        threads[-1].start()

    yield start
    stop.set()
    for thread in threads:
        thread.join()


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_scenario_on_a_real_bus_ends_as_expected(path, robot):
    outcome, count = play_on_bus(load_scenario(path), robot)
    assert outcome.ticks and count
    assert outcome.problems == []


def heard_by(url, channel):
    """Return a list that fills with the channel's payloads, and a function that ends it."""
    bus, found, stop = open_udpm(url, WallClock(), "viewer"), [], threading.Event()
    bus.tap = lambda channel, payload: found.append(payload)
    bus.subscribe(channel)

    def listen():
        while not stop.is_set():
            bus.pump(0.02)

    thread = threading.Thread(target=listen)
    thread.start()

    def end():
        stop.set()
        thread.join()
        bus.close()
        return found

    return end


def test_traffic_is_published_even_if_nobody_is_there_to_be_judged(url):
    end = heard_by(url, "ESTOP")
    outcome, count = play_on_bus(ESTOP, url)
    assert len(end()) == count == 1
    assert outcome.ticks == [] and outcome.problems == []


def test_real_robot_is_never_disturbed(url, speaker):
    speaker(g1_low_state_t.SOURCE_HARDWARE)
    end = heard_by(url, "ESTOP")
    with pytest.raises(ToolError, match="comes from a real robot"):
        play_on_bus(ESTOP, url)
    assert end() == []


def test_real_robot_that_appears_silences_the_traffic(url, speaker):
    flood = Injection("SKILL_REQUEST", 0.0, 9.0, 100.0, fields={"skill": "kpop", "request_id": 1})
    speaker(g1_low_state_t.SOURCE_HARDWARE, after_s=1.0)
    end = heard_by(url, "SKILL_REQUEST")
    with pytest.raises(ToolError, match="comes from a real robot"):
        play_on_bus(replace(ESTOP, seconds=10.0, inject=(flood,)), url)
    assert 0 < len(end()) < 900


COMMANDS = replace(ESTOP, inject=(Injection("G1_LOW_CMD", 0.1),))


def test_motors_are_commanded_only_where_the_scenario_says_so_and_a_plant_is_heard(url, speaker):
    with pytest.raises(ToolError, match="may_command_motors = true"):
        play_on_bus(COMMANDS, url)
    with pytest.raises(ToolError, match="no simulated robot is heard"):
        play_on_bus(replace(COMMANDS, may_command_motors=True), url)
    speaker(g1_low_state_t.SOURCE_SIM)
    _, count = play_on_bus(replace(COMMANDS, may_command_motors=True), url)
    assert count == 1


def test_messages_of_others_cannot_be_impaired_on_a_bus(url):
    scenario = replace(ESTOP, impair=(Impairment("G1_LOW_STATE", drop=1.0),))
    with pytest.raises(ToolError, match="G1_LOW_STATE cannot be impaired"):
        play_on_bus(scenario, url)


def test_traffic_never_leaves_this_machine():
    with pytest.raises(ToolError, match="leaves this machine"):
        play_on_bus(ESTOP, "udpm://239.255.76.67:7667?ttl=1")


def test_command_says_what_happened_and_exits_by_it(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    path = FOLDER / "estop_stand.toml"
    assert main(["traffic", str(path)]) == 0
    assert "as expected" in capsys.readouterr().out
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(path.read_text().replace('mode = "ESTOP"', 'mode = "STAND"'))
    assert main(["traffic", str(wrong), "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert len(told["problems"]) == 2 and "mode STAND" in told["problems"][0]
    wrong.write_text("speed = 3\n")
    assert main(["traffic", str(wrong)]) == 2
    assert "known are" in capsys.readouterr().err
    assert main(["traffic", str(tmp_path / "nowhere.toml")]) == 2
