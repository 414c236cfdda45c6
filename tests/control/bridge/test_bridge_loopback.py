"""Scenarios over real DDS on loopback: robot and bridge are processes of their own."""

import subprocess
import sys
import time

import pytest
from bridge_rig import QUICK

from downbeat.lcm_types import estop_t, g1_low_cmd_t, g1_low_state_t
from downbeat.runtime.bus import open_udpm
from downbeat.runtime.clock import WallClock


def listen(rig_, process="operator", *channels):
    bus = open_udpm(rig_.url, WallClock(), process)
    bus.subscribe(*channels)
    return bus


def commanding(rig, **options):
    """A bridge that holds the robot in a pose: it commands positions, control is absent."""
    one = rig(settings=QUICK, **options)
    one.start_bridge()
    one.wait_for("position")
    return one


def test_bridge_walks_through_its_steps_and_the_first_target_is_the_measured_pose(rig):
    one = rig()
    one.start_bridge()
    kinds = []
    one.wait(lambda r: kinds.append(r["kind"]) or r["kind"] == "position")
    said = "\n".join(one.bridge.says("to pose") and one.bridge.lines)
    assert said.index("zero torque") < said.index("damping;") < said.index("to pose")
    assert [k for i, k in enumerate(kinds) if k and k not in kinds[:i]] == [
        "zero",
        "damping",
        "position",
    ]
    # Noise of the encoders and what hanging arms move in a few milliseconds.
    assert one.ask()["first_jump_rad"] < 0.02


def test_states_reach_lcm_and_lowcmd_is_repeated_500_times_a_second(rig):
    one = rig()
    bus = listen(one, "operator", "G1_LOW_STATE")
    one.start_bridge()
    one.wait_for("position")
    before, start = one.ask()["commands"], time.monotonic()
    bus.pump()
    bus.take("G1_LOW_STATE")
    time.sleep(1.5)
    bus.pump()
    states = bus.take("G1_LOW_STATE")
    report, elapsed = one.ask(), time.monotonic() - start
    assert report["bad_crc"] == report["bad_mode"] == 0
    assert (report["commands"] - before) / elapsed > 400
    assert len(states) > 600 and bus.counters.lost == bus.counters.rejected == 0
    msg = states[-1].msg
    assert msg.source == g1_low_state_t.SOURCE_HARDWARE and msg.mode_machine == 5
    assert abs(msg.battery_soc - 0.8) < 1e-6
    assert abs(sum(float(v) ** 2 for v in msg.imu_torso.quat) - 1.0) < 1e-3
    stamps = [r.msg.header.utime for r in states]
    assert all(a < b for a, b in zip(stamps, stamps[1:], strict=False))
    bus.close()


def test_motion_service_is_released_before_the_first_command(rig):
    one = rig(motion="ai")
    one.start_bridge()
    one.bridge.says("release the robot's own motion service")
    assert one.ask()["commands"] == 0
    one.wait(lambda r: r["commands"] > 0)
    assert one.ask("voice")["motion"] == ""


def test_each_step_is_confirmed_on_the_remote(rig):
    one = rig(auto=False, motion="ai")
    one.start_bridge()
    one.bridge.says("release the robot's own motion service")
    time.sleep(0.7)
    assert one.ask()["commands"] == 0
    for said, kind in (("zero torque", "zero"), ("damping", "damping"), ("to pose", "position")):
        one.do("press start")
        one.bridge.says(said)
        one.wait_for(kind)
        time.sleep(0.3)
        assert one.ask()["kind"] == kind


TRIPS = {
    "the stop button": ("press B", "Emergency stop on the remote (B)"),
    "silence": ("drop on", "The robot has not reported"),
    "a lost remote": ("remote off", "The remote has not been heard"),
    "a motor fault": ("fault 3 7", "Motor 3 reports a fault"),
    "a hot winding": ("hot 4 125", "The winding of motor 4 (125 C)"),
    "a hot casing": ("case 4 95", "The casing of motor 4 (95 C)"),
    "an empty battery": ("soc 5", "The battery is at 5 %"),
    "NaN from a motor": ("nan 5", "The robot has not reported"),
    "wrong checksums": ("crc 100000", "The robot has not reported"),
    "another robot": ("mode_machine 2", "The robot has not reported"),
    "half messages": ("half on", "The robot has not reported"),
    "a tick that runs back": ("tick -5000", None),
}


