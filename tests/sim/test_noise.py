import numpy as np
import pytest

from downbeat.sim.noise import NO_NOISE, NoiseConfig, NoiseSource, roll_pitch_yaw, rotate

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


def random_quat(rng):
    quat = rng.normal(size=4)
    return quat / np.linalg.norm(quat)


def test_noise_stays_inside_its_widths_and_fills_them():
    config = NoiseConfig()
    source = NoiseSource(config, seed=3, num_imus=1)
    samples = []
    for _ in range(200):
        source.draw()
        samples.append((source.joint_pos.copy(), source.joint_vel.copy(), source.imu(0)[1].copy()))
    for index, width in enumerate(
        (config.joint_pos_rad, config.joint_vel_rad_s, config.gyro_rad_s)
    ):
        values = np.concatenate([s[index] for s in samples])
        assert np.abs(values).max() <= width
        assert np.abs(values).max() > 0.95 * width
        assert abs(values.mean()) < 0.15 * width


def test_no_noise_is_exactly_zero():
    source = NoiseSource(NO_NOISE, seed=0, num_imus=2)
    source.draw()
    assert not source.joint_pos.any()
    assert not source.imu(1)[0].any()


def test_the_same_seed_draws_the_same_noise():
    first, second, other = (NoiseSource(NoiseConfig(), seed, 2) for seed in (5, 5, 6))
    for source in (first, second, other):
        source.draw()
    np.testing.assert_array_equal(first.joint_pos, second.joint_pos)
    assert not np.array_equal(first.joint_pos, other.joint_pos)


def test_turning_by_nothing_changes_no_bit():
    quat = random_quat(np.random.default_rng(0))
    assert rotate(quat, np.zeros(3)) == tuple(quat)


def test_turning_there_and_back_is_the_identity():
    rng = np.random.default_rng(1)
    for _ in range(20):
        quat, rotation = random_quat(rng), rng.uniform(-0.5, 0.5, 3)
        back = rotate(np.array(rotate(quat, rotation)), -rotation)
        np.testing.assert_allclose(back, quat, atol=1e-12)


def test_turned_quaternions_stay_unit():
    rng = np.random.default_rng(2)
    for _ in range(20):
        turned = rotate(random_quat(rng), rng.uniform(-0.01, 0.01, 3))
        assert np.linalg.norm(turned) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_turn_about_one_axis_is_that_angle(axis):
    rotation = np.zeros(3)
    rotation[axis] = 0.3
    angles = roll_pitch_yaw(rotate(IDENTITY, rotation))
    np.testing.assert_allclose(angles, rotation, atol=1e-12)
