"""Slots: the phases at which a skill may be left and entered, as the atlas counts them.

A phase here is that of the onset, the tick in which the weight passes one half. Footwork is left
at quarters of a beat, exactly: the feet land on the beat, and a few hundredths of a second decide.
A planted dance may be left anywhere, so its slots are whole beats with everything around them.
"""

from __future__ import annotations

from dataclasses import dataclass

from downbeat.policies.manifest import SkillManifest

PARTS_PER_BEAT = 4
MOTION_SLOT_S = 0.5
GESTURE_SLOT_S = 1.0
GAIT_SLOTS = 4


@dataclass(frozen=True, slots=True)
class Slots:
    """Slots of one skill.

    Attributes:
        count: How many.
        width_s: Distance between two of them [s of skill time].
        duration_s: Length of the skill.
        loop: Whether it repeats.
        is_exact: Only the slots themselves count, not what lies between.
    """

    count: int
    width_s: float
    duration_s: float
    loop: bool
    is_exact: bool

    def at(self, phase_s: float) -> int:
        """Return the slot nearest to a phase."""
        number = int(phase_s / self.width_s + 0.5) if self.width_s > 0.0 else 0
        return number % self.count if self.loop else min(max(number, 0), self.count - 1)

    def phase_s(self, slot: int) -> float:
        """Return the middle of a slot [s]."""
        return slot * self.width_s

    def miss_s(self, phase_s: float) -> float:
        """Return how far a phase lies from the nearest slot [s]; 0 where anything goes."""
        if not self.is_exact:
            return 0.0
        off = phase_s % self.width_s
        return min(off, self.width_s - off)


def exit_slots(skill: SkillManifest) -> Slots:
    """Return where a skill may be left."""
    if skill.name == "stand" or (skill.policy is not None and skill.kind != "tracking"):
        return Slots(1, 0.0, skill.duration_s, skill.loop, False)
    if skill.kind == "stepping":
        return _every(skill, 60.0 / skill.bpm / PARTS_PER_BEAT, True)
    if skill.kind == "locomotion":
        return _every(skill, skill.duration_s / GAIT_SLOTS, True)
    if skill.kind == "tracking":
        return _every(skill, MOTION_SLOT_S, False)
    return _every(skill, 60.0 / skill.bpm if skill.bpm > 0 else GESTURE_SLOT_S, False)


def entry_slots(skill: SkillManifest) -> Slots:
    """Return where a skill may be entered: footwork, gaits and motions at their beginning."""
    planted = skill.kind == "planted" and skill.policy is None and skill.loop
    if not planted or skill.name == "stand":
        return Slots(1, 0.0, skill.duration_s, skill.loop, False)
    return _every(skill, 60.0 / skill.bpm if skill.bpm > 0 else GESTURE_SLOT_S, False)


def _every(skill: SkillManifest, width_s: float, is_exact: bool) -> Slots:
    whole = round(skill.duration_s / width_s)
    count = max(whole if skill.loop else whole + 1, 1)
    return Slots(count, width_s, skill.duration_s, skill.loop, is_exact)


def enters_at_zero(skill: SkillManifest) -> bool:
    """Whether a skill of ours stands at its phase 0 until the middle of the blend."""
    return skill.policy is None and skill.kind in ("stepping", "locomotion")
