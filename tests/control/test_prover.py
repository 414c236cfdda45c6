"""Nothing is switched that was not proven, and nothing waits for a proof that does not come."""

import numpy as np
import pytest
from proof_rig import ProofRig, atlas_of, verdict

from downbeat.control.core import ControlCore, CoreConfig, TickInput
from downbeat.control.policy import SkillLibrary
from downbeat.control.prover import ProofConfig
from downbeat.lcm_types import skill_status_t as status
from downbeat.lcm_types import transition_query_t

PAIR = ("kpop", "disco")
STEPS = ("discostep", "salsa")


@pytest.fixture(scope="module")
def library():
    return SkillLibrary.load(only=frozenset({"stand", "kpop", "disco", "discostep", "salsa"}))


def dance(library, atlas, answer=0, pair=PAIR, ahead_s=5.0, **options):
    """Dance the first skill, then ask for the second; return the rig and the wanted onset."""
    rig = ProofRig(library, atlas, answer, **options)
    rig.run(3.0)
    rig.tick([rig.request(pair[0])])
    rig.run(4.0)
    onset = rig.now + round(ahead_s * 1e6)
    rig.tick([rig.request(pair[1], ahead_s)])
    rig.run(ahead_s + 3.0)
    return rig, onset


def onset_of(rig, request_id=2):
    found = [c for c in rig.changes if c.key[1] == request_id and c.state == status.RUNNING]
    return found[0].onset_utime if found else None


def plan_of(rig, request_id=2):
    return [c.plan for c in rig.changes if c.key[1] == request_id and c.state == status.RUNNING][0]


def test_a_proven_and_checked_change_is_made_straight_away_on_its_onset(library):
    rig, onset = dance(library, atlas_of(0.009, PAIR))
    assert plan_of(rig) == "blended"
    assert abs(onset_of(rig) - onset) <= 20_000
    states = [state for state, _, _ in rig.words(2)]
    order = [status.QUEUED, status.PLANNING, status.PROVEN, status.BLENDING, status.RUNNING]
    assert [s for s in states if s in order] == order
    assert any("0 of 32 rollouts fell" in reason for _, _, reason in rig.words(2))


def test_a_refused_plan_goes_through_stand_and_is_still_in_time(library):
    def from_dance(query):
        return 6 if query.from_skill == "kpop" else 0

    rig, onset = dance(library, atlas_of(0.009, PAIR), answer=from_dance)
    assert plan_of(rig) == "via_stand"
    assert abs(onset_of(rig) - onset) <= 60_000
    assert any("6 of 32 rollouts from here fell" in reason for _, _, reason in rig.words(2))


def test_what_ends_by_itself_stands_soon_where_every_plan_needs_its_check(library):
    """What is wanted at once must not be planned anew in every tick, while the checker thinks."""
    rig = ProofRig(library, atlas_of(0.009, PAIR, stand=0.009))
    rig.run(3.0)
    request = rig.request("kpop")
    request.duration_s = 1.0
    rig.tick([request])
    rig.run(4.0)
    (done,) = [c for c in rig.changes if c.key[1] == 1 and c.state == status.DONE]
    to_stand = [query for query in rig.queries if query.to_skill == "stand"]
    assert done and 1 <= len(to_stand) <= 2
    assert rig.core.director.playback.name == "stand"


def test_a_lone_fall_does_not_refuse_a_proven_plan(library):
    rig, _ = dance(library, atlas_of(0.009, PAIR), answer=1)
    assert plan_of(rig) == "blended"


def test_without_an_answer_only_strictly_proven_plans_are_made(library):
    weak, onset = dance(library, atlas_of(0.009, PAIR), answer=None)
    assert plan_of(weak) == "via_stand"
    assert abs(onset_of(weak) - onset) <= 60_000
    strong, onset = dance(library, atlas_of(0.0025, PAIR), answer=None)
    assert plan_of(strong) == "blended"
    assert abs(onset_of(strong) - onset) <= 20_000


def test_a_dead_checker_is_not_waited_for_twice(library):
    rig, _ = dance(library, atlas_of(0.009, PAIR), answer=None)
    asked = len(rig.queries)
    rig.tick([rig.request("kpop")])
    before = rig.now
    rig.run(4.0)
    assert onset_of(rig, 3) is not None
    assert onset_of(rig, 3) - before < 1_600_000
    assert len(rig.queries) <= asked + 1


def test_a_wish_for_now_waits_for_its_check_but_not_longer(library):
    rig, wanted = dance(library, atlas_of(0.009, PAIR), ahead_s=0.0)
    assert plan_of(rig) == "blended"
    assert 140_000 <= onset_of(rig) - wanted <= 500_000


