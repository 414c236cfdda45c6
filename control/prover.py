"""Nothing is switched that was not proven: the atlas first, then a check from where the robot is.

The prover chooses the cheapest plan that the atlas proves, asks the checker early enough that the
way through stand is still open, and answers every tick with a hop that is due, or with nothing.
It never waits beyond a deadline. Where the atlas knows nothing about a pair (skills that were never
swept), the measured rules of `transitions.next_hop` decide, as they do for the way through stand.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from downbeat.control.atlas import Atlas
from downbeat.control.phase import TICK_US, PhaseFollower, PhaseLine
from downbeat.control.planner import Plan, Veto, direct_plan
from downbeat.control.requests import Key
from downbeat.control.slots import enters_at_zero
from downbeat.control.transitions import (
    FOOTWORK_BLEND_TICKS,
    PLANTED_BLEND_TICKS,
    STAND_HOLD_TICKS,
    Entry,
    Goal,
    Hop,
    half_us,
    next_hop,
)
from downbeat.control.verdicts import is_refused
from downbeat.lcm_types import skill_status_t, transition_verdict_t
from downbeat.policies.manifest import SkillManifest

PLAN_AHEAD_US = 4_000_000
"""Farther ahead than this a goal is not planned for."""
GOAL_MOVED_US = 40_000
"""A goal that moves by more makes its plan void."""
SILENT_US = 5_000_000
"""A checker that missed a deadline is taken for dead for this long."""
VETO_US = 1_000_000
"""A refused plan may be proposed again after this: the robot has moved on."""


Policy = Literal["proven", "via_stand", "hard"]


@dataclass(frozen=True, slots=True)
class ProofConfig:
    """How sure is sure.

    Attributes:
        checked: Bound of the atlas that is enough together with an online check.
        unchecked: Bound that is enough alone, when no check answers.
        rollouts: Asked of the checker.
        hurried_rollouts: Asked when a change is wanted at once.
        horizon_s: Simulated after the onset [s].
        ask_ahead_us: Before the last moment at which the way through stand is still open.
        patience_us: A change that is wanted at once waits at most this long for its check.
        use_checker: Ask at all.
        policy: "proven"; or, to compare with: "via_stand" stops in stand before every change,
            "hard" changes at once and blends nothing.
    """

    checked: float = 0.01
    unchecked: float = 0.003
    rollouts: int = 32
    hurried_rollouts: int = 8
    horizon_s: float = 2.0
    ask_ahead_us: int = 800_000
    patience_us: int = 140_000
    use_checker: bool = False
    policy: Policy = "proven"


@dataclass(slots=True)
class Chosen:
    """The plan that is being pursued.

    Attributes:
        key: The request.
        goal_utime: Onset that was wanted when it was chosen [us].
        plan: What is going to be done.
        query_id: Of the question to the checker; 0: not asked yet.
        deadline_utime: Of the answer [us].
        is_safe: The check agreed.
    """

    key: Key
    goal_utime: int
    plan: Plan
    query_id: int = 0
    deadline_utime: int = 0
    is_safe: bool = False


@dataclass(slots=True)
class ProverState:
    """Everything a prover remembers.

    Attributes:
        chosen: The plan that is being pursued.
        vetoes: Refused plans of the present request.
        veto_utime: When the last of them was refused [us].
        key: The present request.
        queries: Questions asked so far.
        silent_until_utime: The checker is not waited for before this [us]: it was too late.
    """

    chosen: Chosen | None = None
    vetoes: tuple[Veto, ...] = ()
    veto_utime: int = 0
    key: Key = (0, 0)
    queries: int = 0
    silent_until_utime: int = 0


@dataclass(frozen=True, slots=True)
class Question:
    """What the checker is asked in this tick.

    Attributes:
        query_id: Of the question.
        deadline_utime: Of the answer [us].
        rollouts: Wanted.
        chosen: The plan.
    """

    query_id: int
    deadline_utime: int
    rollouts: int
    chosen: Chosen


@dataclass(frozen=True, slots=True)
class Word:
    """Something to say about the request: a SKILL_STATUS."""

    state: int
    plan: str
    reason: str
    onset_utime: int


@dataclass
class Situation:
    """What the prover looks at in a tick; see `transitions.next_hop`."""

    active: SkillManifest
    follower: PhaseFollower
    still: bool
    goal: Goal
    key: Key
    now: int
    balance: str = ""
    alone_us: int = 0


@dataclass
class Prover:
    """Chooses hops; its state is snapshotted with the director's."""

    atlas: Atlas
    stand: SkillManifest
    config: ProofConfig = field(default_factory=ProofConfig)
    state: ProverState = field(default_factory=ProverState)
    question: Question | None = None
    words: list[Word] = field(default_factory=list)

    def next(self, at: Situation) -> Hop | None:
        """Return the hop to start in this tick, or a later one, or None while there is none."""
        self.question = None
        rule = next_hop(at.active, at.follower, at.still, at.goal, at.now, at.balance, at.alone_us)
        if self.config.policy != "proven":
            return self._compared(at, rule)
        if not self._is_known(at.active, at.goal.skill) or not at.still:
            return rule
        if at.goal.onset_utime - at.now > PLAN_AHEAD_US:
            return None
        state = self.state
        if state.key != at.key or at.now > state.veto_utime + VETO_US:
            state.key, state.vetoes = at.key, ()
        chosen = self._pursue(at)
        out = self._way_out(at, rule)
        if chosen is None:
            return out
        self._maybe_ask(at, chosen, out)
        if chosen.plan.hop.start_utime > at.now + TICK_US // 2:
            return chosen.plan.hop
        if chosen.is_safe or chosen.plan.bound <= self._alone(at):
            return chosen.plan.hop
        self._veto(chosen, "no check in time, and the atlas alone is not sure enough", at.now)
        return out

    def hear(self, verdicts: tuple[transition_verdict_t, ...], now: int) -> None:
        """Take the checker's answers; what is said about them comes with the next `next`."""
        self.words = []
        for msg in verdicts:
            chosen = self.state.chosen
            if chosen is None or msg.query_id != chosen.query_id or chosen.is_safe:
                continue
            if msg.verdict == transition_verdict_t.TIMED_OUT or msg.num_rollouts <= 0:
                chosen.deadline_utime = min(chosen.deadline_utime, now - 1)
                continue
            self.state.silent_until_utime = 0
            fallen, count = int(msg.num_fallen), int(msg.num_rollouts)
            if is_refused(chosen.plan.bound, fallen, count):
                self._veto(chosen, f"{fallen} of {count} rollouts from here fell", now)
            else:
                chosen.is_safe = True
                said = f"atlas {chosen.plan.bound:.1%}, {fallen} of {count} rollouts fell"
                self._say(skill_status_t.PROVEN, chosen, said)

    def _compared(self, at: Situation, rule: Hop | None) -> Hop | None:
        """Return what would be done without proofs, for comparison."""
        if self.config.policy == "via_stand":
            return rule if "stand" in (at.active.name, at.goal.skill.name) else self._halt(at)
        if rule is None:
            return None
        entry: Entry = "zero" if enters_at_zero(at.goal.skill) else "line"
        return Hop(max(at.goal.onset_utime, at.now), at.goal.skill.name, 0, "full", entry)

    # ------------------------------------------------------------------ choosing

    def _is_known(self, active: SkillManifest, target: SkillManifest) -> bool:
        return (active.name, target.name) in self.atlas.pairs

    def _alone(self, at: Situation) -> float:
        """Return the bound that is enough without a check; in stand there is no safer way."""
        return self.config.checked if at.active.name == "stand" else self.config.unchecked

    def _limit(self, at: Situation) -> float:
        """Return the bound that is enough: a check will follow, or it will not."""
        config = self.config
        alive = config.use_checker and at.now >= self.state.silent_until_utime
        return config.checked if alive else self._alone(at)

    def _pursue(self, at: Situation) -> Chosen | None:
        """Return the plan to pursue: the one that was asked about, or the best one now."""
        state = self.state
        chosen = state.chosen
        if chosen is not None and not self._is_void(chosen, at):
            if chosen.query_id and not chosen.is_safe and at.now > chosen.deadline_utime:
                state.silent_until_utime = at.now + SILENT_US
                if chosen.plan.bound > self._alone(at):
                    self._veto(chosen, "the checker did not answer in time", at.now)
                    chosen = None
            if chosen is not None and (chosen.query_id or not self.config.use_checker):
                return chosen
        plan = self._best(at)
        state.chosen = None if plan is None else Chosen(at.key, at.goal.onset_utime, plan)
        return state.chosen

    def _best(self, at: Situation) -> Plan | None:
        """Return the earliest of: a plan that needs no check, and one that has time for it."""
        config, state = self.config, self.state
        plans = []
        limit, alive = self._limit(at), at.now >= state.silent_until_utime
        # In stand an answer is worth waiting for as long as somebody may answer.
        limits = {config.unchecked: at.now}
        if limit > config.unchecked:
            wait_us = config.patience_us if config.use_checker and alive else 0
            limits[limit] = at.now + wait_us
        for limit, earliest in limits.items():
            plan = direct_plan(
                self.atlas,
                at.active,
                at.follower,
                at.goal,
                at.now,
                limit,
                earliest,
                state.vetoes,
            )
            if plan is not None:
                plans.append(plan)
        wanted = at.goal.onset_utime
        return min(plans, key=lambda plan: abs(plan.onset_utime - wanted), default=None)

    def _is_void(self, chosen: Chosen, at: Situation) -> bool:
        # "At once" is now in every tick: what is wanted then has not moved.
        moved = max(chosen.goal_utime, at.now) - max(at.goal.onset_utime, at.now)
        return (
            chosen.key != at.key
            or chosen.plan.hop.to_skill != at.goal.skill.name
            or abs(moved) > GOAL_MOVED_US
            or chosen.plan.hop.start_utime < at.now - TICK_US
        )

    def _maybe_ask(self, at: Situation, chosen: Chosen, out: Hop | None) -> None:
        config, state = self.config, self.state
        if chosen.query_id or not config.use_checker:
            return
        start = chosen.plan.hop.start_utime
        if start <= at.now + TICK_US // 2:
            return  # decided in this tick: no answer could come in time
        last = start if out is None else min(start, max(out.start_utime, at.now))
        if at.now < min(last, start) - max(config.ask_ahead_us, config.patience_us):
            return
        state.queries += 1
        chosen.query_id = state.queries
        # Announced: answered while the way through stand is open. At once: before its start.
        hurried = last - at.now <= config.patience_us + TICK_US
        chosen.deadline_utime = start if hurried else last
        count = config.hurried_rollouts if hurried else config.rollouts
        self.question = Question(chosen.query_id, chosen.deadline_utime, count, chosen)
        self._say(skill_status_t.PLANNING, chosen, f"atlas {chosen.plan.bound:.1%}, checking")

    # ------------------------------------------------------------------ otherwise

    def _way_out(self, at: Situation, rule: Hop | None) -> Hop | None:
        """Return the hop into stand from which the goal is still reached, or None in stand."""
        if at.active.name == "stand":
            return None
        return rule if at.goal.skill.name == "stand" else self._halt(at)

    def _halt(self, at: Situation) -> Hop | None:
        """Return the hop into stand, in time for the goal if there is time."""
        goal = at.goal
        blend = FOOTWORK_BLEND_TICKS if enters_at_zero(goal.skill) else PLANTED_BLEND_TICKS
        lead = half_us(blend) + STAND_HOLD_TICKS * TICK_US + half_us(PLANTED_BLEND_TICKS)
        onset = max(goal.onset_utime - lead, 0) if goal.onset_utime > at.now else 0
        halt = Goal(self.stand, PhaseLine(at.now, 0.0, 1.0), onset)
        limit = self.config.checked
        plan = direct_plan(self.atlas, at.active, at.follower, halt, at.now, limit, at.now)
        if plan is not None:
            return plan.hop
        return next_hop(at.active, at.follower, at.still, halt, at.now, at.balance, at.alone_us)

    def _veto(self, chosen: Chosen, reason: str, now: int) -> None:
        plan = chosen.plan
        self.state.veto_utime = now
        self.state.vetoes = (*self.state.vetoes, (plan.hop.to_skill, plan.mode, plan.exit_slot))
        self.state.chosen = None
        self._say(skill_status_t.PLANNING, chosen, f"not {plan.mode}: {reason}")

    def _say(self, state: int, chosen: Chosen, reason: str) -> None:
        plan = chosen.plan
        self.words.append(Word(state, "blended", reason, plan.onset_utime))
