"""The process "sim": the plant on the bus, in the place of the robot's bridge."""

from __future__ import annotations

import math

import numpy as np

from downbeat.catalog.robot import NUM_JOINTS
from downbeat.lcm_types import g1_low_state_t, imu_t, sim_truth_t
from downbeat.runtime.bus import Bus
from downbeat.sim.noise import NoiseSource, roll_pitch_yaw, rotate
from downbeat.sim.plant import Plant, PlantConfig

TRUTH_PERIOD_US = 20_000
MAX_CATCH_UP_STEPS = 25
"""After a stall the plant makes up for at most this much; the rest is lost and is reported."""
MODE_MACHINE = 5
"""29 dof, rev 1.0."""


class SimNode:
    """Node "sim": takes G1_LOW_CMD, steps the plant, publishes G1_LOW_STATE and SIM_TRUTH.

    A call at `utime` integrates up to `utime` and publishes the state there. A command acts on the
    steps that begin at or after its stamp plus the configured delay: whether it arrives a little
    sooner or later in between changes nothing, so real time and lockstep see the same plant.
    """

    name = "sim"

    def __init__(self, bus: Bus, config: PlantConfig | None = None) -> None:
        """Wire the process.

        Args:
            bus: Endpoint of the process "sim".
            config: Settings of the plant.

        Raises:
            SimError: A setting is impossible.
        """
        self._bus = bus
        self.plant = Plant(config)
        self.period_us = self.plant.step_us
        self._noise = NoiseSource(self.plant.config.noise, self.plant.config.seed, num_imus=2)
        self._state = _new_state()
        self._truth = sim_truth_t()
        self._first_utime: int | None = None
        self._utime = 0
        self._lost_us = 0
        self._max_lag_us = 0
        bus.subscribe("G1_LOW_CMD")

    def step(self, utime: int) -> None:
        """Bring the plant up to `utime` [us]."""
        self._bus.pump()
        for received in self._bus.take("G1_LOW_CMD"):
            self.plant.command(received.msg, utime)
        if self._first_utime is None:
            self._first_utime = self._utime = utime - self.period_us
        behind = (utime - self._utime) // self.period_us
        self._max_lag_us = max(self._max_lag_us, (behind - 1) * self.period_us)
        if behind > MAX_CATCH_UP_STEPS:
            lost_us = (behind - MAX_CATCH_UP_STEPS) * self.period_us
            self._lost_us += lost_us
            self._utime += lost_us
            behind = MAX_CATCH_UP_STEPS
        for _ in range(behind):
            self._advance()

    def _advance(self) -> None:
        plant = self.plant
        plant.step(self._utime)
        self._utime += self.period_us
        if plant.diverged:
            return  # nothing true can be said any more; control sees a stale state
        self._publish_state()
        if self._utime % TRUTH_PERIOD_US == 0:
            self._publish_truth()

    def _publish_state(self) -> None:
        plant, noise, state = self.plant, self._noise, self._state
        noise.draw()
        state.header.utime = self._utime
        state.tick = plant.steps
        state.joint_pos[:] = plant.joint_pos + noise.joint_pos
        state.joint_vel[:] = plant.joint_vel + noise.joint_vel
        state.joint_torque_est[:] = plant.joint_torque
        for index, imu in enumerate((state.imu_pelvis, state.imu_torso)):
            quat, gyro, accel = plant.imu(index)
            rotation, gyro_noise, accel_noise = noise.imu(index)
            measured = rotate(quat, rotation)
            imu.quat[:] = measured
            imu.rpy[:] = roll_pitch_yaw(measured)
            imu.gyro[:] = gyro + gyro_noise
            imu.accel[:] = accel + accel_noise
        self._bus.publish("G1_LOW_STATE", state)

    def _publish_truth(self) -> None:
        truth, data = self._truth, self.plant.data
        truth.header.utime = self._utime
        truth.qpos = data.qpos
        truth.qvel = data.qvel
        truth.contact_force = self.plant.contact_force().astype(np.float32)
        self._bus.publish("SIM_TRUTH", truth)

    @property
    def realtime_factor(self) -> float:
        """Share of the show's time that was simulated; 1.0 if nothing was lost."""
        if self._first_utime is None or self._utime == self._first_utime:
            return 1.0
        elapsed_us = self._utime - self._first_utime
        return (elapsed_us - self._lost_us) / elapsed_us

    @property
    def detail(self) -> str:
        """For the heartbeat: how the plant keeps up and what commands it saw."""
        counters = self.plant.counters
        return (
            f"plant_realtime_factor={self.realtime_factor:.4f} max_lag_us={self._max_lag_us}"
            f" commands={counters.accepted} refused={counters.refused}"
            f" expired={counters.expired} diverged={int(self.plant.diverged)}"
        )

    def close(self) -> None:
        """Nothing to release."""


def _new_state() -> g1_low_state_t:
    """Return a state with its constant fields filled and arrays of the wire's types."""
    state = g1_low_state_t()
    state.joint_pos = np.zeros(NUM_JOINTS, np.float32)
    state.joint_vel = np.zeros(NUM_JOINTS, np.float32)
    state.joint_torque_est = np.zeros(NUM_JOINTS, np.float32)
    state.source = g1_low_state_t.SOURCE_SIM
    state.mode_pr = 0
    state.mode_machine = MODE_MACHINE
    state.temperature_case = np.full(NUM_JOINTS, -1, np.int16)
    state.temperature_winding = np.full(NUM_JOINTS, -1, np.int16)
    state.motor_fault = np.zeros(NUM_JOINTS, np.int32)
    state.imu_pelvis = _new_imu()
    state.imu_torso = _new_imu()
    state.battery_soc = math.nan
    state.wireless_remote = bytes(40)
    return state


def _new_imu() -> imu_t:
    imu = imu_t()
    imu.quat = np.zeros(4, np.float32)
    imu.gyro = np.zeros(3, np.float32)
    imu.accel = np.zeros(3, np.float32)
    imu.rpy = np.zeros(3, np.float32)
    imu.temperature = -1
    return imu
