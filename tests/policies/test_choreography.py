from __future__ import annotations

import numpy as np
import pytest

from downbeat.policies.errors import PolicyError
from downbeat.policies.generator.arms import MIRROR, POSES, left_arm, right_arm
from downbeat.policies.generator.build import CHOREOGRAPHIES, choreography
from downbeat.policies.generator.choreography import (
    HOLD,
    LEFT_ARM,
    ArmKeys,
    Choreography,
    Keys,
    Step,
    Wave,
    sample,
    sample_keys,
)
from downbeat.policies.generator.dances_stepping import STEPPING_DANCES
from downbeat.policies.generator.footsteps import (
    FOOT_FRAME_HEIGHT_M,
    StepStyle,
    dance_plan,
    home,
    walk_footfalls,
)

NEARLY_ONE_LOOP = 1e-6


@pytest.mark.parametrize("name", POSES)
def test_right_arm_poses_mirror_the_left(name: str) -> None:
    np.testing.assert_array_equal(right_arm(name), MIRROR * left_arm(name))


def test_mirrored_hands_are_mirrored_in_space() -> None:
    from downbeat.policies.generator.model import BodyModel

    body = BodyModel()
    hands = [body.model.body(f"{side}_wrist_yaw_link").id for side in ("left", "right")]
    qpos = np.zeros(36)
    qpos[3] = 1.0
    for pose in POSES:
        qpos[22:29], qpos[29:36] = left_arm(pose), right_arm(pose)
        body.set_pose(qpos)
        left, right = body.data.xpos[hands]
        np.testing.assert_allclose(left * [1.0, -1.0, 1.0], right, atol=2e-4)


def test_an_unknown_pose_lists_the_known_ones() -> None:
    with pytest.raises(PolicyError, match="'handstand' is unknown; poses are across, bent"):
        left_arm("handstand")


@pytest.mark.parametrize("name", CHOREOGRAPHIES)
def test_every_choreography_closes_its_loop(name: str) -> None:
    dance = CHOREOGRAPHIES[name]
    ends = np.array([0.0, dance.beats - NEARLY_ONE_LOOP])
    motion = sample(dance, ends)
    for part in (motion.pelvis_pos, motion.pelvis_rpy, motion.upper_joint_pos):
        np.testing.assert_allclose(part[0], part[1], atol=1e-4)


def test_keyframes_are_reached_on_their_beat_and_held_until_the_next_move() -> None:
    keys = [(1.0, np.array([1.0])), (3.0, np.array([-1.0]))]
    beat = np.array([1.0, 2.4, 3.0, 0.4])
    values = sample_keys(beat, 4.0, keys, move_beats=0.5)[:, 0]
    np.testing.assert_allclose(values, [1.0, 1.0, -1.0, -1.0])


def test_a_move_longer_than_the_gap_fills_the_gap() -> None:
    keys = [(0.0, np.array([0.0])), (1.0, np.array([1.0]))]
    values = sample_keys(np.array([0.5]), 2.0, keys, move_beats=5.0)
    np.testing.assert_allclose(values, 0.5)


def test_arm_poses_stand_on_their_beat() -> None:
    dance = Choreography("x", "X", 4, arms=ArmKeys(((0.0, "t", "hip"), (2.0, "hip", "t")), 1.0))
    motion = sample(dance, np.array([0.0, 2.0]))
    np.testing.assert_allclose(motion.upper_joint_pos[0, LEFT_ARM], left_arm("t"))
    np.testing.assert_allclose(motion.upper_joint_pos[1, LEFT_ARM], left_arm("hip"))


def test_amplitude_scales_waves_and_keys_but_not_arm_poses() -> None:
    dance = Choreography(
        "x",
        "X",
        4,
        arms=ArmKeys(((0.0, "t", "t"),), 1.0),
        moves=(Wave("pelvis_y", 0.1, 4.0), Keys("waist_yaw", ((1.0, 0.4), (3.0, 0.0)), 1.0)),
    )
    whole, half = (sample(dance, np.array([1.0]), size) for size in (1.0, 0.5))
    assert half.pelvis_pos[0, 1] == pytest.approx(whole.pelvis_pos[0, 1] / 2.0)
    assert half.upper_joint_pos[0, 0] == pytest.approx(0.2)
    np.testing.assert_array_equal(
        half.upper_joint_pos[0, LEFT_ARM], whole.upper_joint_pos[0, LEFT_ARM]
    )


def test_an_unknown_channel_names_the_dance_and_the_channels() -> None:
    with pytest.raises(PolicyError, match="'tail' of dance 'x' is unknown; channels are left_"):
        Choreography("x", "X", 4, moves=(Wave("tail", 1.0, 1.0),))


def test_footwork_needs_one_step_per_beat() -> None:
    with pytest.raises(PolicyError, match="1 steps for 4 beats"):
        Choreography("x", "X", 4, steps=(HOLD,))


def test_a_gesture_refuses_a_tempo_and_a_dance_an_absurd_one() -> None:
    with pytest.raises(PolicyError, match="gesture without a beat"):
        choreography("talk", 120.0)
    with pytest.raises(PolicyError, match="500 BPM is no tempo"):
        choreography("kpop", 500.0)
    with pytest.raises(PolicyError, match="'polka' is unknown; skills are"):
        choreography("polka")


@pytest.mark.parametrize("name", STEPPING_DANCES)
def test_footwork_starts_a_loop_with_both_feet_down_at_home(name: str) -> None:
    plan = dance_plan(STEPPING_DANCES[name].steps, 200, 1.0, StepStyle())
    for side in range(2):
        np.testing.assert_allclose(plan.pos[0, side, :2], home(side)[:2], atol=1e-9)
    np.testing.assert_allclose(plan.pos[0, :, 2], FOOT_FRAME_HEIGHT_M)
    np.testing.assert_allclose(plan.yaw[0], 0.0, atol=1e-9)


@pytest.mark.parametrize("name", STEPPING_DANCES)
def test_one_foot_at_most_is_off_the_floor_and_a_standing_foot_does_not_move(name: str) -> None:
    plan = dance_plan(STEPPING_DANCES[name].steps, 200, 1.0, StepStyle())
    lifted = plan.pos[:, :, 2] > FOOT_FRAME_HEIGHT_M + 1e-9  # (N, 2)
    assert not lifted.all(axis=1).any()
    moved = np.linalg.norm(np.diff(plan.pos[:, :, :2], axis=0), axis=2)  # (N - 1, 2)
    standing = ~lifted[1:] & ~lifted[:-1]
    assert moved[standing].max() < 1e-9


def test_a_swing_foot_lands_where_it_was_sent_at_the_end_of_its_beat() -> None:
    steps = (Step("right", y=-0.1), Step("right"), HOLD, HOLD)
    plan = dance_plan(steps, 100, 1.0, StepStyle())
    np.testing.assert_allclose(plan.pos[25, 1, :2], home(1)[:2] + [0.0, -0.1], atol=1e-3)


def test_the_weight_is_on_the_stance_foot_while_the_other_swings() -> None:
    plan = dance_plan((Step("left"), Step("right")), 50, 1.0, StepStyle())
    lifted = plan.pos[:, :, 2] > FOOT_FRAME_HEIGHT_M + 1e-3
    assert (plan.left_weight[lifted[:, 0]] == 0.0).all()
    assert (plan.left_weight[lifted[:, 1]] == 1.0).all()


def test_a_turning_walk_turns_the_body_by_rate_times_time() -> None:
    _, bodies = walk_footfalls(np.array([0.2, 0.0, 0.3]), 0.5, 4)
    assert bodies[-1][2] == pytest.approx(0.6)
