"""Switches are bumpless: targets, gains and memories change as one."""

import numpy as np
import pytest

from downbeat.control.policy import SkillLibrary
from downbeat.sim.motion_trials import MotionTrial, play
from downbeat.sim.switch_trials import own_jump, switch

NAMES = ("stand", "kpop", "discostep", "walk", "wave")


@pytest.fixture(scope="module")
def library():
    return SkillLibrary.load(only=frozenset(NAMES))


@pytest.fixture(scope="module")
def own(library):
    return {name: own_jump(library, name) for name in NAMES}


@pytest.mark.parametrize(
    ("before", "after"),
    [("kpop", "wave"), ("kpop", "discostep"), ("discostep", "kpop"), ("walk", "kpop")],
)
def test_targets_jump_at_a_switch_no_more_than_twice_as_far_as_within_a_skill(
    library, own, before, after
):
    result = switch(library, before, after, own)
    assert not result.fell
    assert np.isfinite(result.onset_s)
    assert result.ratio <= 2.0, result


def test_target_jump_is_what_the_commands_say(library):
    """The reported jump is that of the messages, tick by tick."""
    before = None
    for sample in play(library, MotionTrial("kpop", 3.0)):
        assert sample.status.target_jump >= 0.0
        if before is not None and sample.status.skill == "kpop":
            assert sample.status.target_jump < 1.0
        before = sample
