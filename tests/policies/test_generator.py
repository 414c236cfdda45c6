from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from downbeat.policies.errors import SkillRejected
from downbeat.policies.generator import build as builder
from downbeat.policies.generator import checks, feedback
from downbeat.policies.generator.choreography import ArmKeys, Choreography, Offset, Wave
from downbeat.policies.generator.dances_planted import MONKEY, PUMP
from downbeat.policies.generator.dances_stepping import DISCOSTEP
from downbeat.policies.generator.model import BodyModel
from downbeat.policies.generator.reference import Reference, build_reference


@pytest.fixture(scope="module")
def body() -> BodyModel:
    return BodyModel()


@pytest.fixture(scope="module")
def monkey(body: BodyModel) -> Reference:
    return build_reference(body, builder.make_motion(MONKEY))


@pytest.fixture(scope="module")
def discostep(body: BodyModel) -> Reference:
    return build_reference(body, builder.make_motion(DISCOSTEP))


def feet(body: BodyModel, reference: Reference) -> np.ndarray:
    """Foot positions (N, 2, 3) [m] by forward kinematics."""
    places = []
    for qpos in reference.qpos:
        body.set_pose(qpos)
        places.append(body.data.xpos[list(body.foot_bodies)].copy())
    return np.array(places)


def test_planted_feet_do_not_move_in_the_reference(body: BodyModel, monkey: Reference) -> None:
    places = feet(body, monkey)
    assert np.ptp(places, axis=0).max() < 1e-6


def test_stepping_feet_follow_the_plan(body: BodyModel, discostep: Reference) -> None:
    plan = builder.make_motion(DISCOSTEP).feet
    np.testing.assert_allclose(feet(body, discostep), plan.pos, atol=1e-6)


def test_the_zero_moment_point_of_a_planted_dance_stays_in_its_window(monkey: Reference) -> None:
    half_x, half_y = builder.ZMP_WINDOWS[0]
    assert np.abs(monkey.zmp[:, 0] - 0.035).max() < half_x + 0.005
    assert np.abs(monkey.zmp[:, 1]).max() < half_y + 0.005


def test_the_zero_moment_point_of_footwork_follows_the_plan(discostep: Reference) -> None:
    plan = builder.make_motion(DISCOSTEP).feet
    assert np.abs(discostep.zmp - plan.zmp).max() < 0.01


def test_foot_forces_carry_the_robot(body: BodyModel, monkey: Reference) -> None:
    weight = body.robot.total_mass * 9.81
    mean = monkey.foot_force.sum(axis=1).mean()
    assert mean == pytest.approx(weight, rel=0.01)


def test_the_reference_holds_for_any_tempo_with_an_exact_loop() -> None:
    dance = builder.choreography("monkey", 127.0)
    motion = builder.make_motion(dance)
    assert motion.tick_s * builder.tick_count(dance) == pytest.approx(4 * 60.0 / 127.0)


def test_the_feedback_ignores_a_shift_and_a_turn_of_the_world(
    body: BodyModel, monkey: Reference
) -> None:
    qpos = monkey.qpos[0].copy()
    before = feedback.observation_map(body, qpos, 0.5)
    qpos[:2] += 3.0
    np.testing.assert_allclose(feedback.observation_map(body, qpos, 0.5), before, atol=1e-9)


def test_an_observed_lean_maps_to_the_base_rotation_that_caused_it(body: BodyModel) -> None:
    """Lean about the planted feet: the map must find base rotation and base shift."""
    dance = builder.choreography("stand")
    qpos = build_reference(body, builder.make_motion(dance)).qpos[0]
    body.set_pose(qpos)
    foot = 0.5 * (body.foot_jacobian(0) + body.foot_jacobian(1))
    lean = np.zeros(35)
    lean[4] = 0.01  # pitch [rad]
    lean[:3] = -np.linalg.solve(foot[:3, :3], foot[:3, 3:6] @ lean[3:6])
    gravity = np.array([0.0, 0.0, -1.0])
    error = np.zeros(64)
    error[:3] = np.cross(gravity, lean[3:6])
    found = feedback.observation_map(body, qpos, 0.5) @ error
    np.testing.assert_allclose(found[:35], lean, atol=1e-9)


def test_self_contact_is_rejected_with_the_links_and_the_tick(body: BodyModel) -> None:
    arms = ArmKeys(((0.0, (-2.3, 0.35, 0.0, 0.9), (-2.3, 0.35, 0.0, 0.9)),), 1.0)
    clap = replace(PUMP, name="clap", arms=arms)
    with pytest.raises(SkillRejected, match="'clap' is rejected: left_wrist.* touches right_wrist"):
        builder.build_once(clap, 1.0, builder.ZMP_WINDOWS[0], body)


def test_a_joint_at_its_limit_is_rejected_with_both_numbers(body: BodyModel) -> None:
    dance = Choreography("bow", "Bow", 1, moves=(Offset("waist_pitch", 0.5),))
    with pytest.raises(SkillRejected, match="waist_pitch_joint comes within 0.0.* at least 0.04"):
        builder.build_once(dance, 1.0, builder.ZMP_WINDOWS[0], body)


def test_unreachable_feet_are_rejected(body: BodyModel) -> None:
    dance = Choreography("jump", "Jump", 1, height=1.0)
    with pytest.raises(SkillRejected, match="cannot reach the feet"):
        builder.build_once(dance, 1.0, builder.ZMP_WINDOWS[0], body)


def test_a_violent_motion_is_rejected_for_its_torque(body: BodyModel) -> None:
    dance = Choreography("shake", "Shake", 1, moves=(Wave("waist_yaw", 1.0, 1.0),))
    with pytest.raises(SkillRejected, match="needs .* of its torque at tick"):
        builder.build_once(dance, 1.0, builder.ZMP_WINDOWS[0], body)


def test_large_gains_are_rejected() -> None:
    gains = feedback.Feedback(np.full((2, 29, 64), 25.0), np.zeros((2, 64)))
    with pytest.raises(SkillRejected, match="gain reaches 25.0 at tick 0, above 20"):
        checks.check_gain("x", gains)


def test_a_rejected_dance_is_tried_again_smaller(
    body: BodyModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = []

    def refuse(dance: Choreography, amplitude: float, window: object, _: BodyModel) -> None:
        tried.append((amplitude, window))
        raise SkillRejected(f"attempt {len(tried)}")

    monkeypatch.setattr(builder, "build_once", refuse)
    with pytest.raises(SkillRejected, match="attempt 1$"):
        builder.build(MONKEY, body)
    assert tried[:4] == [(1.0, w) for w in builder.ZMP_WINDOWS] + [(0.85, builder.ZMP_WINDOWS[0])]


def test_the_stand_is_built_again_bit_for_bit(body: BodyModel, tmp_path: Path) -> None:
    first = builder.generate("stand", None, tmp_path / "a", body)
    second = builder.generate("stand", None, tmp_path / "b", BodyModel())
    assert first.sha256 == second.sha256
    assert first.kind == "planted" and first.bpm == 0.0


def test_a_dance_generated_for_another_tempo_says_so(body: BodyModel, tmp_path: Path) -> None:
    manifest = builder.generate("monkey", 110.0, tmp_path, body)
    assert manifest.bpm == 110.0
    assert manifest.duration_s == pytest.approx(4 * 60.0 / 110.0)
    assert manifest.tempo_range_bpm[0] < 110.0 < manifest.tempo_range_bpm[1]
