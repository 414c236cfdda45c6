"""Whatever arrives in whatever order, control's answer is a function of what it consumed."""

import json

from control_states import START, fresh_state
from hypothesis import given, settings
from hypothesis import strategies as st

from downbeat.control.core import ControlCore
from downbeat.control.policy import SkillLibrary
from downbeat.control.record import input_of, tick_record
from downbeat.control.tick import TickInput
from downbeat.lcm_types import estop_t, operator_command_t, skill_request_t

TICKS = 90
SKILLS = ("stand", "kpop", "discostep", "wave", "walk")
LIBRARY = SkillLibrary.load(only=frozenset(SKILLS))
TIMES = st.one_of(st.just(0), st.integers(START, START + 3_000_000))


@st.composite
def requests(draw):
    msg = skill_request_t()
    msg.request_id = draw(st.integers(1, 6))
    msg.operation = draw(st.integers(0, 3))
    msg.target_request_id = draw(st.integers(0, 6))
    msg.skill = draw(st.sampled_from((*SKILLS, "nonsense", "")))
    msg.source = draw(st.integers(0, 3))
    msg.priority = draw(st.integers(0, 3))
    msg.start_utime = draw(
        st.one_of(st.just(0), st.integers(0, 3_000_000).map(lambda u: START + u))
    )
    msg.expires_utime = draw(
        st.one_of(st.just(0), st.integers(0, 3_000_000).map(lambda u: START + u))
    )
    msg.start_phase_s = draw(st.floats(0, 20))
    msg.phase_rate = draw(st.floats(0.1, 5))
    msg.duration_s = draw(st.floats(0, 3))
    msg.velocity = [draw(st.sampled_from((-0.5, 0.0, 0.25))) for _ in range(3)]
    return msg


def others(cls, field, values):
    def build(value):
        msg = cls()
        setattr(msg, field, value)
        return msg

    return st.sampled_from(values).map(build)


EVENTS = st.tuples(
    st.integers(0, TICKS - 1),
    st.one_of(
        requests().map(lambda m: ("requests", m)),
        others(operator_command_t, "command", (1, 2, 3, 5)).map(lambda m: ("operator", m)),
        others(estop_t, "level", (0, 1)).map(lambda m: ("estops", m)),
    ),
)
AGES = st.lists(
    st.tuples(st.integers(0, TICKS - 1), st.sampled_from((-60_000, 0, 5_000, 40_000, 200_000))),
    max_size=4,
)


@given(events=st.lists(EVENTS, max_size=12), ages=AGES, lost=st.sets(st.integers(0, TICKS - 1)))
@settings(max_examples=20)
def test_any_sequence_of_messages_replays_bit_for_bit(events, ages, lost):
    core, records = ControlCore(LIBRARY), []
    late = dict(ages)
    state = None
    for tick in range(TICKS):
        if tick not in lost:
            state = fresh_state(tick)
        now = START + tick * 20_000
        age = 0 if state is None else now - state.header.utime + late.get(tick, 0)
        lists = {
            kind: tuple(m for at, (k, m) in events if at == tick and k == kind)
            for kind in ("requests", "operator", "estops")
        }
        inputs = TickInput(now, tick, state, age, **lists)
        records.append(tick_record(inputs, core.tick(inputs)))
    again = ControlCore(LIBRARY)
    for record in (json.loads(json.dumps(r)) for r in records):
        inputs = input_of(record)
        assert tick_record(inputs, again.tick(inputs)) == record


@given(events=st.lists(EVENTS, max_size=8), cut=st.integers(1, TICKS - 1))
@settings(max_examples=20)
def test_a_snapshot_taken_anywhere_continues_the_same(events, cut):
    def inputs_at(tick):
        lists = {
            kind: tuple(m for at, (k, m) in events if at == tick and k == kind)
            for kind in ("requests", "operator", "estops")
        }
        return TickInput(START + tick * 20_000, tick, fresh_state(tick), 0, **lists)

    core = ControlCore(LIBRARY)
    for tick in range(cut):
        core.tick(inputs_at(tick))
    other = ControlCore(LIBRARY)
    other.restore(core.snapshot())
    for tick in range(cut, TICKS):
        inputs = inputs_at(tick)
        assert tick_record(inputs, core.tick(inputs)) == tick_record(inputs, other.tick(inputs))
