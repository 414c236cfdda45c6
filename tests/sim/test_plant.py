import mujoco
import numpy as np
import pytest

from downbeat.catalog.robot import load_g1
from downbeat.control.observation import RobotState, observe
from downbeat.control.policy import SkillLibrary
from downbeat.lcm_types import g1_low_cmd_t
from downbeat.runtime.clock import SIM_EPOCH_UTIME as T0
from downbeat.sim.errors import SimError
from downbeat.sim.plant import EXPIRED_DAMPING, Plant, PlantConfig

ROBOT = load_g1()


def position_command(utime, **changes):
    msg = g1_low_cmd_t()
    msg.header.utime = utime
    msg.valid_until_utime = utime + 100_000
    msg.mode = g1_low_cmd_t.MODE_POSITION
    msg.joint_pos_target = ROBOT.default_joint_pos.copy()
    msg.joint_vel_target = np.zeros(29)
    msg.joint_torque_ff = np.zeros(29)
    msg.joint_stiffness = ROBOT.joint_stiffness.copy()
    msg.joint_damping = ROBOT.joint_damping.copy()
    for name, value in changes.items():
        setattr(msg, name, value)
    return msg


def run(plant, steps, start=T0, command=position_command):
    """Step and command at 50 Hz; returns the time reached."""
    utime = start
    for _ in range(steps):
        if command is not None and utime % 20_000 == 0:
            plant.command(command(utime), utime)
        plant.step(utime)
        utime += plant.step_us
    return utime


def no_delay(**changes):
    return Plant(PlantConfig(command_delay_us=0, **changes))


def test_the_gantry_holds_the_robot_until_the_first_position_command():
    plant = Plant()
    before = plant.data.qpos.copy()
    damping = position_command(T0, mode=g1_low_cmd_t.MODE_DAMPING)
    plant.command(damping, T0)
    run(plant, 500, command=None)
    np.testing.assert_array_equal(plant.data.qpos, before)
    run(plant, 10, T0 + 1_000_000)
    assert np.any(plant.data.qpos != before)


def test_the_robot_starts_at_rest_with_its_weight_on_its_feet():
    plant = Plant()
    weight = ROBOT.total_mass * 9.81
    assert plant.contact_force().sum() == pytest.approx(weight, rel=0.02)
    _, gyro, accel = plant.imu(0)
    assert not gyro.any()
    assert np.linalg.norm(accel) == pytest.approx(9.81, rel=0.01)
    np.testing.assert_allclose(plant.joint_pos, ROBOT.default_joint_pos, atol=0.005)


def test_being_let_go_does_not_shake_the_robot():
    plant = no_delay()
    # The pose needs torque: without it the knees sag at once, gantry or not.
    plant_torque = plant.joint_torque.copy()
    run(plant, 100, command=lambda utime: position_command(utime, joint_torque_ff=plant_torque))
    assert abs(plant.base_height - Plant().base_height) < 0.002
    assert np.abs(plant.joint_vel).max() < 0.1


def test_torque_limits_hold_for_the_sum_of_all_terms():
    plant = no_delay(start="free")
    far = ROBOT.joint_range[:, 1] + 5.0
    run(
        plant,
        50,
        command=lambda utime: position_command(
            utime, joint_pos_target=far, joint_torque_ff=np.full(29, 500.0)
        ),
    )
    torque = plant.joint_torque
    assert np.all(np.abs(torque) <= ROBOT.effort_limit * (1 + 1e-12))
    assert np.any(np.abs(torque) == ROBOT.effort_limit)


def test_the_motor_law_is_ff_plus_kp_plus_kd():
    plant = no_delay(start="free")
    rng = np.random.default_rng(0)
    target = ROBOT.default_joint_pos + rng.uniform(-0.02, 0.02, 29)
    velocity, feed_forward = rng.uniform(-0.2, 0.2, 29), rng.uniform(-1, 1, 29)
    joint_pos, joint_vel = plant.joint_pos.copy(), plant.joint_vel.copy()
    msg = position_command(
        T0, joint_pos_target=target, joint_vel_target=velocity, joint_torque_ff=feed_forward
    )
    plant.command(msg, T0)
    plant.step(T0)
    expected = (
        feed_forward
        + ROBOT.joint_stiffness * (target - joint_pos)
        + ROBOT.joint_damping * (velocity - joint_vel)
    )
    np.testing.assert_allclose(plant.joint_torque, expected, atol=1e-9)


def test_an_expired_command_ends_in_damping():
    plant = no_delay(start="free")
    plant.command(position_command(T0), T0)
    run(plant, 51, command=None)
    assert plant.mode == g1_low_cmd_t.MODE_DAMPING
    assert plant.counters.expired == 1
    before = plant.joint_vel.copy()
    plant.step(T0 + 51 * 2000)
    np.testing.assert_allclose(plant.joint_torque, -EXPIRED_DAMPING * before, atol=1e-9)


def test_a_fresh_command_ends_the_damping_of_an_expired_one():
    plant = no_delay(start="free")
    plant.command(position_command(T0), T0)
    run(plant, 60, command=None)
    later = T0 + 60 * 2000
    plant.command(position_command(later), later)
    plant.step(later)
    assert plant.mode == g1_low_cmd_t.MODE_POSITION


def test_zero_torque_is_zero_torque():
    plant = no_delay(start="free")
    mode = g1_low_cmd_t.MODE_ZERO_TORQUE
    run(plant, 20, command=lambda utime: position_command(utime, mode=mode))
    assert not plant.joint_torque.any()


