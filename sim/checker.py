"""The checker process: simulates a plan from where the robot is, before control makes it.

It answers TRANSITION_QUERY with TRANSITION_VERDICT within the query's deadline: with whatever
number of rollouts is done by then and the bound that they support. It runs at idle priority; it may
be killed at any time, and control then relies on the atlas alone.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from hashlib import blake2b
from typing import Any

import numpy as np

from downbeat.control.atlas import Atlas
from downbeat.control.prover import ProofConfig
from downbeat.control.verdicts import is_refused
from downbeat.lcm_types import transition_query_t, transition_verdict_t
from downbeat.policies.manifest import SkillManifest
from downbeat.runtime.bus import Bus
from downbeat.runtime.errors import DownbeatError
from downbeat.sim.batch.engine import EngineName, batch_model, open_engine
from downbeat.sim.batch.outcome import Outcome, join_outcomes
from downbeat.sim.batch.perturb import BLOCK, Draws, Profile, draw_block, load_profile
from downbeat.sim.batch.proof import fixed_upper_bound
from downbeat.sim.batch.rehearsal import Rehearsal, perturbed_start, rehearse
from downbeat.sim.batch.script import script_of
from downbeat.sim.batch.states import standing_start

SMALLEST_CHUNK = 8
"""Rollouts per call of the engine when time is short; with time they all run together."""
MAX_ROLLOUTS = 256
CHECK_SEED = 1
"""Robots of the sweep have seed 0."""
WARM_UP_ROLLOUTS, WARM_UP_TICKS = 16, 25
HEADROOM = 1.2
"""A chunk is begun when this many times its usual duration is left."""
SETTLE_S = 1.0
"""Robots that have calmed down this long after the onset are not simulated further."""
ANSWER_MARGIN_US = 30_000
"""Kept free before the deadline for the way back."""
LOCKSTEP_LATENCY_US = 240_000
"""How long 32 rollouts take in simulated time; measured on 2 cores (`downbeat bench check`)."""

log = logging.getLogger("downbeat.sim")


@dataclass(frozen=True)
class Answer:
    """What a check found.

    Attributes:
        outcome: Of the rollouts that were done in time; None: none were.
        compute_us: Time spent.
    """

    outcome: Outcome | None
    compute_us: int


class _OutOfTimeError(Exception):
    """The deadline came in the middle of a chunk."""


class Checker:
    """Checks plans; pure but for the clock that tells it when to stop."""

    def __init__(
        self,
        manifests: Mapping[str, SkillManifest],
        atlas: Atlas,
        proof: ProofConfig,
        threads: int = 0,
        engine: EngineName = "native",
    ) -> None:
        """Open the engine and every skill.

        Args:
            manifests: Whatever may be played.
            atlas: What control has.
            proof: What control asks for.
            threads: Of the native engine; 0: one per core.
            engine: Who simulates.

        Raises:
            SimError: The engine cannot run here.
        """
        self.manifests, self.atlas, self.proof = dict(manifests), atlas, proof
        self.engine: Any = open_engine(engine, manifests, threads)
        for name in self.manifests:
            self.engine.skill(name)
        self.model_hash = model_hash()
        self._rollout_tick_s = 0.0
        """Duration of one tick of one rollout, as measured last."""
        self._warm_up()

    def _warm_up(self) -> None:
        """Allocate everything, and learn how fast this machine is."""
        stand = self.manifests["stand"]
        script = script_of(stand, np.zeros(1), np.ones(1), (), WARM_UP_TICKS)
        draws = robots_of(load_profile(), 0, WARM_UP_ROLLOUTS)
        for _ in range(3):
            began = time.perf_counter()
            self.engine.run(standing_start(draws.count), script, draws, (0,))
            spent = time.perf_counter() - began
            self._rollout_tick_s = spent / (WARM_UP_ROLLOUTS * WARM_UP_TICKS)

    def check(
        self, query: transition_query_t, time_left_s: Callable[[], float] = lambda: 1e9
    ) -> Answer:
        """Simulate a query's plan.

        Args:
            query: The question.
            time_left_s: Until an answer must be on its way [s].

        Raises:
            DownbeatError: The query makes no sense here.
        """
        began = time.perf_counter()
        profile = load_profile(query.profile)
        plan = rehearse(query, self.manifests, self.atlas, self.proof)
        wanted = min(max(int(query.num_rollouts), 1), MAX_ROLLOUTS)
        parts: list[Outcome] = []
        done = 0
        while done < wanted:
            count = self._affordable(wanted - done, plan.script.ticks, time_left_s())
            if count == 0:
                break
            draws = robots_of(profile, done % BLOCK, count)
            try:
                part = self._run(query, plan, profile, draws, done, time_left_s)
            except _OutOfTimeError:
                break
            parts.append(part)
            done += count
        outcome = join_outcomes(parts) if parts else None
        return Answer(outcome, round((time.perf_counter() - began) * 1e6))

    def _affordable(self, wanted: int, ticks: int, left_s: float) -> int:
        """Return how many of the wanted rollouts can be done in the time that is left."""
        count = wanted
        while count * ticks * self._rollout_tick_s * HEADROOM > left_s:
            if count <= SMALLEST_CHUNK:
                return 0
            count = max(count // 2, SMALLEST_CHUNK)
        return count

    def _run(
        self,
        query: transition_query_t,
        plan: Rehearsal,
        profile: Profile,
        draws: Draws,
        first: int,
        time_left_s: Callable[[], float],
    ) -> Outcome:
        def watch(tick: int, _ids: Any, _here: Any) -> None:
            if tick % 5 == 0 and time_left_s() <= 0.0:
                raise _OutOfTimeError

        began = time.perf_counter()
        seed = (int(query.seed) & 0xFFFFFFFF, first)
        start = perturbed_start(query, plan, profile, draws.count, seed[0] + 7919 * first)
        settle = max(plan.onset_tick, 0) + round(SETTLE_S * 50)
        look = watch if self.engine.name == "native" else None  # MJX would record every tick
        outcome = self.engine.run(start, plan.script, draws, seed, look, settle_tick=settle)
        spent = (time.perf_counter() - began) / (draws.count * plan.script.ticks)
        self._rollout_tick_s = 0.5 * (self._rollout_tick_s + spent)
        return outcome

    def verdict(self, query: transition_query_t, answer: Answer) -> transition_verdict_t:
        """Return the message that answers a query."""
        msg: Any = transition_verdict_t()
        msg.query_id = query.query_id
        msg.compute_us = answer.compute_us
        msg.model_hash = self.model_hash
        msg.verdict, msg.p_fall_upper = transition_verdict_t.TIMED_OUT, 1.0
        outcome = answer.outcome
        if outcome is None:
            return msg
        fallen, count = outcome.num_fallen, outcome.count
        refused = is_refused(self.proof.checked, fallen, count)
        msg.verdict = transition_verdict_t.UNSAFE if refused else transition_verdict_t.SAFE
        msg.num_rollouts, msg.num_fallen = count, fallen
        msg.p_fall_upper = fixed_upper_bound(fallen, count)
        msg.min_margin = float(np.clip(outcome.min_margin.min(), -10.0, 10.0))
        msg.max_tilt = float(outcome.max_tilt.max())
        msg.max_torque_ratio = float(outcome.max_torque_ratio.max())
        return msg


def lockstep_latency_us(rollouts: int) -> int:
    """Return how long a check takes in simulated time [us]: a fixed part and its rollouts."""
    return round(LOCKSTEP_LATENCY_US * (0.25 + 0.75 * rollouts / 32) / 20_000) * 20_000


@lru_cache(maxsize=64)
def robots_of(profile: Profile, first: int, count: int) -> Draws:
    """Return the robots of every check: the same ones, so that their models are made only once."""
    return draw_block(profile, CHECK_SEED, 0).take(np.arange(first, first + count) % BLOCK)


def model_hash() -> int:
    """Return a hash of the model that is simulated."""
    model = batch_model()
    digest = blake2b(digest_size=8)
    for name in ("body_mass", "body_inertia", "jnt_range", "actuator_gainprm", "geom_size"):
        digest.update(np.ascontiguousarray(getattr(model, name)).tobytes())
    return int.from_bytes(digest.digest(), "big", signed=True)


class CheckerNode:
    """Node "checker"."""

    name = "checker"
    period_us = 20_000

    def __init__(self, bus: Bus, checker: Checker, is_simulated_time: bool = False) -> None:
        """Wire the process.

        Args:
            bus: Endpoint of the process "checker".
            checker: Loaded and warm.
            is_simulated_time: In lockstep the clock stands while it computes: every rollout is
                done, and the answer goes out when it would have come on a real machine.
        """
        self._bus, self._checker = bus, checker
        self._lockstep = is_simulated_time
        self._waiting: list[tuple[int, transition_verdict_t]] = []
        bus.subscribe("TRANSITION_QUERY")

    def step(self, utime: int) -> None:
        """Answer what was asked."""
        self._bus.pump()
        for received in self._bus.take("TRANSITION_QUERY"):
            self._waiting.append(self._answer(received.msg, utime))
        while self._waiting and self._waiting[0][0] <= utime:
            _, verdict = self._waiting.pop(0)
            verdict.header.utime = self._bus.clock.utime()
            self._bus.publish("TRANSITION_VERDICT", verdict)

    def _answer(self, query: transition_query_t, utime: int) -> tuple[int, transition_verdict_t]:
        """Return when to answer a query, and what."""
        left_us = int(query.deadline_utime) - utime - ANSWER_MARGIN_US
        began = time.monotonic()

        def time_left_s() -> float:
            if self._lockstep:
                return 1e9
            return left_us * 1e-6 - (time.monotonic() - began)

        try:
            answer = self._checker.check(query, time_left_s)
        except DownbeatError as error:
            log.warning("a query cannot be checked: %s", error)
            answer = Answer(None, 0)
        if not self._lockstep:
            return utime, self._checker.verdict(query, answer)
        took_us = lockstep_latency_us(int(query.num_rollouts))
        answer = Answer(answer.outcome, took_us)
        return utime + took_us, self._checker.verdict(query, answer)

    def close(self) -> None:
        """Nothing to release."""
