"""The bridge's decisions, step by step and row by row; no bus, no clock."""

import struct

import numpy as np
import pytest
from test_bridge_wire import plain_state, sealed

from downbeat.control.bridge import layout
from downbeat.control.bridge.core import BridgeCore
from downbeat.control.bridge.faults import BRIDGE_FAULTS
from downbeat.control.bridge.lowcmd import LowCmdView
from downbeat.control.bridge.remote import remote_frame
from downbeat.control.bridge.settings import BridgeSettings
from downbeat.control.bridge.stages import Stage
from downbeat.control.errors import ControlError
from downbeat.lcm_types import estop_t, g1_low_cmd_t, operator_command_t

ZEROS = np.zeros(29, np.float32)
POSE = np.linspace(-0.2, 0.2, 29).astype(np.float32)


class Bench:
    """A core and the robot it sees, 2 ms at a time."""

    def __init__(self, **options):
        self.core = BridgeCore(BridgeSettings(), **options)
        self.core.motion_service = ""
        self.utime = 1_000_000
        self.tick = 0
        self.state = plain_state()
        self.frame = remote_frame()
        self.pose = POSE
        self.is_silent = False
        self.sent = None

    def step(self, count=1):
        for _ in range(count):
            self.utime += 2000
            self.tick += 2
            if not self.is_silent:
                struct.pack_into("<I", self.state, 16, self.tick)
                motors = np.frombuffer(self.state, layout.STATE_MOTOR, 29, layout.STATE_FIRST_MOTOR)
                motors["q"] = self.pose
                del motors
                self.state[layout.STATE_REMOTE] = self.frame
                self.core.take_state(sealed(self.state), self.utime)
            self.core.update(self.utime)
            payload = self.core.output(self.utime)
            self.sent = None if payload is None else LowCmdView(payload)
        return self.core.stage

    def press(self, *buttons):
        self.frame = remote_frame(buttons)
        self.step()
        self.frame = remote_frame()
        return self.step()

    def command(self, mode=g1_low_cmd_t.MODE_POSITION, target=None, valid_us=100_000, utime=None):
        msg = g1_low_cmd_t()
        msg.header.utime = self.utime + 1 if utime is None else utime
        msg.valid_until_utime = msg.header.utime + valid_us
        msg.mode = mode
        msg.joint_pos_target = self.pose + 0.1 if target is None else target
        msg.joint_vel_target = msg.joint_torque_ff = ZEROS
        msg.joint_stiffness, msg.joint_damping = ZEROS + 40, ZEROS + 2
        self.core.take_command(msg, self.utime)

    def to(self, stage):
        """Walk there as an operator would."""
        self.step(300)
        while self.core.stage < stage:
            if self.core.stage is Stage.TO_POSE:
                self.step(1300)
            if self.core.stage is Stage.HANDOVER:
                self.step()
                self.command()
                self.step()
            else:
                self.press("start")
        assert self.core.stage is stage
        return self


def kind(view):
    if view is None:
        return "silence"
    return "position" if view.kp.any() else "damping" if view.kd.any() else "zero"


def test_nothing_is_sent_before_every_check_is_good():
    bench = Bench()
    for _ in range(200):
        bench.step()
        assert bench.sent is None
    bench.step(100)
    assert bench.core.stage is Stage.ZERO_TORQUE and kind(bench.sent) == "zero"


@pytest.mark.parametrize(
    ("prepare", "said"),
    [
        (lambda b: setattr(b, "frame", bytes(40)), "the remote is not heard"),
        (lambda b: setattr(b.core, "motion_service", None), "motion service does not answer"),
        (lambda b: setattr(b.core.watch, "battery_soc", 0.19), "the battery is at 19 %"),
        (lambda b: setattr(b, "is_silent", True), "no good state comes from the robot"),
        (lambda b: b.state.__setitem__(13, 2), "wrong mode_machine: 2 (29 dof)"),
        (lambda b: struct.pack_into("<I", b.state, 76 + 32, 7), "Motor 0 reports a fault"),
        (lambda b: setattr(b, "frame", remote_frame(("B",))), "Emergency stop on the remote (B)"),
    ],
)
def test_a_robot_that_is_not_in_order_is_never_commanded(prepare, said):
    bench = Bench()
    prepare(bench)
    bench.step(500)
    assert bench.core.stage is Stage.CHECKING and bench.sent is None
    assert said in bench.core.missing(bench.utime)


def test_a_robot_that_somebody_else_commands_is_not_commanded_until_they_stop():
    bench = Bench()
    for _ in range(20):
        bench.core.note_foreign(10, bench.utime)
        bench.step(50)
    assert bench.sent is None and "somebody else commands" in bench.core.missing(bench.utime)
    bench.step(300)
    assert bench.core.stage is Stage.ZERO_TORQUE


