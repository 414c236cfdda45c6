"""The state estimate against the plant's truth, and its properties."""

import json
import math
import time

import numpy as np
import pytest
from test_kinematics import mirror

from downbeat.catalog.robot import load_g1
from downbeat.control.errors import ControlError
from downbeat.control.estimate import IMU_POS, StateEstimator
from downbeat.control.kinematics import centre_of_mass_motion, feet
from downbeat.control.policy import SkillLibrary
from downbeat.control.soles import SoleLimits, see_sole
from downbeat.control.support import capture_point, convex_hull, signed_distance
from downbeat.control.vectors import cross, plus, rotation_of, turn, turn_back
from downbeat.sim.motion_trials import MotionTrial, play

ROBOT = load_g1()
REST = np.asarray(ROBOT.default_joint_pos)
UPRIGHT = (1.0, 0.0, 0.0, 0.0)
GRAVITY = (0.0, 0.0, 9.81)
STILL = (0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def recorded():
    """Samples of every skill that the accuracy is stated for, from 1 s after the request on."""
    skills = {
        "stand": STILL,
        "kpop": STILL,
        "discostep": STILL,
        "walk": (0.4, 0.0, 0.0),  # the fastest it walks is 0.25 m/s
    }
    library = SkillLibrary.load(only=frozenset(skills))
    return {
        name: list(play(library, MotionTrial(name, 8.0, velocity=velocity)))
        for name, velocity in skills.items()
    }


def inputs(sample):
    state, imu = sample.state, sample.state.imu_pelvis
    return imu.quat, imu.gyro, imu.accel, state.joint_pos, state.joint_vel


def truth(sample):
    """True base velocity (base frame), margin of the true capture point in both soles."""
    rotation = rotation_of(sample.qpos[3:7].tolist())
    pos, vel = tuple(sample.qpos[:3].tolist()), tuple(sample.qvel[:3].tolist())
    joints, rates = sample.qpos[7:].tolist(), sample.qvel[6:].tolist()
    turn_rate = turn(rotation, tuple(sample.qvel[3:6].tolist()))
    com_b, com_rate_b = centre_of_mass_motion(joints, rates)
    arm = turn(rotation, com_b)
    com_vel = plus(vel, plus(cross(turn_rate, arm), turn(rotation, com_rate_b)))
    corners = [
        (pos[0] + x, pos[1] + y)
        for motion in feet(joints, rates)
        for x, y, _ in see_sole(SoleLimits(), motion, rotation, turn_rate, STILL).corners
    ]
    margin = signed_distance(capture_point(plus(pos, arm), com_vel), convex_hull(corners))
    return turn_back(rotation, vel), margin


@pytest.mark.parametrize("skill", ["stand", "kpop", "discostep", "walk"])
def test_estimate_is_close_to_the_truth_with_noise_and_delay(recorded, skill, capsys):
    estimator = StateEstimator()
    rows = []
    for sample in recorded[skill]:
        estimate = estimator.update(*inputs(sample))
        if sample.time_s > 0.5:
            vel, margin = truth(sample)
            rows.append(
                (
                    *np.subtract(estimate.base_lin_vel, vel),
                    estimate.base_height - sample.qpos[2],
                    estimate.step_margin - margin,
                )
            )
    rmse = np.sqrt(np.mean(np.square(rows), axis=0))
    with capsys.disabled():
        print(
            f"  {skill}: base_lin_vel RMSE {rmse[:3].round(3)} m/s, height {rmse[3] * 1e3:.1f} mm,"
            f" margin {rmse[4] * 1e3:.1f} mm",
            end="",
        )
    assert rmse[:3].max() < 0.04
    assert rmse[3] < 0.004
    assert rmse[4] < 0.015


def test_walking_is_seen_as_walking(recorded):
    """The odometry covers the distance that was walked; each foot lifts while the other stands."""
    estimator = StateEstimator()
    estimates = [estimator.update(*inputs(sample)) for sample in recorded["walk"]]
    walked = recorded["walk"][-1].qpos[0] - recorded["walk"][0].qpos[0]
    assert walked > 0.8
    assert estimates[-1].base_pos[0] == pytest.approx(walked, rel=0.1)
    stance = np.array([e.stance_confidence for e in estimates[200:]])
    assert (stance.max(axis=1) > 0.4).mean() > 0.98
    assert (stance[:, 0] < 0.1).any() and (stance[:, 1] < 0.1).any()


def test_a_robot_at_rest_is_seen_at_rest():
    estimator = StateEstimator()
    for _ in range(100):
        estimate = estimator.update(UPRIGHT, STILL, GRAVITY, REST, np.zeros(29))
    np.testing.assert_allclose(estimate.base_lin_vel, 0.0, atol=1e-12)
    np.testing.assert_allclose(estimate.base_pos[:2], 0.0, atol=1e-12)
    assert estimate.stance_confidence == (1.0, 1.0)
    assert estimate.base_height == pytest.approx(0.755, abs=0.01)
    assert estimate.support_margin == estimate.step_margin > 0.05


def test_heading_changes_nothing_but_the_worlds_axes(recorded):
    """The base frame's velocity, heights and margins are the same wherever the robot looks."""
    half = 0.5 * 2.1
    yaw = (math.cos(half), 0.0, 0.0, math.sin(half))
    ahead, turned = StateEstimator(), StateEstimator()
    for sample in recorded["walk"][::2]:
        quat, *others = inputs(sample)
        a = ahead.update(quat.tolist(), *others)
        b = turned.update(product(yaw, quat.tolist()), *others)
        np.testing.assert_allclose(b.base_lin_vel, a.base_lin_vel, atol=1e-9)
        np.testing.assert_allclose(turn(rotation_of(yaw), a.com), b.com, atol=1e-9)
        assert b.support_margin == pytest.approx(a.support_margin, abs=1e-9)
        assert b.step_margin == pytest.approx(a.step_margin, abs=1e-9)


def product(a, b):
    (aw, ax, ay, az), (bw, bx, by, bz) = a, b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def test_the_mirrored_motion_has_the_mirrored_estimate(recorded):
    """Up to half a millimetre: the torso's centre of mass is not in the middle."""
    plain, mirrored = StateEstimator(), StateEstimator()
    flip = np.array([1.0, -1.0, 1.0])
    for sample in recorded["discostep"]:
        quat, gyro, accel, joint_pos, joint_vel = (x.astype(float) for x in inputs(sample))
        a = plain.update(quat, gyro, accel, joint_pos, joint_vel)
        b = mirrored.update(
            quat * (1, -1, 1, -1), -flip * gyro, flip * accel, mirror(joint_pos), mirror(joint_vel)
        )
        np.testing.assert_allclose(b.base_lin_vel, flip * a.base_lin_vel, atol=1e-9)
        np.testing.assert_allclose(b.com, flip * a.com, atol=5e-4)
        assert b.stance_confidence == pytest.approx(a.stance_confidence[::-1], abs=1e-9)
        assert b.step_margin == pytest.approx(a.step_margin, abs=1e-3)


@pytest.mark.parametrize("broken", [math.nan, math.inf, 1e30])
@pytest.mark.parametrize("place", range(5))
def test_an_unusable_input_is_not_remembered(recorded, broken, place):
    estimator = StateEstimator()
    samples = recorded["kpop"]
    for sample in samples[:50]:
        estimator.update(*inputs(sample))
    before = estimator.to_state()
    values = [array.copy() for array in inputs(samples[50])]
    values[place][1] = broken
    estimate = estimator.update(*values)
    assert math.isnan(estimate.support_margin) and math.isnan(estimate.step_margin)
    assert estimator.to_state() == before
    after = estimator.update(*inputs(samples[51]))
    assert abs(after.base_lin_vel[0]) < 0.2


def test_a_quaternion_of_zeros_is_not_a_rotation(recorded):
    estimator = StateEstimator()
    estimate = estimator.update((0.0,) * 4, *inputs(recorded["stand"][0])[1:])
    assert math.isnan(estimate.base_height)
    assert not estimator.state.is_started


def test_the_same_inputs_give_the_same_bits(recorded):
    one, other = StateEstimator(), StateEstimator()
    one.update(*inputs(recorded["kpop"][300]))
    one.reset()
    for sample in recorded["discostep"][:200]:
        assert one.update(*inputs(sample)) == other.update(*inputs(sample))
    assert one.to_state() == other.to_state()


def test_a_state_restored_from_json_continues_bit_for_bit(recorded):
    samples = recorded["discostep"]
    whole, first, second = StateEstimator(), StateEstimator(), StateEstimator()
    for sample in samples[:150]:
        whole.update(*inputs(sample))
        first.update(*inputs(sample))
    second.from_state(json.loads(json.dumps(first.to_state())))
    for sample in samples[150:250]:
        assert whole.update(*inputs(sample)) == second.update(*inputs(sample))


def test_a_state_of_another_shape_is_refused():
    estimator = StateEstimator()
    with pytest.raises(ControlError, match="imu_vel"):
        estimator.from_state({"is_started": True})
    with pytest.raises(ControlError, match="base_pos"):
        estimator.from_state({**estimator.to_state(), "base_pos": [0.0]})


def test_the_imu_is_where_the_model_has_it():
    assert ROBOT.site("imu_in_pelvis").body == ROBOT.body_names[0]
    assert ROBOT.site("imu_in_pelvis").pos == IMU_POS


def test_points_are_inside_or_outside_of_a_hull():
    square = convex_hull([(0, 0), (1, 0), (1, 1), (0, 1), (0.5, 0.5), (0.5, 0.0), (0, 0)])
    assert len(square) == 4
    assert signed_distance((0.5, 0.4), square) == pytest.approx(0.4)
    assert signed_distance((2.0, 0.5), square) == pytest.approx(-1.0)
    assert signed_distance((2.0, 2.0), square) == pytest.approx(-math.sqrt(2.0))
    assert signed_distance((0.5, 0.3), convex_hull([(0, 0), (1, 0)])) == pytest.approx(-0.3)
    assert math.isnan(signed_distance((0.0, 0.0), []))


def test_every_update_of_a_dance_is_finite(recorded, capsys):
    """Its cost is printed only: time on a shared machine is no claim."""
    estimator = StateEstimator()
    times_us = []
    for sample in recorded["discostep"]:
        measured = [array.tolist() for array in inputs(sample)]
        start = time.perf_counter_ns()
        estimate = estimator.update(*measured)
        times_us.append((time.perf_counter_ns() - start) * 1e-3)
        assert math.isfinite(estimate.step_margin) and math.isfinite(estimate.base_height)
    with capsys.disabled():
        print(f"  update: p50 {np.median(times_us):.0f} us", end="")
