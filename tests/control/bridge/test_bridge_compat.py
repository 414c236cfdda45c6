"""Walk-these-ways style controllers against the bridge: their types, their habits, our rules."""

import time

import lcm
import numpy as np
import pytest
from test_bridge_core import Bench

from downbeat.catalog.robot import load_g1
from downbeat.control.bridge.compat import TARGETS, Compat
from downbeat.control.bridge.remote import remote_frame
from downbeat.control.bridge.stages import Stage
from downbeat.control.bridge.stand_pose import PoseRamp
from downbeat.lcm_types.compat import (
    body_control_data_lcmt,
    leg_control_data_lcmt,
    pd_tau_targets_29_lcmt,
    pd_tau_targets_lcmt,
    rc_command_lcmt,
    state_estimator_lcmt,
)
from downbeat.runtime.udpm import drain


class Foreign:
    """A controller of the field on an LCM of its own."""

    def __init__(self, core):
        self.link = lcm.LCM("memq://")
        self.heard = {}
        self.link.subscribe(
            ".*", lambda channel, data: self.heard.setdefault(channel, []).append(data)
        )
        self.compat = Compat(self.link, core)

    def send(self, msg):
        self.link.publish(TARGETS, msg.encode() if hasattr(msg, "encode") else msg)


def legs(q, kp=40.0):
    msg = pd_tau_targets_lcmt()
    msg.q_des, msg.kp, msg.kd = [q] * 12, [kp] * 12, [1.0] * 12
    return msg


def test_states_go_out_with_the_fields_of_the_field():
    bench = Bench().to(Stage.ZERO_TORQUE)
    foreign = Foreign(bench.core)
    bench.frame = remote_frame(("L1", "R2"), left_stick=(0.25, -0.5))
    bench.step()
    foreign.compat(bench.utime)
    drain(foreign.link)
    base = state_estimator_lcmt.decode(foreign.heard["state_estimator_data"][0])
    leg = leg_control_data_lcmt.decode(foreign.heard["leg_control_data"][0])
    body = body_control_data_lcmt.decode(foreign.heard["body_control_data"][0])
    rc = rc_command_lcmt.decode(foreign.heard["rc_command"][0])
    assert np.allclose(body.q, bench.pose) and np.allclose(leg.q, bench.pose[:12])
    assert list(base.quat) == [1.0, 0.0, 0.0, 0.0] and base.timestamp_us == bench.utime
    assert (rc.left_upper_switch, rc.right_lower_right_switch, rc.right_upper_switch) == (1, 1, 0)
    assert list(rc.left_stick) == [0.25, -0.5]


def test_states_go_out_two_hundred_times_a_second_though_cycles_take_2_ms():
    bench = Bench().to(Stage.ZERO_TORQUE)
    foreign = Foreign(bench.core)
    for _ in range(500):
        bench.step()
        foreign.compat(bench.utime)
    drain(foreign.link)
    seconds = 500 * 0.002
    assert abs(len(foreign.heard["rc_command"]) / seconds - 200) <= 2


def test_world_vectors_are_the_rotated_ones():
    from downbeat.control.bridge.compat import _to_world

    half = 0.5**0.5
    assert np.allclose(_to_world([half, 0.0, 0.0, half], [1.0, 0.0, 0.0]), [0.0, 1.0, 0.0])
    assert np.allclose(_to_world([half, half, 0.0, 0.0], [0.0, 0.0, 9.81]), [0.0, -9.81, 0.0])


def test_leg_targets_move_the_legs_and_the_rest_holds_the_pose():
    bench = Bench().to(Stage.HANDOVER)
    bench.pose = np.asarray(load_g1().default_joint_pos, np.float32)
    bench.step()
    foreign = Foreign(bench.core)
    foreign.send(legs(0.2))
    foreign.compat(bench.utime + 1)
    assert bench.step() is Stage.ACTIVE
    assert np.allclose(bench.sent.q[:12], 0.2) and np.allclose(bench.sent.kp[:12], 40.0)
    assert np.allclose(bench.sent.q[12:], load_g1().default_joint_pos[12:], atol=1e-6)


def test_targets_of_all_joints_use_the_bridges_gains():
    bench = Bench().to(Stage.HANDOVER)
    foreign = Foreign(bench.core)
    msg = pd_tau_targets_29_lcmt()
    msg.q_des = [float(v) + 0.1 for v in bench.pose]
    foreign.send(msg)
    foreign.compat(bench.utime + 1)
    assert bench.step() is Stage.ACTIVE
    assert np.allclose(bench.sent.q, bench.pose + 0.1, atol=1e-6)
    assert np.allclose(bench.sent.kp, PoseRamp(1.0).stiffness)


def test_targets_that_stop_coming_lead_to_damping_though_nothing_says_how_long_they_hold():
    bench = Bench().to(Stage.HANDOVER)
    foreign = Foreign(bench.core)
    msg = pd_tau_targets_29_lcmt()
    msg.q_des = [float(v) for v in bench.pose]
    foreign.send(msg)
    foreign.compat(bench.utime + 1)
    assert bench.step() is Stage.ACTIVE
    bench.step(49)
    assert bench.core.stage is Stage.ACTIVE
    assert bench.step(2) is Stage.TRIPPED


def bad(name, value):
    msg = legs(0.0)
    getattr(msg, name)[3] = value
    return msg


@pytest.mark.parametrize(
    ("sent", "reason"),
    [
        (bad("q_des", float("nan")), "q_des not finite or out of range"),
        (bad("q_des", 11.0), "q_des not finite or out of range"),
        (bad("kp", -1.0), "kp not finite or out of range"),
        (bad("kd", float("inf")), "kd not finite or out of range"),
        (bad("tau_ff", 1e6), "tau_ff not finite or out of range"),
        (b"", "unknown type"),
        (b"12345678", "unknown type"),
        (legs(0.0).encode()[:100], "wrong length"),
        (legs(0.0).encode() + b"x", "wrong length"),
    ],
)
def test_bad_targets_are_counted_named_and_dropped(sent, reason):
    bench = Bench().to(Stage.HANDOVER)
    foreign = Foreign(bench.core)
    foreign.send(sent)
    foreign.compat(bench.utime + 1)
    assert bench.step() is Stage.HANDOVER
    assert foreign.compat.rejected == {reason: 1} and foreign.compat.accepted == 0


@pytest.mark.slow
def test_a_foreign_controller_stands_our_plant_through_the_bridge(rig):
    one = rig(operator=True, settings="leave_s = 0.6\n")
    one.start_bridge("--compat")
    ramp, pose = PoseRamp(1.0), load_g1().default_joint_pos
    link = lcm.LCM(one.url)
    heard = []
    link.subscribe("leg_control_data", lambda _c, data: heard.append(data))
    msg = pd_tau_targets_lcmt()
    msg.q_des = [float(v) for v in pose[:12]]
    msg.kp = [float(v) for v in ramp.stiffness[:12]]
    msg.kd = [float(v) for v in ramp.damping[:12]]
    end = time.monotonic() + 18.0
    standing = []
    while time.monotonic() < end:
        link.publish(TARGETS, msg.encode())
        link.handle_timeout(20)
        report = one.ask()
        if report["crane"] == 0.0:
            standing.append(report["height"])
    assert any(line.endswith("active") for line in one.bridge.read())
    assert len(standing) > 50 and min(standing) > 0.7
    one.wait_for("damping", 2.0)  # it stopped sending
    assert len(heard) > 500