def test_a_motion_service_is_released_only_on_the_operators_word():
    bench = Bench()
    bench.core.motion_service = "ai"
    bench.step(400)
    assert bench.core.stage is Stage.RELEASING and not bench.core.wants_release
    bench.press("start")
    assert bench.core.wants_release and bench.sent is None
    bench.core.motion_service = ""
    assert bench.step() is Stage.ZERO_TORQUE


def test_each_step_waits_for_one_press_of_the_confirm_button():
    bench = Bench()
    bench.step(300)
    assert bench.core.stage is Stage.ZERO_TORQUE and kind(bench.sent) == "zero"
    bench.frame = remote_frame(("start",))
    bench.step(200)  # held: one press, one step
    assert bench.core.stage is Stage.DAMPING and kind(bench.sent) == "damping"
    bench.frame = remote_frame()
    bench.step(2000)
    assert bench.core.stage is Stage.DAMPING
    assert bench.press("start") is Stage.TO_POSE
    assert bench.press("start") is Stage.TO_POSE  # still moving
    bench.step(1300)
    assert bench.press("start") is Stage.HANDOVER and kind(bench.sent) == "position"


def test_the_first_position_command_is_the_measured_pose():
    bench = Bench().to(Stage.DAMPING)
    bench.pose = POSE + 0.3
    bench.frame = remote_frame(("start",))
    bench.step()
    assert kind(bench.sent) == "position"
    assert np.array_equal(bench.sent.q.astype(np.float32), bench.pose)
    assert bench.core.first_jump_rad == 0.0


def test_the_ramp_has_no_jump_and_ends_in_the_stand_pose():
    bench = Bench().to(Stage.DAMPING)
    bench.frame = remote_frame(("start",))
    bench.step()
    before = bench.sent.q
    for _ in range(1400):
        bench.step()
        assert np.abs(bench.sent.q - before).max() < 0.002
        before = bench.sent.q
    from downbeat.catalog.robot import load_g1

    assert np.allclose(before, load_g1().default_joint_pos, atol=1e-6)


def test_control_is_armed_and_its_first_position_command_takes_over():
    bench = Bench().to(Stage.HANDOVER)
    bench.command(g1_low_cmd_t.MODE_DAMPING)
    bench.step(10)
    assert bench.core.stage is Stage.HANDOVER and kind(bench.sent) == "position"
    assert operator_command_t.ARM in bench.core.outbox.operator
    bench.command()
    assert bench.step() is Stage.ACTIVE
    assert np.allclose(bench.sent.q, bench.pose + 0.1) and np.allclose(bench.sent.kp, 40)


def test_a_command_from_before_the_arming_does_not_take_over():
    bench = Bench().to(Stage.HANDOVER)
    bench.command(utime=bench.utime - 50_000)
    assert bench.step(5) is Stage.HANDOVER


def test_a_first_target_far_from_the_robot_trips():
    bench = Bench().to(Stage.HANDOVER)
    target = bench.pose.copy()
    target[7] += 0.7
    bench.command(target=target)
    assert bench.step() is Stage.TRIPPED
    assert "motor 7 is 0.70 rad away" in bench.core.trip


def test_control_that_does_not_answer_trips():
    bench = Bench().to(Stage.HANDOVER)
    bench.step(2600)
    assert bench.core.stage is Stage.TRIPPED and "no position command came" in bench.core.trip


def estop(bench):
    msg = estop_t()
    msg.level, msg.source = estop_t.DAMP, "a test"
    bench.core.take_estop(msg, bench.utime)


def heat(word):
    def make(bench):
        struct.pack_into("<h", bench.state, 76 + 3 * 56 + 16 + 2 * word, 125)

    return make


TRIPS = {
    "estop_button": (lambda b: setattr(b, "frame", remote_frame(("A", "select"))), 1),
    "estop_message": (estop, 1),
    "state_stale": (lambda b: setattr(b, "is_silent", True), 52),
    "command_expired": (lambda b: setattr(b, "keep_commanding", False), 52),
    "remote_lost": (lambda b: setattr(b, "frame", bytes(40)), 1502),
    "motor_fault": (lambda b: struct.pack_into("<I", b.state, 76 + 32, 7), 5),
    "winding_hot": (heat(1), 40),
    "case_hot": (heat(0), 40),
    "battery_empty": (lambda b: setattr(b.core.watch, "battery_soc", 0.05), 501),
    "second_commander": (lambda b: b.core.note_foreign(1, b.utime), 1),
    "leaving_control": (None, 0),
    "control_passive": (lambda b: setattr(b, "mode", g1_low_cmd_t.MODE_DAMPING), 1),
    "broken": (lambda b: b.core.fail("a test", b.utime), 1),
}


