import math
import subprocess
import sys
import time

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from downbeat.catalog.mjcf import ModelOptions, g1_mjcf
from downbeat.catalog.robot import load_g1
from downbeat.control import kinematics
from downbeat.control.kinematics_code import Writer
from downbeat.control.kinematics_links import IDENTITY, read_links

ROBOT = load_g1()


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(g1_mjcf(ModelOptions(visual=False)))


def _draw(seed):
    rng = np.random.default_rng(seed)
    low, high = ROBOT.joint_range.T
    return rng.uniform(low, high), rng.uniform(-5.0, 5.0, 29)


def _truth(model, joint_pos, joint_vel):
    """MuJoCo with the base at the origin, at rest."""
    data = mujoco.MjData(model)
    data.qpos[:7] = (0, 0, 0, 1, 0, 0, 0)
    data.qpos[7:], data.qvel[6:] = joint_pos, joint_vel
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    return data


def _foot_truth(model, data, side):
    body = data.body(ROBOT.feet.body_names[side])
    rotation = body.xmat.reshape(3, 3)
    pos = body.xpos + rotation @ np.array(kinematics.SOLE_CENTRE)
    jac_pos, jac_rot = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, jac_pos, jac_rot, pos, body.id)
    return pos, jac_pos @ data.qvel, jac_rot @ data.qvel, rotation[:, 0], rotation[:, 2]


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_feet_torso_and_centre_of_mass_agree_with_mujoco(model, seed):
    joint_pos, joint_vel = _draw(seed)
    data = _truth(model, joint_pos, joint_vel)
    q, v = joint_pos.tolist(), joint_vel.tolist()
    for side, foot in enumerate(kinematics.feet(q, v)):
        for ours, theirs in zip(foot, _foot_truth(model, data, side)):
            np.testing.assert_allclose(ours, theirs, atol=1e-9)
    pos, quat = kinematics.torso_pose(q)
    torso = data.body("torso_link")
    np.testing.assert_allclose(pos, torso.xpos, atol=1e-9)
    assert abs(np.sum(np.array(quat) * torso.xquat)) == pytest.approx(1.0, abs=1e-12)
    com, com_vel = kinematics.centre_of_mass_motion(q, v)
    np.testing.assert_allclose(com, data.subtree_com[0], atol=1e-9)
    np.testing.assert_allclose(com_vel, data.subtree_linvel[0], atol=1e-9)
    assert kinematics.centre_of_mass(q) == com


@pytest.mark.parametrize("library", ["numpy", "jax.numpy"])
def test_the_batch_is_the_single_robot_many_times(library):
    xp = pytest.importorskip(library)
    tolerance = 1e-12 if library == "numpy" else 1e-4  # jax computes in float32
    drawn = [_draw(seed) for seed in range(6)]
    joint_pos = np.array([d[0] for d in drawn]).reshape(2, 3, 29)
    joint_vel = np.array([d[1] for d in drawn]).reshape(2, 3, 29)
    feet = kinematics.feet_batch(xp.asarray(joint_pos), xp.asarray(joint_vel), xp)
    torso = kinematics.torso_pose_batch(xp.asarray(joint_pos), xp)
    com = kinematics.centre_of_mass_motion_batch(xp.asarray(joint_pos), xp.asarray(joint_vel), xp)
    alone = kinematics.centre_of_mass_batch(xp.asarray(joint_pos), xp)
    for i in np.ndindex(2, 3):
        q, v = joint_pos[i].tolist(), joint_vel[i].tolist()
        for many, one in zip(feet, kinematics.feet(q, v)):
            for a, b in zip(many, one):
                np.testing.assert_allclose(a[i], b, atol=tolerance)
        for many, one in zip(torso, kinematics.torso_pose(q)):
            np.testing.assert_allclose(many[i], one, atol=tolerance)
        for many, one in zip(com, kinematics.centre_of_mass_motion(q, v)):
            np.testing.assert_allclose(many[i], one, atol=tolerance)
        np.testing.assert_allclose(alone[i], com[0][i], atol=tolerance)


