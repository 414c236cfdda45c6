"""From control's own memory to a script: the plan is played forward by control's own director.

The query holds the serialised director. Restored around skills that compute nothing, it walks
through its plan tick by tick (exit, blend, holds, a stop in stand, whatever comes), and what it
plays when, at which phase and weight, is the script of the rollouts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from downbeat.control.atlas import Atlas
from downbeat.control.director import Director
from downbeat.control.observation import RobotState
from downbeat.control.phase import TICK_US
from downbeat.control.player import Playback
from downbeat.control.prover import ProofConfig
from downbeat.control.skill import F32, NUM_JOINTS, JointTargets, SkillMemory, SkillOutput
from downbeat.control.snapshot import from_bytes
from downbeat.lcm_types import transition_query_t
from downbeat.policies.manifest import SkillManifest
from downbeat.sim.batch.engine import Start
from downbeat.sim.batch.perturb import Profile
from downbeat.sim.batch.script import Script
from downbeat.sim.errors import SimError

F64 = NDArray[np.float64]
MAX_TICKS = 500


class _Silent:
    """A skill that computes nothing: only its manifest and its memory matter here."""

    def __init__(self, manifest: SkillManifest) -> None:
        self.manifest = manifest
        zeros = np.zeros(NUM_JOINTS, np.float32)
        self._output = SkillOutput(zeros, zeros, JointTargets(zeros, zeros, zeros))

    def begin(self, state: RobotState, phase_s: float) -> SkillMemory:
        """Return an empty memory."""
        return SkillMemory(np.zeros(0, np.float32))

    def step(
        self, memory: SkillMemory, state: RobotState, phase_s: float, command: F32
    ) -> SkillOutput:
        """Compute nothing."""
        return self._output


class SilentLibrary:
    """What a director needs to know about skills."""

    def __init__(self, manifests: Mapping[str, SkillManifest]) -> None:
        self._skills = {name: _Silent(manifest) for name, manifest in manifests.items()}

    def __contains__(self, name: str) -> bool:
        return name in self._skills

    def __getitem__(self, name: str) -> Any:
        return self._skills[name]

    @property
    def names(self) -> tuple[str, ...]:
        """Skill names, sorted."""
        return tuple(sorted(self._skills))


@dataclass(frozen=True)
class Rehearsal:
    """What is to be simulated.

    Attributes:
        script: From the query's tick on; shared by all rollouts.
        onset_tick: In which the goal has half the weight; -1: not within the script.
        playback: Of the skill that plays at the start, with its memory.
        sent: (29,) [rad] the targets of the tick before.
    """

    script: Script
    onset_tick: int
    playback: Playback
    sent: F32


def rehearse(
    query: transition_query_t,
    manifests: Mapping[str, SkillManifest],
    atlas: Atlas,
    proof: ProofConfig,
) -> Rehearsal:
    """Play a query's plan forward.

    Raises:
        SimError: The query's memory cannot be restored here.
    """
    library: Any = SilentLibrary(manifests)
    values = from_bytes(bytes(query.control_state), library)
    director = Director(library, atlas=atlas, proof=proof)
    director.from_state(values["director"])
    chosen = director.prover.state.chosen
    if director.playback is None or chosen is None:
        raise SimError(
            f"TRANSITION_QUERY {query.query_id} holds no plan: nothing plays, or nothing "
            "was chosen."
        )
    chosen.is_safe = True
    first = director.playback
    state = _estimate(query)
    track = _Track(first)
    onset, now, tick = -1, int(query.header.utime), 0
    after = round(query.horizon_s * 50)
    while tick < MAX_TICKS and (onset < 0 or tick < onset + after):
        director.update(state, now)
        track.note(director)
        director.play(state, now)
        director.end_tick(now)
        playing = director.playback
        if onset < 0 and playing is not None and playing.name == query.to_skill:
            blend = director.blend
            if blend is None or blend.tick > blend.hop.blend_ticks // 2:
                onset = tick
        now += TICK_US
        tick += 1
    sent = values["sent"]
    if sent is None:
        sent = np.asarray(query.qpos[7:], np.float32)
    return Rehearsal(track.script(), onset, first, np.asarray(sent, np.float32))


class _Track:
    """Notes what a director plays."""

    def __init__(self, first: Playback) -> None:
        self._order: list[Playback] = [first]
        self._starts = [-1]
        self._rows: list[dict[int, tuple[float, float, float]]] = []
        self._velocity: dict[int, F32] = {}

    def note(self, director: Director) -> None:
        """Note one tick, after the director has decided and before it plays."""
        playback, blend = director.playback, director.blend
        assert playback is not None
        row = {}
        if blend is None:
            row[self._index(playback)] = (playback.follower.wrapped_s, 1.0, 1.0)
        else:
            rest = legs = blend.weight
            if blend.hop.style == "legs_hard":
                legs = float(blend.tick >= blend.hop.blend_ticks // 2)
            out = blend.outgoing
            row[self._index(out)] = (out.follower.wrapped_s, 1.0 - legs, 1.0 - rest)
            row[self._index(playback)] = (playback.follower.wrapped_s, legs, rest)
        self._rows.append(row)

    def _index(self, playback: Playback) -> int:
        known = [one is playback for one in self._order]
        if not any(known):
            self._order.append(playback)
            self._starts.append(len(self._rows))
            known.append(True)
        index = known.index(True)
        if playback.velocity is not None:
            self._velocity[index] = playback.velocity.wanted.copy()
        return index

    def script(self) -> Script:
        """Return what was noted."""
        count, ticks = len(self._order), len(self._rows)
        phase = np.zeros((ticks, count, 1))
        weight = np.zeros((ticks, count, 2), np.float32)
        for tick, row in enumerate(self._rows):
            for index, (phase_s, legs, rest) in row.items():
                phase[tick, index] = phase_s
                weight[tick, index] = (legs, rest)
        velocity = np.zeros((count, 3), np.float32)
        for index, wanted in self._velocity.items():
            velocity[index] = wanted
        names = tuple(playback.name for playback in self._order)
        return Script(names, phase, weight, tuple(self._starts), velocity)


def _estimate(query: transition_query_t) -> RobotState:
    """Return the state of the query as a director reads it."""
    qpos, qvel = np.asarray(query.qpos, np.float32), np.asarray(query.qvel, np.float32)
    return RobotState(qpos[3:7], qvel[3:6], qpos[7:], qvel[6:])


# ---------------------------------------------------------------------- starts


def perturbed_start(
    query: transition_query_t, rehearsal: Rehearsal, profile: Profile, count: int, seed: int
) -> Start:
    """Return N robots around the estimated state, with control's memory of its skill."""
    rng = np.random.default_rng([seed & 0xFFFFFFFF, 0xE571])
    tilt, joint, joint_vel, speed, turn = profile.estimate
    qpos = np.tile(np.asarray(query.qpos, float), (count, 1))
    qvel = np.tile(np.asarray(query.qvel, float), (count, 1))
    qpos[:, 7:] += rng.uniform(-joint, joint, (count, NUM_JOINTS))
    qvel[:, 6:] += rng.uniform(-joint_vel, joint_vel, (count, NUM_JOINTS))
    qvel[:, :3] += rng.uniform(-speed, speed, (count, 3))
    qvel[:, 3:6] += rng.uniform(-turn, turn, (count, 3))
    qpos[:, 3:7] = _leaned(qpos[:, 3:7], rng.uniform(-tilt, tilt, (count, 2)))
    playback = rehearsal.playback
    memory = batch_memory(playback, count)
    start = Start(qpos, qvel, np.zeros_like(qvel), np.tile(rehearsal.sent, (count, 1)))
    start.memories[playback.name] = memory
    if playback.velocity is not None:
        start.steering[playback.name] = batch_steering(playback, count, qpos)
    return start


