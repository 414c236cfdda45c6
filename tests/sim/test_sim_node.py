import math

import numpy as np
import pytest

from downbeat.catalog.robot import load_g1
from downbeat.lcm_types import g1_low_cmd_t, g1_low_state_t
from downbeat.runtime.bus import MemqHub
from downbeat.runtime.clock import SIM_EPOCH_UTIME as T0
from downbeat.runtime.clock import SimClock
from downbeat.sim.node import SimNode
from downbeat.sim.noise import NO_NOISE
from downbeat.sim.plant import PlantConfig

ROBOT = load_g1()


class Rig:
    """A plant, its bus, a commander and an ear."""

    def __init__(self, config=None):
        self.clock = SimClock()
        self.hub = MemqHub()
        self.wire = []
        self.hub.tap(lambda utime, channel, payload: self.wire.append((utime, channel, payload)))
        self.control = self.hub.endpoint("control", self.clock)
        self.ear = self.hub.endpoint("ear", self.clock)
        self.ear.subscribe("G1_LOW_STATE", "SIM_TRUTH")
        self.node = SimNode(self.hub.endpoint("sim", self.clock), config)

    def run(self, seconds, command=True):
        end = self.clock.utime() + round(seconds * 1e6)
        while self.clock.utime() < end:
            utime = self.clock.utime() + 2000
            self.clock.advance_to(utime)
            self.node.step(utime)
            if command and utime % 20_000 == 0:
                self.send(utime)
            self.ear.pump()

    def send(self, utime, **changes):
        msg = g1_low_cmd_t()
        msg.header.utime = utime
        msg.valid_until_utime = utime + 100_000
        msg.mode = g1_low_cmd_t.MODE_POSITION
        msg.joint_pos_target = ROBOT.default_joint_pos.astype(np.float32)
        msg.joint_vel_target = np.zeros(29, np.float32)
        msg.joint_torque_ff = np.zeros(29, np.float32)
        msg.joint_stiffness = ROBOT.joint_stiffness.astype(np.float32)
        msg.joint_damping = ROBOT.joint_damping.astype(np.float32)
        for name, value in changes.items():
            setattr(msg, name, value)
        self.control.publish("G1_LOW_CMD", msg)


def test_state_comes_at_500_hz_and_truth_at_50_hz_on_the_grid():
    rig = Rig()
    rig.run(1.0)
    states, truths = rig.ear.take("G1_LOW_STATE"), rig.ear.take("SIM_TRUTH")
    assert [s.msg.header.utime for s in states] == [T0 + 2000 * (i + 1) for i in range(500)]
    assert [t.msg.header.utime for t in truths] == [T0 + 20_000 * (i + 1) for i in range(50)]
    assert rig.ear.counters.rejected == 0


def test_without_noise_measurements_are_exact():
    rig = Rig(PlantConfig(noise=NO_NOISE))
    rig.run(0.2)
    state = rig.ear.latest("G1_LOW_STATE").msg
    truth = rig.ear.latest("SIM_TRUTH").msg
    assert state.header.utime == truth.header.utime
    np.testing.assert_array_equal(state.joint_pos, truth.qpos[7:].astype(np.float32))
    np.testing.assert_array_equal(state.joint_vel, truth.qvel[6:].astype(np.float32))
    np.testing.assert_array_equal(state.imu_pelvis.quat, truth.qpos[3:7].astype(np.float32))
    np.testing.assert_array_equal(state.imu_pelvis.gyro, truth.qvel[3:6].astype(np.float32))


def test_noise_is_on_by_default_and_bounded():
    rig = Rig()
    rig.run(0.2)
    state = rig.ear.latest("G1_LOW_STATE").msg
    truth = rig.ear.latest("SIM_TRUTH").msg
    error = np.abs(state.joint_pos - truth.qpos[7:])
    assert 0.0 < error.max() <= 0.003 + 1e-6
    assert np.abs(state.joint_vel - truth.qvel[6:]).max() <= 0.15 + 1e-6


def test_the_state_says_what_it_is():
    rig = Rig()
    rig.run(0.02)
    state = rig.ear.latest("G1_LOW_STATE").msg
    assert state.source == g1_low_state_t.SOURCE_SIM
    assert state.mode_machine == 5
    assert math.isnan(state.battery_soc)
    assert state.imu_pelvis.accel[2] == pytest.approx(9.81, abs=0.5)
    assert state.imu_torso.accel[2] == pytest.approx(9.81, abs=0.5)


def test_the_same_seed_gives_identical_bytes_and_another_does_not():
    wires = []
    for seed in (1, 1, 2):
        rig = Rig(PlantConfig(seed=seed))
        rig.run(0.5)
        wires.append(rig.wire)
    assert wires[0] == wires[1]
    assert wires[0] != wires[2]


def test_a_command_with_nan_changes_nothing_but_a_counter():
    clean, dirty = Rig(), Rig()
    for rig in (clean, dirty):
        rig.run(0.1)
        if rig is dirty:
            target = ROBOT.default_joint_pos.astype(np.float32)
            target[3] = math.nan
            rig.send(rig.clock.utime(), joint_pos_target=target)
        rig.run(0.05, command=False)
    truths = [rig.ear.latest("SIM_TRUTH").msg.qpos for rig in (clean, dirty)]
    np.testing.assert_array_equal(*truths)


def test_silence_of_control_ends_in_damping():
    rig = Rig()
    rig.run(0.2)
    rig.run(0.2, command=False)
    assert rig.node.plant.mode == g1_low_cmd_t.MODE_DAMPING
    assert "expired=1" in rig.node.detail


def test_a_late_call_is_made_up_for():
    rig = Rig()
    rig.run(0.1)
    late = rig.clock.utime() + 10_000
    rig.clock.advance_to(late)
    rig.node.step(late)
    rig.ear.pump()
    assert rig.ear.latest("G1_LOW_STATE").msg.header.utime == late
    assert rig.node.plant.steps == 55
    assert rig.node.realtime_factor == 1.0


def test_a_long_stall_shows_in_the_real_time_factor():
    rig = Rig()
    rig.run(1.0)
    late = rig.clock.utime() + 1_000_000
    rig.clock.advance_to(late)
    rig.node.step(late)
    assert rig.node.realtime_factor == pytest.approx(0.525, abs=0.01)
    assert "plant_realtime_factor=0.52" in rig.node.detail


def test_physics_that_diverged_falls_silent():
    rig = Rig(PlantConfig(start="free"))
    rig.run(0.1)
    rig.node.plant.data.qvel[0] = np.inf
    rig.ear.take("G1_LOW_STATE")
    rig.run(0.1)
    assert rig.node.plant.diverged
    assert all(np.isfinite(r.msg.joint_pos).all() for r in rig.ear.take("G1_LOW_STATE"))
    rig.run(0.1)
    assert rig.ear.take("G1_LOW_STATE") == []