QUICK_ONES = ("the stop button", "silence", "NaN from a motor", "a tick that runs back")
"""The others are slow tests: `test_bridge_core.py` has every row without processes."""


@pytest.mark.parametrize(
    "what",
    [name if name in QUICK_ONES else pytest.param(name, marks=pytest.mark.slow) for name in TRIPS],
)
def test_damping_follows(rig, what):
    word, said = TRIPS[what]
    one = commanding(rig)
    one.do(word)
    if said is None:  # a count that begins again is believed after 0.1 s, before it is stale
        time.sleep(1.0)
        assert one.ask()["kind"] == "position"
        return
    one.bridge.says(said)
    if what != "another robot":  # the robot does not take commands for another one
        report = one.wait_for("damping", 1.0)
        time.sleep(0.5)
        later = one.ask()
        assert later["kind"] == "damping" and later["commands"] > report["commands"] + 100


def test_estop_on_lcm_leads_to_damping_whoever_sends_it(rig):
    one = commanding(rig)
    bus = listen(one, "operator", "ESTOP")
    msg = estop_t()
    msg.header.utime = bus.clock.utime()
    msg.level, msg.source, msg.reason = estop_t.DAMP, "test", "test"
    bus.publish("ESTOP", msg)
    one.wait_for("damping", 1.0)
    bus.close()


def test_stop_button_is_told_to_control(rig):
    one = commanding(rig)
    bus = listen(one, "control", "ESTOP")
    one.do("press select")
    one.wait_for("damping")
    end = time.monotonic() + 2.0
    stops = []
    while not stops and time.monotonic() < end:
        bus.pump(0.1)
        stops = bus.take("ESTOP")
    assert stops and stops[0].msg.source == "bridge" and "select" in stops[0].msg.reason
    bus.close()
    end = time.monotonic() + 3.0
    while (lights := one.ask("voice")["lights"]) != [[0, 0, 255], [255, 0, 0]]:
        assert time.monotonic() < end, lights  # listening, then stopped


def test_speech_is_played_by_the_robots_voice(rig):
    import numpy as np

    from downbeat.control.bridge.dds import Link
    from downbeat.control.bridge.loop import open_service
    from downbeat.control.bridge.voice import RobotSpeaker

    one = rig()
    link = Link("lo", one.domain)
    speaker = RobotSpeaker(open_service(link, "voice"))
    time.sleep(0.5)
    start = time.monotonic()
    speaker.set_volume(0.7)
    speaker.play(np.arange(60_000, dtype=np.int16) % 1000, 0)
    while time.monotonic() - start < 4.0 and one.ask("voice")["pcm_bytes"] < 120_000:
        speaker.update(round((time.monotonic() - start) * 1e6))
        time.sleep(0.05)
    heard = one.ask("voice")
    link.close()
    assert heard["pcm_bytes"] == 120_000 and heard["volume"] == 70
    assert heard["streams"] == ["downbeat/1"] and speaker.errors == {}


def command(clock, mode, target):
    msg = g1_low_cmd_t()
    msg.header.utime = clock.utime()
    msg.valid_until_utime = msg.header.utime + 100_000
    msg.mode = mode
    msg.joint_pos_target = list(target)
    msg.joint_vel_target = msg.joint_torque_ff = [0.0] * 29
    msg.joint_stiffness, msg.joint_damping = [40.0] * 29, [2.0] * 29
    return msg


def test_commands_that_stop_coming_lead_to_damping(rig):
    one = commanding(rig)
    bus = listen(one, "control", "G1_LOW_STATE")
    end = time.monotonic() + 12.0
    has_active = False
    while not has_active and time.monotonic() < end:
        bus.pump(0.02)
        state = bus.latest("G1_LOW_STATE").msg
        bus.publish("G1_LOW_CMD", command(bus.clock, 2, state.joint_pos))
        has_active = any(line.endswith("active") for line in one.bridge.read())
    assert has_active
    last = one.ask()["seconds"]
    report = one.wait_for("damping", 2.0)
    assert report["kind_since_s"] - last < 0.35
    assert "last command expired" in one.bridge.says("DAMPING")
    bus.close()