def _leaned(quat: F64, angles: F64) -> F64:
    """Return orientations turned by small angles (N, 2) about the world's x and y axes."""
    axis = np.concatenate([angles, np.zeros((len(angles), 1))], axis=1)
    w = np.ones((len(quat), 1))
    small = np.concatenate([w, 0.5 * axis], axis=1)
    small /= np.linalg.norm(small, axis=1, keepdims=True)
    scalar = small[:, :1] * quat[:, :1] - np.sum(small[:, 1:] * quat[:, 1:], 1, keepdims=True)
    vector = small[:, :1] * quat[:, 1:] + quat[:, :1] * small[:, 1:]
    vector += np.cross(small[:, 1:], quat[:, 1:])
    return np.concatenate([scalar, vector], axis=1)


def batch_memory(playback: Playback, count: int) -> dict[str, Any]:
    """Return control's memory of a skill for N robots; see `LearnedBatch.begin`."""
    manifest, memory = playback.skill.manifest, playback.memory
    spec = manifest.policy
    if spec is None:
        return {}

    def many(value: Any, dtype: Any = np.float32) -> Any:
        array = np.asarray(value, dtype)
        return np.broadcast_to(array, (count, *array.shape)).copy()

    tree: dict[str, Any] = {"action": many(memory.last_action)}
    for index, one in enumerate(spec.recurrent):
        tree[f"recurrent{index}"] = many(memory.recurrent[one.input])
    if spec.gait is not None:
        tree["gait"], tree["still"] = many(memory.gait_phase), many(memory.is_still, bool)
    if memory.alignment is not None:
        tree["turn"], tree["shift"] = many(memory.alignment.yaw), many(memory.alignment.shift)
    for number, one in enumerate(spec.inputs):
        for index, frames in enumerate(memory.histories.get(one.name, ())):
            tree[f"history{number}.{index}"] = many(frames)
    return tree


def batch_steering(playback: Playback, count: int, qpos: F64) -> dict[str, Any]:
    """Return control's memory of a velocity command for N robots; see `begin_steering`."""
    from downbeat.control.observation import yaw

    velocity = playback.velocity
    assert velocity is not None
    heading = float(yaw(qpos[0, 3:7])) if velocity.heading is None else velocity.heading
    target = heading if velocity.target_heading is None else velocity.target_heading
    return {
        "heading": np.full(count, heading),
        "target": np.full(count, target),
        "holds": np.full(count, velocity.target_heading is not None),
        "current": np.tile(np.asarray(velocity.current, np.float32), (count, 1)),
    }
