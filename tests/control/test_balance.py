"""The fall predictor: its rules, and falls on the plant."""

import json
import math
from dataclasses import replace

import pytest

from downbeat.control.balance import (
    LIMITS,
    FallLimits,
    FallPredictor,
    tilt_and_rate,
)
from downbeat.control.errors import ControlError
from downbeat.control.estimate import NO_ESTIMATE
from downbeat.control.policy import SkillLibrary
from downbeat.sim.fall_prediction import watch
from downbeat.sim.motion_trials import MotionTrial, Push

STANDING = replace(NO_ESTIMATE, base_pos=(0.0, 0.0, 0.75), support_margin=0.08, step_margin=0.08)
LEAVING = replace(STANDING, step_margin=-0.05)
PLANTED = LIMITS["planted"]


@pytest.fixture(scope="module")
def library():
    return SkillLibrary.load(only=frozenset({"stand", "pump", "zombie", "walk"}))


def feed(predictor, estimate, ticks, tilt=0.0, tilt_rate=0.0, limits=PLANTED):
    for _ in range(ticks):
        prediction = predictor.update(estimate, tilt, tilt_rate, limits)
    return prediction


def test_one_tick_outside_is_not_a_fall_two_are():
    predictor = FallPredictor()
    assert not feed(predictor, STANDING, 10).is_falling
    assert not feed(predictor, LEAVING, 1).is_falling
    assert not feed(predictor, STANDING, 1).is_falling
    assert not feed(predictor, LEAVING, 1).is_falling
    prediction = feed(predictor, LEAVING, 1)
    assert (prediction.is_falling, prediction.cause, prediction.value) == (
        True,
        "capture_point",
        -0.05,
    )


def test_a_fall_is_over_after_half_a_second_within_all_limits():
    predictor = FallPredictor()
    feed(predictor, LEAVING, 2)
    assert feed(predictor, STANDING, 24).is_falling
    assert not feed(predictor, STANDING, 1).is_falling


def test_a_growing_tilt_and_a_sinking_pelvis_are_falls_too():
    assert not feed(FallPredictor(), STANDING, 2, tilt=0.3, tilt_rate=0.5).is_falling
    assert feed(FallPredictor(), STANDING, 2, tilt=0.3, tilt_rate=2.0).cause == "tilt"
    assert not feed(FallPredictor(), STANDING, 2, tilt=0.5, tilt_rate=-2.0).is_falling
    low = replace(STANDING, base_pos=(0.0, 0.0, 0.45))
    assert feed(FallPredictor(), low, 2).cause == "height"


def test_what_is_not_known_neither_raises_nor_clears():
    predictor = FallPredictor()
    assert not feed(predictor, NO_ESTIMATE, 50, tilt=math.nan, tilt_rate=math.nan).is_falling
    feed(predictor, LEAVING, 2)
    assert feed(predictor, NO_ESTIMATE, 50).is_falling


def test_a_margin_that_is_not_watched_calls_no_fall():
    unwatched = FallLimits(step_margin_m=-math.inf, base_height_m=0.0)
    gone = replace(LEAVING, step_margin=-3.0, base_pos=(0.0, 0.0, 0.2))
    assert not feed(FallPredictor(), gone, 10, limits=unwatched).is_falling


def test_state_survives_json_and_reset_forgets_it():
    predictor, restored = FallPredictor(), FallPredictor()
    feed(predictor, LEAVING, 1)
    restored.from_state(json.loads(json.dumps(predictor.to_state())))
    assert feed(restored, LEAVING, 1).is_falling
    restored.reset()
    assert not feed(restored, LEAVING, 1).is_falling
    with pytest.raises(ControlError, match="beyond_ticks"):
        restored.from_state({"is_falling": True})


@pytest.mark.parametrize("axis", [1, 2])
@pytest.mark.parametrize("lean", [0.3, -0.3])
def test_tilt_rate_is_the_derivative_of_tilt(axis, lean):
    def quat(angle):
        values = [math.cos(0.5 * angle), 0.0, 0.0, 0.0]
        values[axis] = math.sin(0.5 * angle)
        return values

    gyro = [0.0, 0.0, 0.7]
    gyro[axis - 1] = 0.5
    tilt, rate = tilt_and_rate(quat(lean), gyro)
    later, _ = tilt_and_rate(quat(lean + 0.5e-6), gyro)
    assert tilt == pytest.approx(0.3)
    assert rate == pytest.approx((later - tilt) / 1e-6, abs=1e-3)


@pytest.mark.parametrize("skill", ["stand", "pump", "zombie", "walk"])
def test_undisturbed_skills_raise_no_alarm(library, skill):
    heavy = MotionTrial(skill, 6.0, mass_scale=1.1, friction=0.54, velocity=(0.25, 0.0, 0.0))
    outcome = watch(library, heavy)
    assert outcome.fell_s is None
    assert outcome.alarm_s is None
    assert min(outcome.step_margins) > LIMITS[outcome.kind].step_margin_m + 0.03


@pytest.mark.parametrize("skill", ["stand", "pump", "zombie", "walk"])
@pytest.mark.parametrize("direction_rad", [0.0, math.pi / 2, math.pi, -math.pi / 4])
def test_a_fall_is_predicted_before_it_happens(library, skill, direction_rad):
    push = Push(25.0, direction_rad, 3.0)
    outcome = watch(library, MotionTrial(skill, 6.0, push=push))
    assert outcome.fell_s is not None
    assert outcome.alarm_s is not None
    assert push.start_s < outcome.alarm_s <= outcome.fell_s - 0.15


def test_a_push_that_is_borne_raises_no_alarm(library):
    outcome = watch(library, MotionTrial("stand", 6.0, push=Push(5.0, 1.0, 3.0)))
    assert outcome.fell_s is None and outcome.alarm_s is None