def test_damaged_commands_never_reach_the_motors(rig):
    one = commanding(rig)
    bus = listen(one, "control", "G1_LOW_STATE")
    for _ in range(100):
        bus.pump(0.005)
        msg = command(bus.clock, 2, [float("nan")] * 29)
        bus.publish("G1_LOW_CMD", msg)
        msg = command(bus.clock, 2, [0.0] * 29)
        msg.joint_stiffness = [-5.0] * 29
        bus.publish("G1_LOW_CMD", msg)
    report = one.ask()
    assert report["kind"] == "position" and report["tilt"] < 0.5
    bus.close()


FOREIGN = """
import sys, time
from downbeat.control.bridge.dds import Link
from downbeat.control.bridge import idl
from downbeat.control.bridge.lowcmd import LowCmdFrame
link = Link("lo", int(sys.argv[1]))
writer = link.writer("rt/lowcmd", idl.LowCmd_)
frame = LowCmdFrame()
end = time.monotonic() + float(sys.argv[2])
while time.monotonic() < end:
    writer.write(frame.payload())
    time.sleep(0.02)
"""


def test_a_robot_that_somebody_else_commands_is_refused(rig):
    one = rig()
    other = subprocess.Popen([sys.executable, "-c", FOREIGN, str(one.domain), "6"])
    one.wait(lambda r: r["bad_mode"] > 5)  # it commands with mode_machine 0
    bridge = one.start_bridge("--patience-s", "2")
    bridge.says("gave up: somebody else commands the robot")
    assert bridge.process.wait(timeout=10) == 1
    assert one.ask()["commands"] == 0
    one.bridge = None
    other.wait(timeout=20)


def test_somebody_who_begins_to_command_the_robot_leads_to_damping(rig):
    one = commanding(rig)
    subprocess.run([sys.executable, "-c", FOREIGN, str(one.domain), "1.5"], check=True)
    assert "Somebody else commands" in one.bridge.says("DAMPING")


@pytest.mark.parametrize("stage", ["zero", "damping", "position"])
def test_leaving_is_through_damping(rig, stage):
    one = rig()
    one.start_bridge()
    one.wait_for(stage)
    one.bridge.process.terminate()
    assert one.bridge.process.wait(timeout=10) == 0
    report = one.ask()
    assert report["kind"] == "damping"
    assert report["last_s"] - report["kind_since_s"] > 0.4


def test_a_bridge_that_finds_no_robot_gives_up_without_a_command(rig):
    one = rig()
    one.do("drop on")
    bridge = one.start_bridge("--patience-s", "1.5")
    assert bridge.process.wait(timeout=15) == 1
    assert "no good state comes from the robot" in bridge.says("gave up")
    assert one.ask()["commands"] == 0
    one.bridge = None


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--interface", "nonesuch"], "this machine has"),
        (["--interface", "lo", "--domain", "999"], "valid are 0 to 232"),
        (["--interface", "eth0", "--auto"], "--auto is for simulators"),
    ],
)
def test_wrong_options_are_refused_with_what_would_be_valid(arguments, said):
    pytest.importorskip("cyclonedds", reason="cyclonedds (extra g1) is not installed")
    argv = [sys.executable, "-m", "downbeat.tools.cli", "bridge", *arguments]
    done = subprocess.run(argv, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and said in done.stderr


@pytest.mark.slow
def test_control_stands_and_dances_through_the_bridge_and_the_stop_button_ends_it(rig, tmp_path):
    show = tmp_path / "show.toml"
    show.write_text('audio = ""\ntracks = ""\nindex = ""\n')
    one = rig(operator=True, motion="ai", settings="leave_s = 1.0\n")
    one.start("control", "--show", str(show))
    one.start_bridge()
    one.bridge.says("active", 30.0)
    one.wait(lambda r: r["crane"] == 0.0 and r["height"] > 0.7, 30.0)
    time.sleep(1.0)
    asked = one.start("ask", "kpop")
    asked.says("running", 15.0)
    time.sleep(4.0)
    report = one.ask()
    assert report["height"] > 0.6 and report["tilt"] < 0.4 and report["kind"] == "position"
    pressed = report["seconds"]
    one.do("press B")
    report = one.wait_for("damping", 2.0)
    assert report["kind_since_s"] - pressed < 0.1
    one.wait(lambda r: r["height"] < 0.4)
