"""How one skill becomes another: the next hop, as a pure function.

Rules measured in `docs/transitions_measured.md`, and through this code by
`python -m downbeat.sim.control_trials` (0 falls in 240 changes out of footwork at any beat).
Planted skills (both feet stay) cross-fade at any phase; footwork is entered at its phase 0 and left
at its exit phases; everything else goes through the stand skill. The planner only ever answers
"which hop next, and when does it start": a route through stand emerges because, once in stand, the
same question is asked again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from downbeat.control.phase import TICK_S, TICK_US, PhaseFollower, PhaseLine, next_beat_utime
from downbeat.policies.manifest import SkillManifest

PLANTED_BLEND_TICKS = 30
"""0.6 s: no fall in 960 trials at random phases; 0.3 s: one in 480."""
FOOTWORK_BLEND_TICKS = 15
"""0.3 s between stand and footwork at its phase 0."""
WALK_BLEND_TICKS = 10
LEARNED_BLEND_TICKS = 15
"""0.3 s to or from an imported policy, which balances by itself while it is faded in."""
BALANCE_HOLD_TICKS = 25
"""0.5 s alone in the balance policy between a learned motion and our own skills."""
STAND_HOLD_TICKS = 15
"""Stand time between two blends of a route via stand."""
SNAP_TO_BEAT_US = 60_000
"""A start of footwork may move this far to stand on a beat; the onset error stays under 0.1 s."""
LOOP_BOUNDARY_WAIT_S = 1.0
"""Footwork to footwork waits at most this long for the loop boundary, else it goes via stand."""

Style = Literal["full", "legs_hard"]
Entry = Literal["line", "zero"]


@dataclass(frozen=True, slots=True)
class Hop:
    """One switch.

    Attributes:
        start_utime: When the blend starts [us].
        to_skill: Where it leads.
        blend_ticks: Length of the blend; the onset (weight 0.5) is in its middle.
        style: "full" mixes all joints; "legs_hard" switches the legs in the middle at once.
        entry: "line": the skill enters on its phase line; "zero": held at phase 0 until the
            middle of the blend.
        shift_s: The skill enters this much ahead of its line, whole beats [s].
    """

    start_utime: int
    to_skill: str
    blend_ticks: int
    style: Style = "full"
    entry: Entry = "line"
    shift_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Goal:
    """What is asked for.

    Attributes:
        skill: Manifest of the wanted skill.
        line: Phase line wanted.
        onset_utime: When its weight shall pass 0.5 [us]; 0: as soon as possible.
    """

    skill: SkillManifest
    line: PhaseLine
    onset_utime: int


def half_us(blend_ticks: int) -> int:
    """Return the time from the start of a blend to its onset tick [us]."""
    return (blend_ticks // 2) * TICK_US


def beat_s(skill: SkillManifest) -> float | None:
    """Return the length of a beat of a skill [s of skill time], None for gestures."""
    return 60.0 / skill.bpm if skill.bpm > 0 else None


def is_planted(skill: SkillManifest) -> bool:
    """Whether both feet stay on the ground."""
    return skill.kind == "planted"


def is_learned(skill: SkillManifest) -> bool:
    """Whether an imported policy moves the robot: it balances from wherever it is."""
    return skill.policy is not None


def next_hop(
    active: SkillManifest,
    follower: PhaseFollower,
    still: bool,
    goal: Goal,
    now: int,
    balance: str = "",
    alone_us: int = 0,
) -> Hop | None:
    """Return the next hop from `active` towards `goal`, or None while it must wait.

    Args:
        active: The skill that runs alone (no blend is under way).
        follower: Its phase.
        still: For locomotion: the commanded velocity is zero.
        goal: What is wanted.
        now: [us].
        balance: An imported policy that stands wherever it is put; empty: there is none.
        alone_us: For how long `active` has run alone [us].

    Returns:
        A hop whose `start_utime` may lie in the future; the caller starts it when it is due.
    """
    if is_learned(active):
        return _from_learned(active, follower, goal, now, balance, alone_us)
    if is_planted(active):
        return _from_planted(active, goal, now)
    if active.kind == "locomotion":
        return _from_walk(follower, still, goal, now)
    return _from_footwork(active, follower, goal, now)


def _from_learned(
    active: SkillManifest,
    follower: PhaseFollower,
    goal: Goal,
    now: int,
    balance: str,
    alone_us: int,
) -> Hop:
    """Leave an imported policy: to another one anywhere, to our own skills from calm feet.

    Our skills expect the feet side by side. In the middle of a learned motion they are anywhere, so
    the way leads over the balance policy; without one the motion is played to its end.
    """
    skill = goal.skill
    if is_learned(skill):
        start = goal.onset_utime - half_us(LEARNED_BLEND_TICKS)
        return Hop(max(start, now), skill.name, LEARNED_BLEND_TICKS)
    target, lead = skill.name, half_us(PLANTED_BLEND_TICKS)
    if not is_planted(skill):
        blend = WALK_BLEND_TICKS if skill.kind == "locomotion" else FOOTWORK_BLEND_TICKS
        target = "stand"
        lead = half_us(blend) + (STAND_HOLD_TICKS + PLANTED_BLEND_TICKS) * TICK_US
    if active.kind == "tracking" and balance and balance != active.name:
        lead += (BALANCE_HOLD_TICKS + LEARNED_BLEND_TICKS) * TICK_US
        return Hop(max(goal.onset_utime - lead, now), balance, LEARNED_BLEND_TICKS)
    start = goal.onset_utime - lead
    if active.kind == "tracking":
        left_s = (follower.duration_s - follower.phase_s) / max(follower.rate, 1e-3)
        start = max(start, now + round(left_s * 1e6))
    elif active.name == balance:
        start = max(start, now + BALANCE_HOLD_TICKS * TICK_US - alone_us)
    return Hop(max(start, now), target, PLANTED_BLEND_TICKS)


def _from_planted(active: SkillManifest, goal: Goal, now: int) -> Hop:
    skill = goal.skill
    if is_learned(skill):
        start = goal.onset_utime - half_us(LEARNED_BLEND_TICKS)
        return Hop(max(start, now), skill.name, LEARNED_BLEND_TICKS)
    if is_planted(skill):
        start = goal.onset_utime - half_us(PLANTED_BLEND_TICKS)
        return Hop(max(start, now), skill.name, PLANTED_BLEND_TICKS)
    blend = WALK_BLEND_TICKS if skill.kind == "locomotion" else FOOTWORK_BLEND_TICKS
    # Half a tick of grace: a start that falls between two ticks is still caught by the second.
    onset = _footwork_onset(goal, now + half_us(blend) - TICK_US // 2)
    if active.name == "stand":
        return Hop(max(onset - half_us(blend), now), skill.name, blend, entry="zero")
    lead = half_us(blend) + (STAND_HOLD_TICKS + PLANTED_BLEND_TICKS) * TICK_US
    return Hop(max(onset - lead, now), "stand", PLANTED_BLEND_TICKS)


def _footwork_onset(goal: Goal, earliest: int) -> int:
    """Return when footwork should begin: on a beat where that costs little or nothing was asked."""
    beat = beat_s(goal.skill)
    if beat is None or goal.line.rate <= 0.0:
        return max(goal.onset_utime, earliest)
    if goal.onset_utime >= earliest:
        snapped = next_beat_utime(goal.line, beat, goal.onset_utime - SNAP_TO_BEAT_US)
        near = abs(snapped - goal.onset_utime) <= SNAP_TO_BEAT_US and snapped >= earliest
        return snapped if near else goal.onset_utime
    return next_beat_utime(goal.line, beat, earliest)


def _from_walk(follower: PhaseFollower, still: bool, goal: Goal, now: int) -> Hop | None:
    """Leave a walk at its gait boundary, once it marches on the spot."""
    if not still:
        return None
    wait_us = round(follower.next_crossing_s(0.0) * 1e6)
    return Hop(now + wait_us, "stand", WALK_BLEND_TICKS)


def walk_stop_lead_us(speed_ratio: float) -> int:
    """Return how long before its end a walk must begin to stop [us].

    1.0 s of slew from full speed plus at most one gait cycle and the blend (measured: 1.0 s).
    """
    return round((1.0 * speed_ratio + 1.0) * 1e6)


def _from_footwork(active: SkillManifest, follower: PhaseFollower, goal: Goal, now: int) -> Hop:
    skill = goal.skill
    if skill.kind == "stepping":
        boundary = now + round(follower.next_crossing_s(0.0) * 1e6)
        if _loop_boundary_fits(boundary, goal, now):
            start = boundary - half_us(FOOTWORK_BLEND_TICKS)
            return Hop(max(start, now), skill.name, FOOTWORK_BLEND_TICKS, "legs_hard", "zero")
    last = _last_exit_start(goal, now)
    return Hop(_pick_exit(active, follower, last, now), "stand", FOOTWORK_BLEND_TICKS)


def _loop_boundary_fits(boundary: int, goal: Goal, now: int) -> bool:
    early_enough = boundary - now >= half_us(FOOTWORK_BLEND_TICKS)
    if goal.onset_utime == 0 or goal.onset_utime < now:
        return early_enough and boundary - now <= LOOP_BOUNDARY_WAIT_S * 1e6
    return early_enough and abs(boundary - goal.onset_utime) <= SNAP_TO_BEAT_US


def _last_exit_start(goal: Goal, now: int) -> int:
    """Return the latest start of the blend into stand that still meets the goal [us]."""
    if goal.onset_utime == 0:
        return now
    if goal.skill.name == "stand":
        # The onset of stand itself is wanted: an exit up to 80 ms late beats one far too early.
        return goal.onset_utime - half_us(FOOTWORK_BLEND_TICKS) + 4 * TICK_US
    second = PLANTED_BLEND_TICKS if is_planted(goal.skill) else FOOTWORK_BLEND_TICKS
    lead = half_us(second) + (FOOTWORK_BLEND_TICKS + STAND_HOLD_TICKS) * TICK_US
    return goal.onset_utime - lead


def _pick_exit(active: SkillManifest, follower: PhaseFollower, last: int, now: int) -> int:
    """Return the last exit that starts no later than `last`, or the next one if it is too late."""
    exits = active.exit_phases_s or (0.0,)
    waits = sorted(follower.next_crossing_s(phase) for phase in exits)
    best = waits[0]
    loop_s = follower.duration_s / max(follower.rate, 1e-3)
    for lap in range(1 + max(0, int((last - now) * 1e-6 / loop_s) + 1)):
        for wait in waits:
            candidate = wait + lap * loop_s
            if now + candidate * 1e6 <= last + 0.5 * TICK_S * 1e6:
                best = max(best, candidate)
    return now + round(best * 1e6)
