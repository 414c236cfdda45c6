"""Every scenario file: what it says goes wrong goes wrong, and what it expects happens."""

from dataclasses import replace
from pathlib import Path

import pytest

from downbeat.runtime.errors import DownbeatError
from downbeat.runtime.traffic import Impairment
from downbeat.tools.scenario import Ask, Expectation, Scenario, load_scenario

FILES = sorted(Path(__file__).parent.glob("*.toml"))


def test_there_are_at_least_thirty_scenarios():
    assert len(FILES) >= 30


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_scenario_ends_as_expected(path, traffic):
    assert traffic(path).problems == []


def test_same_scenario_gives_the_same_records_twice(traffic):
    path = Path(__file__).with_name("everything_at_once.toml")
    assert traffic(path).records == traffic(path).records


def test_other_seed_gives_another_run(traffic):
    scenario = load_scenario(Path(__file__).with_name("everything_at_once.toml"))
    assert traffic(scenario).records != traffic(replace(scenario, seed=1)).records


def test_expectation_that_does_not_hold_is_named(traffic):
    scenario = Scenario(
        "Nothing happens.",
        2.0,
        ask=(Ask(1.2, "kpop"),),
        expect=(
            Expectation(after_s=1.5, until_s=2.0, mode="DAMPING"),
            Expectation(after_s=1.9, skill="wave"),
            Expectation(request=1, state="REFUSED"),
            Expectation(rejected_min=1),
        ),
    )
    problems = traffic(scenario).problems
    assert len(problems) == 4
    assert "mode DAMPING does not hold at 1.5" in problems[0]
    assert "skill wave is not reached" in problems[1]
    assert "Request 1 never was REFUSED" in problems[2]
    assert "Only 0 messages were rejected" in problems[3]


def test_commands_that_change_are_noticed(traffic):
    scenario = Scenario(
        "States are late.",
        3.0,
        ask=(Ask(1.2, "kpop"),),
        impair=(Impairment("G1_LOW_STATE", 2.0, delay_ms=12.0),),
        commands_unchanged=True,
    )
    (problem,) = traffic(scenario).problems
    assert "differs from the undisturbed run" in problem


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ('sentence = "A."\nseconds = 2.0\n', "expect is missing"),
        ('sentence = "A"\nseconds = 2.0\ncommands_unchanged = true\n', "full stop"),
        ('sentence = "A."\nseconds = -1.0\ncommands_unchanged = true\n', "more than 0"),
        ('sentence = "A."\nseconds = 2.0\nspeed = 3\n', "known are ask"),
        ('sentence = "A."\nseconds = 2.0\n[[expect]]\nafter_s = 5.0\n', "ends at 2 s"),
        ('sentence = "A."\nseconds = 2.0\n[[impair]]\nchanel = "X"\n', "known are channel"),
        ("sentence = ", "not TOML"),
    ],
)
def test_wrong_scenario_is_refused_in_one_sentence(tmp_path, text, reason):
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    with pytest.raises(DownbeatError, match=reason) as caught:
        load_scenario(path)
    assert "wrong.toml" in str(caught.value)
