"""Fixtures of the control tests."""

import pytest
from control_rig import Rig

from downbeat.control.policy import SkillLibrary

SKILLS = ("stand", "kpop", "thriller", "discostep", "zombie", "walk", "wave")


@pytest.fixture(scope="session")
def library():
    return SkillLibrary.load(only=frozenset(SKILLS))


@pytest.fixture
def rig(library):
    made = Rig(library)
    made.run(0.2)
    return made
