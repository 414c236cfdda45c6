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
def test_scenario_ends_as_expected(path, traffic, request):
    scenario = load_scenario(path)
    if scenario.pending:
        request.applymarker(pytest.mark.xfail(reason=scenario.pending, strict=False))
    assert traffic(scenario).problems == []


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


HEAD = 'sentence = "A."\nseconds = 2.0\n'
UNCHANGED = HEAD + "commands_unchanged = true\n"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (HEAD, "expect is missing"),
        ('sentence = "A"\nseconds = 2.0\ncommands_unchanged = true\n', "full stop"),
        ('sentence = "A."\nseconds = -1.0\ncommands_unchanged = true\n', "more than 0"),
        ('sentence = "A."\nseconds = nan\ncommands_unchanged = true\n', "more than 0"),
        (HEAD + "speed = 3\n", "known are ask"),
        (HEAD + "[[expect]]\nafter_s = 5.0\n", r"expect\[0\].*ends at 2 s"),
        (HEAD + "[[expect]]\nafter_s = 1.0\n", "Nothing is expected"),
        (HEAD + '[[expect]]\nafter_s = 1.0\nuntil_s = 0.5\nskill = "x"\n', "before it starts"),
        (HEAD + '[[expect]]\nfault = "flood"\n', "faults are action_range"),
        (HEAD + '[[expect]]\nrequest = 1\nstate = "GONE"\n', "states are ABORTED"),
        (HEAD + "[[expect]]\nrequest = 1\n", "belong together"),
        (HEAD + '[[expect]]\nmode = "DANCE"\n', "valid is one of"),
        (UNCHANGED + '[[impair]]\nchanel = "X"\n', "known are channel"),
        (UNCHANGED + '[[impair]]\nchannel = "X"\n', r"impair\[0\].*not in the channel table"),
        (UNCHANGED + '[[impair]]\nchannel = "ESTOP"\ndrop = 2.0\n', "drop is 2; valid are 0 to 1"),
        (UNCHANGED + '[[impair]]\nchannel = "ESTOP"\ndelay_ms = nan\n', "delay_ms is nan"),
        (UNCHANGED + '[[impair]]\nchannel = "ESTOP"\nhold = true\n', "hold needs to_s"),
        (
            UNCHANGED + '[[impair]]\nchannel = "G1_LOW_STATE"\nset_fields = {joint_pso = 1.0}\n',
            "no field 'joint_pso'; g1_low_state_t has .*joint_pos",
        ),
        (
            UNCHANGED
            + '[[impair]]\nchannel = "G1_LOW_STATE"\nset_fields = {"joint_pos[29]" = 1}\n',
            "29 elements",
        ),
        (
            UNCHANGED + '[[inject]]\nchannel = "ESTOP"\nat_s = 1.0\nrate_hz = 9000.0\n',
            r"inject\[0\].*rate_hz is 9000",
        ),
        (UNCHANGED + '[[inject]]\nchannel = "ESTOP"\nat_s = 3.0\n', "begins at 3 s"),
        (UNCHANGED + '[[ask]]\nat_s = 1.0\nfields = {velocity = "fast"}\n', r"ask\[0\].*velocity"),
        (UNCHANGED + "[[push]]\nat_s = 1.0\nimpulse_n_s = inf\n", "not finite"),
        ("sentence = ", "not TOML"),
    ],
)
def test_wrong_scenario_is_refused_in_one_sentence(tmp_path, text, reason):
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    with pytest.raises(DownbeatError, match=reason) as caught:
        load_scenario(path)
    assert "wrong.toml" in str(caught.value)


def test_unknown_skill_is_named_with_the_known_ones(traffic):
    scenario = Scenario("A.", 2.0, ask=(Ask(1.0, "moonwalk"),), commands_unchanged=True)
    with pytest.raises(DownbeatError, match="'moonwalk' is unknown; skills are stand"):
        traffic(scenario)
