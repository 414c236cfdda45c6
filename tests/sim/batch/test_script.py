"""A script is what control's director plays: phases and weights, tick by tick."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from downbeat.control.atlas import Atlas, Cell
from downbeat.control.director import Director
from downbeat.control.modes import BY_NAME, modes_between
from downbeat.control.observation import RobotState
from downbeat.control.phase import TICK_US
from downbeat.control.prover import ProofConfig
from downbeat.control.slots import entry_slots, exit_slots
from downbeat.lcm_types import skill_request_t
from downbeat.policies.manifest import load_skills
from downbeat.sim.batch.cells import change_script
from downbeat.sim.batch.rehearsal import SilentLibrary
from downbeat.sim.batch.script import Switch, blend_weights, script_of
from downbeat.sim.batch.states import LEAD_TICKS

SKILLS = load_skills()
BEGIN = 1_700_000_000_000_000
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0], np.float32)
STATE = RobotState(UPRIGHT, *(np.zeros(width, np.float32) for width in (3, 29, 29)))
PAIRS = (
    ("kpop", "thriller"),
    ("sway", "boxstep"),
    ("boxstep", "kpop"),
    ("discostep", "zombie"),
    ("stand", "walk"),
    ("thriller", "wave"),
    ("zombie", "stand"),
)
CASES = [
    (a, b, mode.name) for a, b in PAIRS for mode in modes_between(SKILLS[a], SKILLS[b])
]  # fmt: skip
AFTER = 120


class Played:
    """A director on its own, and what it plays in every tick."""

    def __init__(self, cells):
        library = SilentLibrary(SKILLS)
        proof = ProofConfig(unchecked=0.01)
        self.director = Director(library, atlas=Atlas(cells), proof=proof)
        self.now, self.number, self.asked, self.rows = BEGIN, 0, 0, []
        self.director.start(STATE, self.now)

    def ask(self, skill, onset_utime, rate):
        msg = skill_request_t()
        self.asked += 1
        msg.request_id = self.asked
        msg.skill, msg.start_utime, msg.phase_rate = skill, onset_utime, rate
        msg.source = skill_request_t.SOURCE_MUSIC
        self.director.receive(msg, self.now, self.number, False)

    def run(self, ticks):
        for _ in range(ticks):
            self.director.update(STATE, self.now)
            self.rows.append(self.note())
            self.director.play(STATE, self.now)
            self.director.end_tick(self.now)
            self.now += TICK_US
            self.number += 1

    def note(self):
        """Skill -> phase [s], weight of the legs, weight of the rest."""
        new, blend = self.director.playback, self.director.blend
        if blend is None:
            return {new.name: (new.follower.wrapped_s, 1.0, 1.0)}
        rest = legs = blend.weight
        if blend.hop.style == "legs_hard":
            legs = float(blend.tick >= blend.hop.blend_ticks // 2)
        old = blend.outgoing
        return {
            old.name: (old.follower.wrapped_s, 1.0 - legs, 1.0 - rest),
            new.name: (new.follower.wrapped_s, legs, rest),
        }


def change(a, b, mode, rate_a=1.0, rate_b=1.0):
    """Let a director change from a to b; return what it played and the tick of the onset."""
    shape = (exit_slots(SKILLS[a]).count, entry_slots(SKILLS[b]).count)
    played = Played([Cell(a, b, mode, np.full(shape, 0.001, np.float32), 384, 0)])
    begin = played.now + 100 * TICK_US
    if a != "stand":
        played.ask(a, begin, rate_a)
    # In the middle of an exit slot, a while after the source has begun.
    width = exit_slots(SKILLS[a]).width_s or 0.5
    onset = begin + round(math.ceil(1.5 / width) * width / rate_a * 1e6 / TICK_US) * TICK_US
    played.ask(b, onset, rate_b)
    played.run((onset - played.now) // TICK_US + AFTER)
    return played, (onset - BEGIN) // TICK_US


@pytest.mark.parametrize(("a", "b", "mode"), CASES)
@pytest.mark.parametrize("rates", [(1.0, 1.0), (1.15, 0.9)])
def test_a_change_in_a_script_is_the_change_that_control_makes(a, b, mode, rates):
    rate_a = rates[0] if SKILLS[a].bpm else 1.0
    rate_b = rates[1] if SKILLS[b].bpm else 1.0
    played, onset = change(a, b, mode, rate_a, rate_b)
    style = BY_NAME[mode]
    near = range(onset - 10, onset + 10)
    middle = next(t for t in near if b in played.rows[t] and played.rows[t][b][2] >= 0.5)
    assert abs(middle - onset) <= 2  # a proven slot may cost two ticks
    exit_s = np.array([played.rows[middle - 1][a][0] + rate_a * 0.02])
    entry_s = np.array([played.rows[middle][b][0]])
    script = change_script(
        SKILLS[a], SKILLS[b], style, exit_s, np.array([rate_a]), entry_s, np.array([rate_b]),
        horizon_s=1.0,
    )  # fmt: skip
    assert script.skills == (a, b)
    assert script.start_tick == (-1, LEAD_TICKS - style.blend_ticks // 2)
    for tick in range(script.ticks):
        row = played.rows[middle - LEAD_TICKS + tick]
        assert {script.skills[i] for i in script.playing(tick)} == set(row)
        for index in script.playing(tick):
            phase, legs, rest = row[script.skills[index]]
            length = SKILLS[script.skills[index]].duration_s
            off = abs(script.phase_s[tick, index, 0] - phase)
            assert min(off, abs(length - off)) < 1e-6
            assert script.weight[tick, index] == pytest.approx([legs, rest], abs=1e-6)


@given(ticks=st.integers(0, 40), style=st.sampled_from(["full", "legs_hard"]))
def test_a_blend_passes_one_half_in_its_middle_and_never_goes_back(ticks, style):
    weights = np.array([blend_weights(ticks, style, tick) for tick in range(ticks + 2)])
    assert (np.diff(weights, axis=0) >= 0.0).all()
    assert (weights[ticks:] == 1.0).all()
    assert (weights[ticks // 2] >= 0.5 - 1e-6).all()
    if ticks // 2:
        assert (weights[ticks // 2 - 1] < 0.5).all()


@given(
    phase=st.floats(0.0, 20.0), rate=st.floats(0.7, 1.3), blend=st.integers(0, 30),
    a=st.sampled_from(sorted(SKILLS)), b=st.sampled_from(sorted(SKILLS)),
)  # fmt: skip
def test_weights_sum_to_one_and_phases_stay_inside_their_skill(phase, rate, blend, a, b):
    switch = Switch(SKILLS[b], 10, blend, "full", np.array([phase]), np.array([rate]))
    script = script_of(SKILLS[a], np.array([phase]), np.array([rate]), (switch,), 60)
    assert np.allclose(script.weight.sum(axis=1), 1.0, atol=1e-6)
    for index, name in enumerate((a, b)):
        assert (script.phase_s[:, index] >= 0.0).all()
        assert (script.phase_s[:, index] <= SKILLS[name].duration_s).all()
    assert [t for t in range(60) if 1 in script.playing(t)][0] == 10


def test_the_script_of_some_robots_is_their_part_of_the_script_of_all():
    rng = np.random.default_rng(0)
    phase, rate = rng.uniform(0.0, 4.0, 6), rng.uniform(0.8, 1.2, 6)
    switch = Switch(SKILLS["sway"], 5, 15, "full", phase, rate)
    whole = script_of(SKILLS["kpop"], phase, rate, (switch,), 40)
    ids = np.array([4, 1])
    part = Switch(SKILLS["sway"], 5, 15, "full", phase[ids], rate[ids])
    alone = script_of(SKILLS["kpop"], phase[ids], rate[ids], (part,), 40)
    assert np.array_equal(whole.take(ids).phase_s, alone.phase_s)
