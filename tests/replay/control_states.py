"""Measured states for tests that need no physics: an upright robot that trembles a little."""

import numpy as np

from downbeat.catalog.robot import load_g1
from downbeat.lcm_types import g1_low_state_t

START = 1_700_000_000_000_000


def fresh_state(tick):
    rng = np.random.default_rng(tick)
    state = g1_low_state_t()
    state.header.utime = START + tick * 20_000
    state.header.seq = tick
    state.imu_pelvis.quat = np.array([1.0, 0.0, 0.0, 0.0], np.float32)
    state.imu_torso.quat = np.array([1.0, 0.0, 0.0, 0.0], np.float32)
    state.imu_pelvis.gyro = rng.normal(scale=0.02, size=3).astype(np.float32)
    state.imu_pelvis.accel = np.array([0.0, 0.0, 9.81], np.float32)
    default = np.asarray(load_g1().default_joint_pos)
    state.joint_pos = (default + rng.normal(scale=0.003, size=29)).astype(np.float32)
    state.joint_vel = rng.normal(scale=0.05, size=29).astype(np.float32)
    state.battery_soc = float("nan")
    return state
