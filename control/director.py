"""Directs the skills: which plays, which hop is next, when a request is answered."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from downbeat.control.allowed import uncertified
from downbeat.control.atlas import Atlas
from downbeat.control.errors import ControlError
from downbeat.control.observation import RobotState
from downbeat.control.phase import TICK_US, PhaseLine
from downbeat.control.player import Blend, Playback, heading_of, mix, start_playback
from downbeat.control.policy import SkillLibrary
from downbeat.control.prover import ProofConfig, Prover, Situation
from downbeat.control.requests import Request, RequestBook
from downbeat.control.skill import JointTargets, SkillOutput
from downbeat.control.transitions import (
    Goal,
    Hop,
    half_us,
    is_planted,
    walk_stop_lead_us,
)
from downbeat.lcm_types import control_status_t, skill_request_t, skill_status_t
from downbeat.policies.manifest import SkillManifest
from downbeat.runtime.errors import one_of

STATE_FIELDS = (
    "playback",
    "blend",
    "_plan",
    "_coming",
    "_ends_utime",
    "_alone_since_utime",
    "_recovers_until_utime",
    "_closed_reason",
)
OWN_SOURCE = -1
"""Source of requests that the director makes itself: back to stand."""
RESUME_US = 2_500_000
IDLE_STAND_US = 1_500_000
"""With nothing running, a gap this long before the next request is spent in stand."""
RECOVERY_US = 1_500_000
"""After a catch nothing else is tried for this long."""


@dataclass(frozen=True, slots=True)
class Frame:
    """What one tick of playing computed.

    Attributes:
        parts: (skill name, output) of each skill in play, incoming first.
        targets: The mixed targets.
    """

    parts: tuple[tuple[str, SkillOutput], ...]
    targets: JointTargets


OWN_FALLBACKS = ("walk", "stand")
"""Best first; measured (docs/safety.md)."""


class Director:
    """Playback, blends and the request book; a pure state machine stepped once per tick."""

    def __init__(
        self,
        library: SkillLibrary,
        fallback: str = "",
        atlas: Atlas | None = None,
        proof: ProofConfig | None = None,
    ) -> None:
        """Prepare an idle director.

        Args:
            library: What may be played.
            fallback: Skill that catches a fall; empty: the best of our own, see docs/safety.md.
            atlas: Proven changes of skill; None: the measured rules alone decide.
            proof: How sure a change must be.

        Raises:
            ControlError: The fallback skill is not in the library.
        """
        fallback = fallback or next(name for name in OWN_FALLBACKS if name in library)
        if fallback not in library:
            raise ControlError(
                f"The fallback skill '{fallback}' is unknown; skills are {one_of(library.names)} "
                "(control: fallback)."
            )
        self.library = library
        self.fallback = fallback
        learned = library[fallback].manifest.policy is not None
        self.balance = fallback if learned else ""
        self.book = RequestBook(library.__contains__, library.names, self._safe_rate)
        stand = library["stand"].manifest
        self.prover = Prover(atlas or Atlas(), stand, proof or ProofConfig())
        self.playback: Playback | None = None
        self.blend: Blend | None = None
        self._plan = ""
        self._coming: Request | None = None
        self._ends_utime = 0
        self._alone_since_utime = 0
        self._recovers_until_utime = 0
        self._closed_reason = ""

    def _safe_rate(self, skill: str, rate: float) -> float:
        """Return the rate nearest to the wanted one at which a skill is certified."""
        if skill not in self.library:
            return rate
        manifest = self.library[skill].manifest
        low, high = manifest.tempo_range_bpm
        if manifest.bpm <= 0.0 or high <= 0.0:
            return rate
        return min(max(rate, low / manifest.bpm), high / manifest.bpm)

    @property
    def mode(self) -> int:
        """The control mode that the skills in play amount to."""
        if self._recovers_until_utime:
            return control_status_t.FALLBACK
        if self.blend is not None:
            return control_status_t.TRANSITION
        standing = self.playback is None or self.playback.name == "stand"
        return control_status_t.STAND if standing else control_status_t.SKILL

    @property
    def playing(self) -> tuple[SkillManifest, ...]:
        """The skills in play, incoming first."""
        if self.playback is None:
            return ()
        own = self.playback.skill.manifest
        return (own,) if self.blend is None else (own, self.blend.outgoing.skill.manifest)

    def receive(
        self, msg: skill_request_t, now: int, tick: int, on_hardware: bool, refusal: str = ""
    ) -> None:
        """Take one SKILL_REQUEST; every answer is a status.

        Args:
            msg: The request.
            now: [us].
            tick: Tick number.
            on_hardware: Only certified skills may run.
            refusal: Why nothing may be started now; empty: it may.
        """
        if msg.operation in (skill_request_t.START, skill_request_t.REPLACE):
            reason = refusal or self._closed_reason
            if on_hardware and not reason and msg.skill in self.library:
                reason = uncertified(self.library[msg.skill].manifest)
            if reason:
                self.book.refuse(msg, now, tick, reason)
                return
        self.book.receive(msg, now, tick)

    def close(self, reason: str) -> None:
        """End what runs the normal way and refuse skills, or (empty reason) open again."""
        if reason and not self._closed_reason:
            self.book.abort_all(reason)
        self._closed_reason = reason

    @property
    def can_catch(self) -> bool:
        """Whether handing over to the fallback skill helps against a fall.

        Measured (docs/safety.md): an imported balance policy catches out of anything; our own walk
        catches some of the falls from planted feet, and none from footwork.
        """
        return bool(self.balance) or all(is_planted(manifest) for manifest in self.playing)

    def catch(self, reason: str, state: RobotState, now: int) -> None:
        """A fall is coming: the fallback skill takes over, if that helps."""
        if self.can_catch:
            self.fall_back(reason, state, now, self.fallback)

    def fall_back(self, reason: str, state: RobotState, now: int, skill: str = "") -> None:
        """Drop everything: another skill acts from this tick on, with a memory of its own.

        Args:
            reason: For those whose requests are aborted.
            state: The robot.
            now: [us].
            skill: Who takes over; empty: the balance policy, or our stand without one.
        """
        name = skill or self.balance or "stand"
        if self._recovers_until_utime and self.playback is not None:
            return  # it is at work already
        self.book.abort_all(reason)
        self._coming = None
        self._plan = ""
        self.blend = None
        self._alone_since_utime = now
        self._recovers_until_utime = now + RECOVERY_US
        hop, line = Hop(now, name, 0), PhaseLine(now, 0.0, 1.0)
        self.playback = start_playback(self.library[name], hop, line, state, now, 0)

    def start(self, state: RobotState, now: int) -> None:
        """Begin with the stand skill."""
        hop = Hop(now, "stand", 0)
        line = PhaseLine(now, 0.0, 1.0)
        self.playback = start_playback(self.library["stand"], hop, line, state, now, 0)

    def stop(self, reason: str) -> None:
        """End everything at once; the book's requests are aborted."""
        self.book.abort_all(reason)
        self.playback = None
        self.blend = None
        self._coming = None
        self._plan = ""
        self._recovers_until_utime = 0

    # ------------------------------------------------------------------ scheduling

    def update(self, state: RobotState, now: int) -> None:
        """Start the next hop when it is due."""
        self.prover.question = None
        self.book.expire(now)
        playback = self.playback
        if playback is None:
            return
        if self._recovers_until_utime > now:
            return
        self._recovers_until_utime = 0
        self._follow_retimes(playback)
        if self.blend is not None and self.blend.is_over:
            self.blend = None
            self._alone_since_utime = now
        if self.blend is not None:
            return
        request = self._wanted(playback, now)
        if request is None:
            return
        goal = Goal(self.library[request.skill].manifest, request.line, request.onset_utime)
        if goal.skill.name == playback.name:
            self._continue_same(request, playback, now)
            return
        self._slow_down(playback, goal, now)
        still = playback.velocity is None or playback.velocity.is_still
        situation = Situation(
            playback.skill.manifest,
            playback.follower,
            still,
            goal,
            request.key,
            now,
            self.balance,
            now - self._alone_since_utime,
        )
        hop = self.prover.next(situation)
        self._say_words(request)
        if hop is not None and hop.start_utime <= now + TICK_US // 2:
            self._start_hop(hop, request, playback, state, now)

    def _say_words(self, request: Request) -> None:
        """Tell the asker what the prover decided."""
        words, self.prover.words = self.prover.words, []
        if request.key[0] == OWN_SOURCE:
            return
        for word in words:
            self.book.say(
                request,
                word.state,
                planned_start_utime=word.onset_utime,
                plan=word.plan,
                reason=word.reason,
            )

    @staticmethod
    def _slow_down(playback: Playback, goal: Goal, now: int) -> None:
        """Bring a walk to marching on the spot in time for its end."""
        if playback.velocity is not None and now >= goal.onset_utime - walk_stop_lead_us(1.0):
            playback.velocity.wanted[:] = 0.0

    def _wanted(self, playback: Playback, now: int) -> Request | None:
        """Return the request to work towards: the next one, the interrupted one, or stand."""
        active = self.book.active
        if active is not None and 0 < self._ends_utime <= now:
            self.book.say(active, skill_status_t.DONE)
            self.book.active = active = None
        head = self.book.head()
        if head is not None and (active is not None or head.onset_utime - now < IDLE_STAND_US):
            return head
        if active is not None and playback.request_id != active.key[1]:
            # Its successor was cancelled on the way. Most likely another one follows at once;
            # only if none does, go back.
            return active if now - self._alone_since_utime > RESUME_US else None
        if active is None and playback.name != "stand":
            line = PhaseLine(now, 0.0, 1.0)
            return Request((OWN_SOURCE, 0), "stand", 0, now, 0, line, 0.0, (0.0, 0.0, 0.0), 0)
        return head

    def _continue_same(self, request: Request, playback: Playback, now: int) -> None:
        """The wanted skill runs already: adopt its new phase line and command at its onset."""
        if now + TICK_US // 2 < request.onset_utime:
            return
        playback.follower.retime(request.line)
        if request.key[0] == OWN_SOURCE:
            return
        playback.request_id = request.key[1]
        self._activate(request, playback, now)
        self._plan = ""  # nothing changes but the phase line
        self._say_running(request, now)

    def _start_hop(
        self, hop: Hop, request: Request, outgoing: Playback, state: RobotState, now: int
    ) -> None:
        final = hop.to_skill == request.skill
        own = request.key[0] == OWN_SOURCE
        line = request.line if final else PhaseLine(now, 0.0, 1.0)
        request_id = request.key[1] if final else 0
        skill = self.library[hop.to_skill]
        playback = start_playback(skill, hop, line, state, now, request_id)
        self.playback = playback
        self.blend = Blend(outgoing, hop)
        if own:
            return
        onset = now + half_us(hop.blend_ticks)
        if not final:
            self._plan = "via_stand"
            said, onset = skill_status_t.PRIMING, request.onset_utime
        else:
            self._plan = self._plan or "blended"
            self._activate(request, playback, now)
            self._coming = request
            said = skill_status_t.BLENDING
        self.book.say(request, said, planned_start_utime=onset, plan=self._plan)

    def _activate(self, request: Request, playback: Playback, now: int) -> None:
        self.book.activate(request)
        manifest = playback.skill.manifest
        self._ends_utime = 0
        if request.duration_s > 0.0:
            self._ends_utime = max(request.onset_utime, now) + round(request.duration_s * 1e6)
        elif not manifest.loop:
            self._ends_utime = now + round(manifest.duration_s / request.line.rate * 1e6)
        if playback.velocity is not None:
            playback.velocity.wanted[:] = request.velocity

    def _follow_retimes(self, playback: Playback) -> None:
        active = self.book.active
        if active is not None and active.key[1] == playback.request_id:
            playback.follower.retime(active.line)

    def _say_running(self, request: Request, now: int) -> None:
        phase = math.nan if self.playback is None else self.playback.follower.wrapped_s
        state = skill_status_t.RUNNING
        self.book.say(request, state, phase_s=phase, onset_utime=now, plan=self._plan)
        self._coming = None
        self._plan = ""
        self._recovers_until_utime = 0

    # ------------------------------------------------------------------ playing

    def play(self, state: RobotState, now: int) -> Frame | None:
        """Run the active skill, or both during a blend."""
        playback, blend = self.playback, self.blend
        if playback is None:
            return None
        if self._coming is not None and (blend is None or blend.weight >= 0.5):
            self._say_running(self._coming, now)
        heading = heading_of(state)
        incoming = playback.step(state, heading)
        if blend is None:
            return Frame(((playback.name, incoming),), incoming.targets)
        outgoing = blend.outgoing.step(state, heading)
        mixed = mix(outgoing.targets, incoming.targets, blend.weight, blend.hop, blend.tick)
        return Frame(((playback.name, incoming), (blend.outgoing.name, outgoing)), mixed)

    def end_tick(self, now: int) -> None:
        """Advance phases and blend; called after the status of the tick was taken."""
        if self.playback is not None:
            self.playback.advance(now)
        if self.blend is not None:
            self.blend.outgoing.advance(now)
            self.blend.tick += 1

    def fill_status(self, status: control_status_t) -> None:
        """Write what plays into CONTROL_STATUS."""
        status.phase_s = 0.0
        status.phase_rate = 1.0
        if self.playback is None:
            return
        status.skill = self.playback.name
        status.phase_s = self.playback.follower.wrapped_s
        status.phase_rate = self.playback.follower.rate
        status.request_id = self.playback.request_id
        status.blend_weight = 1.0
        if self.blend is not None:
            status.previous_skill = self.blend.outgoing.name
            status.blend_weight = float(np.clip(self.blend.weight, 0.0, 1.0))

    # ------------------------------------------------------------------ snapshot

    def to_state(self) -> dict[str, Any]:
        """Return everything that is remembered between two ticks."""
        return {
            **{name: getattr(self, name) for name in STATE_FIELDS},
            "pending": list(self.book.pending),
            "active": self.book.active,
            "prover": self.prover.state,
        }

    def from_state(self, values: Mapping[str, Any]) -> None:
        """Restore what `to_state` returned."""
        for name in STATE_FIELDS:
            setattr(self, name, values[name])
        self.book.pending = values["pending"]
        self.book.active = values["active"]
        self.prover.state = values["prover"]
        self.prover.words = []
        self.book.changes = []
