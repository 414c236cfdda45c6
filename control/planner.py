"""Direct plans: which blend, at which tick, into which phase, among those that the atlas proves.

Pure functions of the phases now and of the goal. Cost is the onset error first, then the order of
the modes, then whole beats by which the new skill is entered elsewhere than the music's line says.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from downbeat.control.atlas import Atlas
from downbeat.control.modes import Mode, modes_between
from downbeat.control.phase import TICK_US, PhaseFollower, next_beat_utime
from downbeat.control.slots import enters_at_zero
from downbeat.control.transitions import (
    SNAP_TO_BEAT_US,
    Entry,
    Goal,
    Hop,
    beat_s,
    half_us,
    is_learned,
)
from downbeat.policies.manifest import SkillManifest

SHIFTS_US = (0, TICK_US, -TICK_US, 2 * TICK_US, -2 * TICK_US)
"""A boundary may be missed by this much to leave a skill in a proven slot."""
SEARCH_US = 1_500_000
"""A change that is wanted at once waits at most this long for a proven slot."""
BAR_BEATS = 4


@dataclass(frozen=True, slots=True)
class Plan:
    """A direct change.

    Attributes:
        hop: What control does.
        mode: Name of the blend.
        bound: 95 % upper bound on the share that falls, from the atlas.
        exit_slot: Where the source is left.
    """

    hop: Hop
    mode: str
    bound: float
    exit_slot: int

    @property
    def onset_utime(self) -> int:
        """When the weight passes one half [us]."""
        return self.hop.start_utime + half_us(self.hop.blend_ticks)


Veto = tuple[str, str, int]
"""(target, mode, exit slot) of a plan that a check refused."""


def direct_plan(
    atlas: Atlas,
    active: SkillManifest,
    follower: PhaseFollower,
    goal: Goal,
    now: int,
    limit: float,
    earliest_utime: int,
    vetoes: tuple[Veto, ...] = (),
) -> Plan | None:
    """Return the cheapest proven direct plan, or None.

    Args:
        atlas: What was proven.
        active: The skill that runs alone.
        follower: Its phase.
        goal: What is wanted.
        now: [us].
        limit: Bound that counts as proven.
        earliest_utime: The blend starts no earlier [us].
        vetoes: Plans that were refused already.
    """
    best: tuple[tuple[int, bool, int, int], Plan] | None = None
    for order, mode in enumerate(modes_between(active, goal.skill)):
        if (active.name, goal.skill.name, mode.name) not in atlas.cells:
            continue
        half = half_us(mode.blend_ticks)
        for onset, beats in _onsets(goal, earliest_utime + half, now):
            miss = abs(onset - max(goal.onset_utime, earliest_utime + half))
            cost = (miss, beats % BAR_BEATS != 0, beats, order)
            if best is not None and cost >= best[0]:
                continue
            plan = _judge(atlas, active, follower, goal, now, mode, onset, beats)
            veto = (goal.skill.name, mode.name, plan.exit_slot)
            if plan.bound <= limit and veto not in vetoes:
                best = (cost, plan)
    return None if best is None else best[1]


def _onsets(goal: Goal, earliest: int, now: int) -> Iterator[tuple[int, int]]:
    """Yield onsets worth trying [us], with whole beats to shift the entry by."""
    beat, is_zero = beat_s(goal.skill), enters_at_zero(goal.skill)
    on_beats = is_zero and beat is not None and goal.line.rate > 0.0
    grace = TICK_US // 2
    if goal.onset_utime >= earliest - grace:
        wanted = goal.onset_utime
        if on_beats and beat is not None:
            snapped = next_beat_utime(goal.line, beat, wanted - SNAP_TO_BEAT_US)
            if abs(snapped - wanted) <= SNAP_TO_BEAT_US and snapped >= earliest - grace:
                wanted = snapped
        yield from ((wanted + s, 0) for s in SHIFTS_US if wanted + s >= earliest - grace)
        yield from ((wanted, beats) for beats in _shifts(goal.skill))
        return
    if on_beats and beat is not None:
        onset = next_beat_utime(goal.line, beat, earliest - grace)
        while onset <= now + SEARCH_US:
            yield onset, 0
            onset = next_beat_utime(goal.line, beat, onset + 3 * TICK_US)
        return
    for onset in range(earliest, now + SEARCH_US, TICK_US):
        yield onset, 0
        if onset - earliest < 5 * TICK_US:
            yield from ((onset, beats) for beats in _shifts(goal.skill))


def _shifts(skill: SkillManifest) -> tuple[int, ...]:
    """Return whole beats by which a skill may be entered elsewhere, whole bars first."""
    if skill.bpm <= 0 or enters_at_zero(skill) or is_learned(skill):
        return ()
    beats = range(1, round(skill.duration_s * skill.bpm / 60.0))
    return tuple(sorted(beats, key=lambda beat: (beat % BAR_BEATS != 0, beat)))


def _judge(
    atlas: Atlas,
    active: SkillManifest,
    follower: PhaseFollower,
    goal: Goal,
    now: int,
    mode: Mode,
    onset: int,
    beats: int,
) -> Plan:
    skill = goal.skill
    exit_s = _inside(active, follower.phase_s + follower.rate * (onset - now) * 1e-6)
    shift_s = beats * 60.0 / skill.bpm if beats else 0.0
    entry_s = _inside(skill, goal.line.at(onset) + shift_s)
    bound = atlas.bound(active, skill, mode.name, exit_s, entry_s)
    start = onset - half_us(mode.blend_ticks)
    entry: Entry = "zero" if enters_at_zero(skill) else "line"
    hop = Hop(start, skill.name, mode.blend_ticks, mode.style, entry, shift_s)
    return Plan(hop, mode.name, bound, atlas.exits(active).at(exit_s))


def _inside(skill: SkillManifest, phase_s: float) -> float:
    if skill.loop:
        return phase_s % skill.duration_s
    return min(max(phase_s, 0.0), skill.duration_s)
