import numpy as np
import pytest

from downbeat.catalog.errors import CatalogError
from downbeat.catalog.robot import load_g1


def test_joints_are_the_29_motors_in_motor_order():
    robot = load_g1()
    assert len(robot.joint_names) == 29
    assert robot.joint_names[0] == "left_hip_pitch_joint"
    assert robot.joint_names[6] == "right_hip_pitch_joint"
    assert robot.joint_names[12] == "waist_yaw_joint"
    assert robot.joint_names[28] == "right_wrist_yaw_joint"


def test_gains_follow_their_rule():
    robot = load_g1()
    omega = 2.0 * np.pi * 10.0
    np.testing.assert_allclose(robot.joint_stiffness, robot.joint_armature * omega**2, rtol=1e-9)
    np.testing.assert_allclose(
        robot.joint_damping, 2.0 * 2.0 * robot.joint_armature * omega, rtol=1e-9
    )
    np.testing.assert_allclose(
        robot.action_scale, 0.25 * robot.effort_limit / robot.joint_stiffness, rtol=1e-9
    )


def test_the_default_pose_lies_inside_the_joint_ranges():
    robot = load_g1()
    assert np.all(robot.default_joint_pos > robot.joint_range[:, 0])
    assert np.all(robot.default_joint_pos < robot.joint_range[:, 1])


def test_ranges_of_left_and_right_mirror_each_other():
    robot = load_g1()
    left = robot.joint_range[robot.joint_index("left_hip_roll")]
    right = robot.joint_range[robot.joint_index("right_hip_roll")]
    np.testing.assert_allclose(left, -right[::-1])


def test_joint_index_accepts_short_and_full_names():
    robot = load_g1()
    assert robot.joint_index("left_knee") == robot.joint_index("left_knee_joint") == 3


def test_an_unknown_joint_is_answered_with_the_known_ones():
    with pytest.raises(CatalogError, match="left_knee_joint"):
        load_g1().joint_index("tail")


def test_an_unknown_site_is_answered_with_the_known_ones():
    with pytest.raises(CatalogError, match="imu_in_pelvis"):
        load_g1().site("imu_in_tail")


def test_nobody_can_change_the_shared_arrays():
    with pytest.raises(ValueError, match="read-only"):
        load_g1().joint_stiffness[0] = 0.0