def test_foot_velocity_is_the_derivative_of_foot_position():
    joint_pos, joint_vel = _draw(3)
    step = 1e-6
    before = kinematics.feet((joint_pos - step * joint_vel).tolist(), [0.0] * 29)
    after = kinematics.feet((joint_pos + step * joint_vel).tolist(), [0.0] * 29)
    now = kinematics.feet(joint_pos.tolist(), joint_vel.tolist())
    for a, b, foot in zip(before, after, now):
        difference = (np.array(b.pos) - np.array(a.pos)) / (2.0 * step)
        np.testing.assert_allclose(foot.lin_vel, difference, atol=1e-7)


def test_the_mirrored_pose_has_the_mirrored_feet():
    """The facts are mirror images but for a tenth of a millimetre in the shoulders."""
    joint_pos, joint_vel = _draw(5)
    left, right = kinematics.feet(joint_pos.tolist(), joint_vel.tolist())
    mirrored = kinematics.feet(mirror(joint_pos).tolist(), mirror(joint_vel).tolist())
    flip = np.array([1.0, -1.0, 1.0])
    for foot, image in ((left, mirrored[1]), (right, mirrored[0])):
        np.testing.assert_allclose(image.pos, flip * foot.pos, atol=1e-12)
        np.testing.assert_allclose(image.lin_vel, flip * foot.lin_vel, atol=1e-12)
        np.testing.assert_allclose(image.ang_vel, -flip * foot.ang_vel, atol=1e-12)


def mirror(joints):
    """Swap left and right; joints about x and z change sign."""
    out = np.empty(29)
    for i, name in enumerate(ROBOT.joint_names):
        other = name.replace("left", "RIGHT").replace("right", "left").replace("RIGHT", "right")
        sign = -1.0 if ("roll" in name or "yaw" in name) else 1.0
        out[ROBOT.joint_index(other)] = sign * joints[i]
    return out


def test_only_the_shoulders_keep_a_constant_rotation():
    kept = [n for n, link in zip(ROBOT.body_names, read_links()) if link.quat != IDENTITY]
    assert kept == ["left_shoulder_pitch_link", "right_shoulder_pitch_link"]


def test_the_source_holds_no_product_with_zero_or_one():
    source = kinematics.write_source()
    for useless in (" 0.0 *", "* 0.0 ", " 1.0 *", "* 1.0 ", "+ 0.0\n", "@"):
        assert useless not in source


def test_sums_are_simplified_before_they_are_written():
    w = Writer()
    assert w.total((0.0, "a"), (2.0, 3.0)) == 6.0
    assert w.total((1.0, "a"), (0.0, "b", "c")) == "a"
    assert w.lines == []
    w.total((-1.0, "a"), (2.0, "b", "c"), (-0.5,))
    assert w.lines == ["t1 = -a + 2.0 * b * c - 0.5"]


def test_control_kinematics_load_without_a_simulator():
    script = (
        "import sys, downbeat.control.kinematics, downbeat.control.estimate;"
        "print([m for m in ('mujoco', 'jax', 'torch', 'scipy') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stderr


def test_cost_of_a_call_is_printed(capsys):
    """Only printed: time on a shared machine is no claim."""
    joint_pos, joint_vel = (x.tolist() for x in _draw(1))
    calls = {
        "feet": lambda: kinematics.feet(joint_pos, joint_vel),
        "torso_pose": lambda: kinematics.torso_pose(joint_pos),
        "centre_of_mass": lambda: kinematics.centre_of_mass(joint_pos),
        "centre_of_mass_motion": lambda: kinematics.centre_of_mass_motion(joint_pos, joint_vel),
    }
    with capsys.disabled():
        for name, call in calls.items():
            times_us = []
            for _ in range(500):
                start = time.perf_counter_ns()
                call()
                times_us.append((time.perf_counter_ns() - start) * 1e-3)
            print(f"  {name}: p50 {np.median(times_us):.1f} us", end="")
            assert math.isfinite(times_us[0])