def test_every_row_of_the_table_has_a_test():
    assert set(TRIPS) == set(BRIDGE_FAULTS.names)


@pytest.mark.parametrize("name", sorted(set(TRIPS) - {"leaving_control"}))
def test_fault_leads_to_damping_in_time_and_stays(name):
    make, steps = TRIPS[name]
    bench = Bench().to(Stage.ACTIVE)
    bench.keep_commanding, bench.mode = True, g1_low_cmd_t.MODE_POSITION
    bench.core.outbox.estops.clear()

    def run(count):
        for _ in range(count):
            if bench.keep_commanding:
                bench.command(bench.mode)
            bench.step()

    run(100)
    assert bench.core.stage is Stage.ACTIVE and kind(bench.sent) == "position"
    make(bench)
    run(steps)
    assert bench.core.stage is Stage.TRIPPED and kind(bench.sent) == "damping"
    prefix = BRIDGE_FAULTS.named(name).message.split("{}")[0]
    assert bench.core.trip.startswith(prefix)
    told = bench.core.outbox.estops
    assert (told == [bench.core.trip]) == (name not in ("estop_message", "control_passive"))
    for _ in range(500):  # and nothing that control says changes it
        bench.mode = g1_low_cmd_t.MODE_POSITION
        bench.command()
        bench.step()
        assert kind(bench.sent) == "damping" and np.allclose(bench.sent.kd, 5.0)


def test_a_trip_is_cleared_by_the_operator_and_only_when_its_cause_is_gone():
    bench = Bench().to(Stage.ACTIVE)
    bench.frame = remote_frame(("B",))
    bench.step(3)
    bench.core.take_operator(operator_command_t.CLEAR_TRIP, bench.utime)
    assert bench.step() is Stage.TRIPPED
    bench.frame = remote_frame()
    bench.step()
    bench.core.take_operator(operator_command_t.ARM, bench.utime)
    assert bench.step() is Stage.TRIPPED
    bench.core.take_operator(operator_command_t.CLEAR_TRIP, bench.utime)
    assert bench.step() is Stage.DAMPING


def test_a_robot_on_the_floor_is_not_moved_to_a_standing_pose():
    bench = Bench().to(Stage.DAMPING)
    struct.pack_into("<4f", bench.state, 20, 0.8, 0.6, 0.0, 0.0)
    bench.step()
    assert bench.press("start") is Stage.DAMPING
    assert "lift it" in bench.core.hindrance(bench.utime)


def test_nothing_is_confirmed_by_itself_after_a_trip():
    bench = Bench(lenient=True, auto=True)
    bench.step(2500)
    assert bench.core.stage is Stage.TO_POSE
    bench.press("B")
    bench.core.take_operator(operator_command_t.CLEAR_TRIP, bench.utime)
    assert bench.step(3000) is Stage.DAMPING


@pytest.mark.parametrize("stage", [Stage.ZERO_TORQUE, Stage.TO_POSE, Stage.ACTIVE])
def test_leaving_is_through_damping(stage):
    bench = Bench().to(stage)
    bench.core.leave(bench.utime)
    for _ in range(990):
        bench.step()
        assert kind(bench.sent) == "damping" and not bench.core.has_left(bench.utime)
    bench.step(20)
    assert bench.core.has_left(bench.utime)


def test_a_robot_that_was_never_commanded_is_left_alone():
    bench = Bench()
    bench.step(10)
    assert bench.core.is_silent and bench.sent is None


def test_commands_of_another_time_are_refused_and_none_is_valid_for_long():
    bench = Bench().to(Stage.ACTIVE)
    bench.command(utime=bench.utime + 5_000_000)
    bench.command(utime=bench.utime - 5_000_000)
    assert bench.core.commands_refused == 2
    bench.command(valid_us=900_000)
    assert bench.step(99) is Stage.ACTIVE
    assert bench.step(2) is Stage.TRIPPED


@pytest.mark.parametrize(
    "wrong",
    [
        {"estop_buttons": ()},
        {"estop_buttons": ("start",)},
        {"estop_buttons": ("Z",)},
        {"damping": 0.0},
        {"state_stale_s": 5.0},
        {"battery_min": float("nan")},
    ],
)
def test_settings_that_would_disarm_the_safety_are_refused(wrong):
    with pytest.raises(ControlError, match="valid|needs|has no"):
        BridgeSettings(**wrong)
