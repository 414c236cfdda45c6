"""Slots: every phase has one, and one that counts lies where it says."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from downbeat.control.modes import BY_NAME, modes_between
from downbeat.control.slots import PARTS_PER_BEAT, enters_at_zero, entry_slots, exit_slots
from downbeat.policies.manifest import load_skills

SKILLS = load_skills()
ALL = sorted(SKILLS)


@pytest.mark.parametrize("slots_of", [exit_slots, entry_slots])
@pytest.mark.parametrize("name", ALL)
def test_the_middle_of_a_slot_lies_in_that_slot(name, slots_of):
    slots = slots_of(SKILLS[name])
    assert slots.count >= 1
    for slot in range(slots.count):
        assert slots.at(slots.phase_s(slot)) == slot
        assert slots.miss_s(slots.phase_s(slot)) == pytest.approx(0.0, abs=1e-9)


@given(name=st.sampled_from(ALL), share=st.floats(0.0, 1.0))
def test_every_phase_has_the_slot_nearest_to_it(name, share):
    skill = SKILLS[name]
    for slots in (exit_slots(skill), entry_slots(skill)):
        phase = share * skill.duration_s
        slot = slots.at(phase)
        assert 0 <= slot < slots.count
        if slots.width_s > 0.0:
            off = abs(phase - slots.phase_s(slot))
            off = min(off, abs(skill.duration_s - off)) if skill.loop else off
            assert off <= 0.5 * slots.width_s + 1e-9


@given(name=st.sampled_from(ALL), share=st.floats(0.0, 1.0))
def test_only_footwork_and_gaits_miss_a_slot(name, share):
    skill = SKILLS[name]
    slots = exit_slots(skill)
    miss = slots.miss_s(share * skill.duration_s)
    assert miss <= 0.5 * slots.width_s + 1e-9
    if skill.kind == "planted":
        assert miss == 0.0


@pytest.mark.parametrize("name", [n for n in ALL if SKILLS[n].kind == "stepping"])
def test_footwork_is_left_at_quarters_of_a_beat_and_entered_at_its_beginning(name):
    skill = SKILLS[name]
    slots = exit_slots(skill)
    assert slots.is_exact
    assert slots.count == skill.beats * PARTS_PER_BEAT
    assert slots.width_s == pytest.approx(60.0 / skill.bpm / PARTS_PER_BEAT)
    assert entry_slots(skill).count == 1 and enters_at_zero(skill)


@pytest.mark.parametrize(
    "name", [n for n in ALL if SKILLS[n].kind == "planted" and SKILLS[n].bpm > 0]
)
def test_a_planted_dance_has_a_slot_per_beat_both_ways(name):
    skill = SKILLS[name]
    for slots in (exit_slots(skill), entry_slots(skill)):
        assert slots.count == skill.beats
        assert not slots.is_exact


def test_the_slots_of_a_loop_cover_it_once():
    for skill in SKILLS.values():
        slots = exit_slots(skill)
        if skill.loop and slots.width_s > 0.0:
            assert slots.count * slots.width_s == pytest.approx(skill.duration_s)


def test_every_pair_has_modes_that_the_atlas_can_name():
    for a in SKILLS.values():
        for b in SKILLS.values():
            modes = modes_between(a, b)
            assert modes and all(BY_NAME[mode.name] is mode for mode in modes)
