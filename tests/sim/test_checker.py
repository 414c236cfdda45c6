"""The checker simulates the plan that control has, in time, and nothing on the wire breaks it."""

import time

import numpy as np
import pytest

from downbeat.control.atlas import Atlas
from downbeat.control.director import Director
from downbeat.control.phase import TICK_US
from downbeat.control.prover import ProofConfig
from downbeat.control.snapshot import from_bytes
from downbeat.lcm_types import transition_verdict_t
from downbeat.policies.manifest import load_skills
from downbeat.runtime.bus import MemqHub
from downbeat.runtime.clock import SIM_EPOCH_UTIME, SimClock
from downbeat.sim.batch.bench_check import capture_query
from downbeat.sim.batch.rehearsal import SilentLibrary, _estimate, rehearse
from downbeat.sim.checker import Checker, CheckerNode, lockstep_latency_us

PROOF = ProofConfig(use_checker=True)


@pytest.fixture(scope="module")
def question():
    return capture_query()


@pytest.fixture(scope="module")
def checker(question):
    return Checker(load_skills(), question[1], PROOF, threads=1)


@pytest.fixture
def query(question):
    query, _ = question
    query.num_rollouts, query.horizon_s = 8, 0.6
    query.control_state_hash, query.profile = 0, "stage"
    return query


class Wire:
    """A checker behind a bus."""

    def __init__(self, checker, lockstep):
        self.clock = SimClock(SIM_EPOCH_UTIME)
        hub = MemqHub(0)
        self.asker = hub.endpoint("control", self.clock)
        self.asker.subscribe("TRANSITION_VERDICT")
        self.node = CheckerNode(hub.endpoint("checker", self.clock), checker, lockstep)

    def ask(self, query, left_us):
        query.header.utime = self.clock.utime()
        query.deadline_utime = self.clock.utime() + left_us
        self.asker.publish("TRANSITION_QUERY", query)
        self.node.step(self.clock.utime())
        return self.answers()

    def answers(self):
        self.asker.pump()
        return [received.msg for received in self.asker.take("TRANSITION_VERDICT")]


def test_a_proven_change_is_found_safe(checker, query):
    (verdict,) = Wire(checker, False).ask(query, 60_000_000)
    assert verdict.query_id == query.query_id
    assert verdict.verdict == transition_verdict_t.SAFE
    assert (verdict.num_rollouts, verdict.num_fallen) == (8, 0)
    assert 0.3 < verdict.p_fall_upper < 0.4  # what 8 clean rollouts support
    assert 0.0 < verdict.max_tilt < 0.3


def test_a_robot_that_is_falling_is_found_unsafe(checker, query):
    qvel = list(query.qvel)
    pushed = np.array(qvel)
    pushed[0] += 1.2
    query.qvel = pushed.tolist()
    try:
        (verdict,) = Wire(checker, False).ask(query, 60_000_000)
    finally:
        query.qvel = qvel
    assert verdict.verdict == transition_verdict_t.UNSAFE
    assert verdict.num_fallen > 4


def test_equal_questions_get_equal_answers(checker, query):
    first, second = (checker.check(query).outcome for _ in range(2))
    for name in ("fell_tick", "max_tilt", "min_margin", "end_error"):
        assert np.array_equal(getattr(first, name), getattr(second, name))


def test_without_time_it_says_so_at_once(checker, query):
    query.num_rollouts, query.horizon_s = 256, 4.0
    began = time.monotonic()
    (verdict,) = Wire(checker, False).ask(query, 60_000)
    assert time.monotonic() - began < 0.5
    assert verdict.verdict == transition_verdict_t.TIMED_OUT
    assert verdict.num_rollouts == 0


def test_in_lockstep_the_answer_takes_the_time_that_it_takes(checker, query):
    wire = Wire(checker, True)
    assert wire.ask(query, 5_000_000) == []
    wire.clock.advance_to(SIM_EPOCH_UTIME + lockstep_latency_us(8))
    wire.node.step(wire.clock.utime())
    (verdict,) = wire.answers()
    assert verdict.num_rollouts == 8


@pytest.mark.parametrize("damage", ["state", "empty", "profile", "nan"])
def test_nonsense_is_answered_and_never_breaks_it(checker, query, damage):
    state, bytes_before = query.control_state, query.num_bytes
    qpos = list(query.qpos)
    if damage == "state":
        query.control_state = bytes(state)[:-20]
    elif damage == "empty":
        query.control_state = b""
    elif damage == "profile":
        query.profile = "no_such_night"
    query.num_bytes = len(query.control_state)
    wire = Wire(checker, False)
    try:
        if damage == "nan":
            broken = np.array(qpos)
            broken[2] = -3.0  # under the floor
            query.qpos = broken.tolist()
        (verdict,) = wire.ask(query, 60_000_000)
    finally:
        query.control_state, query.num_bytes, query.qpos = state, bytes_before, qpos
        query.profile = "stage"
    expected = transition_verdict_t.UNSAFE if damage == "nan" else transition_verdict_t.TIMED_OUT
    assert verdict.verdict == expected
    assert Wire(checker, False).ask(query, 60_000_000)[0].verdict == transition_verdict_t.SAFE


def test_the_script_is_what_the_director_then_plays(question, query):
    _, atlas = question
    query.horizon_s = 2.0
    manifests = load_skills()
    plan = rehearse(query, manifests, atlas, PROOF)
    library = SilentLibrary(manifests)
    director = Director(library, atlas=atlas, proof=PROOF)
    director.from_state(from_bytes(bytes(query.control_state), library)["director"])
    director.prover.state.chosen.is_safe = True
    now, state = int(query.header.utime), _estimate(query)
    names = plan.script.skills
    for tick in range(plan.script.ticks):
        director.update(state, now)
        for playback, share in played(director):
            index = names.index(playback.name)
            assert plan.script.phase_s[tick, index, 0] == playback.follower.wrapped_s
            assert plan.script.weight[tick, index, 1] == np.float32(share)
        director.play(state, now)
        director.end_tick(now)
        now += TICK_US
    assert plan.onset_tick > 0
    assert plan.script.skills[-1] == query.to_skill


def played(director):
    blend = director.blend
    if blend is None:
        return [(director.playback, 1.0)]
    return [(director.playback, blend.weight), (blend.outgoing, 1.0 - blend.weight)]


def test_an_atlas_is_not_needed_to_rehearse_what_was_chosen(query):
    plan = rehearse(query, load_skills(), Atlas(), PROOF)
    assert plan.script.ticks > 10
