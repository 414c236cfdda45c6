"""Observation terms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from downbeat.control.errors import ControlError
from downbeat.control.observation import (
    RobotState,
    check_terms,
    observe,
    projected_gravity,
    tilt,
    yaw,
)

quats = arrays(np.float64, (4,), elements=st.floats(-1, 1)).filter(
    lambda q: np.linalg.norm(q) > 0.1
)


def test_gravity_points_down_when_upright():
    assert projected_gravity(np.array([1.0, 0, 0, 0])) == pytest.approx([0, 0, -1])


@given(quats)
def test_gravity_is_the_rotated_vertical(quat):
    import mujoco

    unit = quat / np.linalg.norm(quat)
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, unit)
    expected = matrix.reshape(3, 3).T @ np.array([0.0, 0.0, -1.0])
    assert projected_gravity(unit) == pytest.approx(expected, abs=1e-9)


def test_batches_give_the_same_as_one_at_a_time():
    rng = np.random.default_rng(0)
    quat = rng.normal(size=(5, 4))
    quat /= np.linalg.norm(quat, axis=-1, keepdims=True)
    state = RobotState(
        quat, rng.normal(size=(5, 3)), rng.normal(size=(5, 29)), rng.normal(size=(5, 29))
    )
    names = ("projected_gravity", "base_ang_vel", "joint_pos", "joint_vel")
    batch = observe(state, names)
    assert batch.shape == (5, 64)
    for k in range(5):
        one = RobotState(quat[k], state.base_ang_vel[k], state.joint_pos[k], state.joint_vel[k])
        assert (observe(one, names) == batch[k]).all()


def test_tilt_and_yaw_of_known_rotations():
    half = np.sqrt(0.5)
    assert tilt(np.array([half, half, 0, 0])) == pytest.approx(np.pi / 2, abs=1e-6)
    assert yaw(np.array([half, 0, 0, half])) == pytest.approx(np.pi / 2)


def test_unknown_term_names_the_known_ones():
    with pytest.raises(ControlError, match="projected_gravity"):
        check_terms(("odour",), "x.onnx:observation_names")