def test_a_strictly_proven_wish_for_now_does_not_wait(library):
    rig, wanted = dance(library, atlas_of(0.0025, PAIR), ahead_s=0.0)
    assert onset_of(rig) - wanted <= 200_000


def test_footwork_is_left_straight_into_a_planted_dance_on_the_boundary(library):
    rig, onset = dance(library, atlas_of(0.009, STEPS), pair=STEPS)
    assert plan_of(rig) == "blended"
    assert abs(onset_of(rig) - onset) <= 40_000


def test_an_unproven_pair_goes_through_stand_without_asking(library):
    atlas = atlas_of(0.5, PAIR)
    rig, onset = dance(library, atlas)
    assert plan_of(rig) == "via_stand"
    assert not [q for q in rig.queries if q.to_skill == "disco" and q.from_skill == "kpop"]
    assert abs(onset_of(rig) - onset) <= 60_000


def test_pairs_that_were_never_swept_follow_the_measured_rules(library):
    rig, onset = dance(library, atlas_of(0.009, STEPS))
    assert plan_of(rig) == "blended"
    assert not rig.queries
    assert abs(onset_of(rig) - onset) <= 20_000


def test_a_cancelled_request_leaves_no_plan_behind(library):
    rig = ProofRig(library, atlas_of(0.009, PAIR))
    rig.run(3.0)
    rig.tick([rig.request("kpop")])
    rig.run(4.0)
    rig.tick([rig.request("disco", 2.0)])
    rig.run(0.6)
    cancel = rig.request("disco")
    cancel.operation, cancel.target_request_id = cancel.CANCEL, 2
    rig.tick([cancel])
    rig.run(4.0)
    assert onset_of(rig, 2) is None
    assert rig.log[-1].status.skill == "kpop"


def test_an_answer_to_nothing_changes_nothing(library):
    outputs = []
    for verdicts in ((), (verdict(transition_query_t(), 32),)):
        rig = ProofRig(library, atlas_of(0.009, PAIR), answer=None)
        rig.run(3.0)
        rig.tick([rig.request("kpop")])
        rig.run(4.0)
        outputs.append(
            rig.core.tick(TickInput(rig.now, rig.tick_number, rig.state(), 0, verdicts=verdicts))
        )
    one, two = outputs
    assert np.array_equal(one.command.joint_pos_target, two.command.joint_pos_target)
    assert one.status.skill == two.status.skill


def test_a_snapshot_in_the_middle_of_a_proof_continues_bit_for_bit(library):
    atlas = atlas_of(0.009, PAIR)
    rig = ProofRig(library, atlas)
    rig.run(3.0)
    rig.tick([rig.request("kpop")])
    rig.run(4.0)
    rig.tick([rig.request("disco", 1.5)])
    while not rig.queries:
        rig.tick()
    twin = ControlCore(library, CoreConfig(proof=ProofConfig(use_checker=True)), atlas)
    twin.restore(rig.core.snapshot())
    for _ in range(150):
        inputs = TickInput(rig.now, rig.tick_number, rig.state(), 0)
        again = twin.tick(inputs)
        once = rig.core.tick(inputs)
        rig.now += 20_000
        rig.tick_number += 1
        assert np.array_equal(once.command.joint_pos_target, again.command.joint_pos_target)
        assert once.status.skill == again.status.skill


def test_a_dance_is_played_at_the_nearest_tempo_that_it_is_certified_for(library):
    rig = ProofRig(library, atlas_of(0.009, STEPS))
    rig.run(3.0)
    slow = rig.request("discostep")
    slow.phase_rate = 0.6  # 72 BPM; certified from 95
    rig.tick([slow])
    rig.run(4.0)
    assert rig.log[-1].status.skill == "discostep"
    assert rig.log[-1].status.phase_rate == pytest.approx(95.0 / 120.0, rel=0.11)
    assert any("certified" in reason for _, _, reason in rig.words(1))


def test_nothing_is_asked_that_could_not_be_answered_in_time(library):
    """A plan that begins in this tick is decided in it: its answer would be thrown away."""
    asked = []

    def answer(query):
        asked.append(query)
        return 6 if query.from_skill == "kpop" else 0

    rig, _ = dance(library, atlas_of(0.009, PAIR), answer=answer, ahead_s=0.0)
    assert plan_of(rig) == "via_stand" and asked
    for query in asked:
        assert query.deadline_utime > query.header.utime