def test_the_damping_mode_uses_the_gains_of_the_command():
    plant = no_delay(start="free")
    gains = np.full(29, 3.0)
    mode = g1_low_cmd_t.MODE_DAMPING
    run(plant, 30, command=lambda utime: position_command(utime, mode=mode, joint_damping=gains))
    before = plant.joint_vel.copy()
    plant.step(T0 + 30 * 2000)
    np.testing.assert_allclose(plant.joint_torque, -3.0 * before, atol=1e-9)


@pytest.mark.parametrize(
    "field", ["joint_pos_target", "joint_vel_target", "joint_torque_ff", "joint_stiffness"]
)
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_number_that_is_not_finite_never_reaches_the_physics(field, value):
    plant, twin = no_delay(), no_delay()
    bad = position_command(T0 + 2000)
    getattr(bad, field)[7] = value
    for each in (plant, twin):
        each.command(position_command(T0), T0)
    assert not plant.command(bad, T0 + 2000)
    assert plant.counters.refused == 1
    for each in (plant, twin):
        run(each, 30, command=None)
    np.testing.assert_array_equal(plant.data.qpos, twin.data.qpos)


def test_a_command_from_another_time_base_is_refused():
    plant = Plant()
    assert not plant.command(position_command(T0 + 10_000_000), T0)
    assert not plant.command(position_command(T0 - 10_000_000), T0)


def test_a_command_acts_after_its_delay_and_not_before():
    plant = Plant(PlantConfig(command_delay_us=4_000, start="free"))
    plant.command(position_command(T0), T0)
    modes = []
    for index in range(3):
        plant.step(T0 + index * 2000)
        modes.append(plant.mode)
    assert modes == [g1_low_cmd_t.MODE_ZERO_TORQUE] * 2 + [g1_low_cmd_t.MODE_POSITION]


def test_a_command_that_arrives_within_its_delay_acts_as_if_it_had_come_at_once():
    early, late = (Plant(PlantConfig(command_delay_us=4_000, start="free")) for _ in range(2))
    for index in range(40):
        utime = T0 + index * 2000
        if utime % 20_000 == 0:
            early.command(position_command(utime), utime)
        if utime % 20_000 == 4_000:
            late.command(position_command(utime - 4_000), utime)
        early.step(utime)
        late.step(utime)
    np.testing.assert_array_equal(early.data.qpos, late.data.qpos)


def test_a_passive_fall_is_the_same_at_two_milliseconds_and_at_five():
    """The default pose held by the motors alone sags and tips: 0.6 s of it, from the same state."""
    plants = [no_delay(timestep_s=timestep_s, start="free") for timestep_s in (0.002, 0.005)]
    plants[1].data.qpos[:] = plants[0].data.qpos
    mujoco.mj_step1(plants[1].model, plants[1].data)
    for plant in plants:
        run(plant, round(0.6 / plant.config.timestep_s))
    ends = [plant.data.qpos for plant in plants]
    difference = np.abs(ends[0] - ends[1])
    assert np.abs(ends[0][7:] - ROBOT.default_joint_pos).max() > 0.1  # something happened
    assert difference[7:].max() < 0.01
    assert difference[:3].max() < 0.004


def close_the_loop(plant, skill, seconds):
    """Let a skill control the plant at 50 Hz without noise; returns qpos per tick, (n, 36)."""
    utime, rows = T0, []
    for tick in range(round(seconds / 0.02)):
        quat, gyro, _ = plant.imu(0)
        state = RobotState(
            quat.astype(np.float32),
            gyro.astype(np.float32),
            plant.joint_pos.astype(np.float32),
            plant.joint_vel.astype(np.float32),
        )
        obs = observe(state, skill.manifest.observation_names)
        targets = skill.act(obs, tick * 0.02 % skill.manifest.duration_s, np.zeros(3, np.float32))
        msg = position_command(
            utime,
            joint_pos_target=targets.joint_pos,
            joint_stiffness=targets.joint_stiffness,
            joint_damping=targets.joint_damping,
        )
        plant.command(msg, utime)
        for _ in range(20_000 // plant.step_us):
            plant.step(utime)
            utime += plant.step_us
        rows.append(plant.data.qpos.copy())
    return np.array(rows)


@pytest.mark.parametrize(("name", "rms_rad"), [("stand", 0.002), ("sway", 0.006)])
def test_skills_move_the_same_at_two_milliseconds_and_at_five(name, rms_rad):
    """Built at 5 ms, played at 2 ms: 5 s from the gantry on, without noise.

    Measured over 10 s, RMS of all joints: stand 0.7 mrad, sway 2.9, disco 3.2, boxstep 2.7.
    """
    skill = SkillLibrary.load(only=frozenset({"stand", name}))[name]
    runs = [close_the_loop(no_delay(timestep_s=dt), skill, 5.0) for dt in (0.002, 0.005)]
    for qpos in runs:
        assert qpos[:, 2].min() > 0.7
    difference = runs[0][:, 7:] - runs[1][:, 7:]
    assert np.sqrt(np.mean(difference**2)) < rms_rad


def test_stiff_gains_of_a_command_stay_stable():
    """Ten times the robot's gains: explicit damping would blow up the wrists at 2 ms."""
    plant = no_delay(start="free")
    run(
        plant,
        500,
        command=lambda utime: position_command(
            utime,
            joint_stiffness=10 * ROBOT.joint_stiffness,
            joint_damping=10 * ROBOT.joint_damping,
        ),
    )
    assert not plant.diverged
    assert np.abs(plant.joint_vel[12:]).max() < 20.0


def test_a_wrong_setting_is_answered_with_the_valid_ones():
    with pytest.raises(SimError, match=r"0\.0005 to 0\.005"):
        Plant(PlantConfig(timestep_s=0.02))
    with pytest.raises(SimError, match="command_delay_us"):
        Plant(PlantConfig(command_delay_us=-1))
