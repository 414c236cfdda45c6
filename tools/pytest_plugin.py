"""Pytest fixtures for people who test their own skills and shows with simulated traffic.

pytest_plugins = ["downbeat.tools.pytest_plugin"]

def test_cable_is_pulled(traffic):
assert traffic("my_scenario.toml").problems == []
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from downbeat.control.policy import SkillLibrary
from downbeat.tools.scenario import Scenario, load_scenario
from downbeat.tools.traffic import Outcome, run_scenario

Traffic = Callable[[Scenario | Path | str], Outcome]


@pytest.fixture(scope="session")
def skill_libraries() -> dict[frozenset[str], SkillLibrary]:
    """Libraries by the skills they hold: a skill is loaded once per session."""
    return {}


@pytest.fixture
def traffic(skill_libraries: dict[frozenset[str], SkillLibrary]) -> Traffic:
    """Play a scenario (an object or a file) in lockstep; returns what happened."""

    def play(scenario: Scenario | Path | str) -> Outcome:
        chosen = scenario if isinstance(scenario, Scenario) else load_scenario(Path(scenario))
        names = chosen.needed_skills
        if names not in skill_libraries:
            skill_libraries[names] = SkillLibrary.load(only=names)
        return run_scenario(chosen, skill_libraries[names])

    return play
