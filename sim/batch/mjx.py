"""The MJX engine: the whole closed loop in JAX, for a GPU; on a CPU only small batches are fun.

Needs mujoco, mujoco-mjx, jax, numpy and onnx, and nothing else. Skills, observations, noise widths,
delays, pushes and measures are those of the native engine; what differs is who integrates. Fallen
robots cannot be dropped from a batch of fixed shape: they are stood up again and not looked at.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from mujoco import batch as mujoco_batch
from mujoco import mjx
from numpy.typing import NDArray

from downbeat.catalog.robot import NUM_JOINTS
from downbeat.control.observation import RobotState, tilt, yaw
from downbeat.control.phase import TICK_S
from downbeat.control.rotations import quat_mul, quat_rotate_inverse
from downbeat.policies.manifest import SkillManifest
from downbeat.sim.batch.engine import (
    SUBSTEPS,
    Start,
    Watch,
    batch_model,
    check_versions,
    model_ids,
    tilt_limit,
)
from downbeat.sim.batch.onnx_jax import JaxGraph
from downbeat.sim.batch.outcome import NEVER, Outcome, capture_margin
from downbeat.sim.batch.perturb import PUSH_S, Draws
from downbeat.sim.batch.script import Script
from downbeat.sim.batch.skills import Array, BatchSkill, Network, batch_skill
from downbeat.sim.batch.states import standing_qpos
from downbeat.sim.batch.steering import begin_steering, steer
from downbeat.sim.batch.xla import calm_xla
from downbeat.sim.errors import SimError

calm_xla()
FALLEN_BELOW_M = 0.5
NOISE_PARTS = (3, 3, NUM_JOINTS, NUM_JOINTS, 3)
VARIED = (
    "body_mass",
    "body_inertia",
    "body_ipos",
    "geom_friction",
    "body_subtreemass",
    "body_invweight0",
    "dof_invweight0",
)
"""Model fields that differ from robot to robot, with those that follow from them."""
Tree = Any


def open_jax(manifest: SkillManifest, outputs: tuple[str, ...]) -> Network:
    """Open a network in JAX for N robots; see `skills.OpenNetwork`."""
    graph = JaxGraph(manifest.onnx_path, outputs)

    def one(feeds: Mapping[str, Array]) -> list[Array]:
        shaped = {name: feeds[name].reshape(graph.shapes[name]) for name in graph.inputs}
        return graph(shaped)

    def network(feeds: Mapping[str, Array]) -> list[Array]:
        return jax.vmap(one)({name: feeds[name] for name in graph.inputs})

    return network


@dataclass(frozen=True)
class _Loop:
    """What does not change in a compiled loop."""

    skills: tuple[BatchSkill, ...]
    start_tick: tuple[int, ...]
    tilt_limit: float
    records: bool


class MjxEngine:
    """Runs scripts with MJX; compiled once per set of skills, length and padded batch size."""

    name = "mjx"

    def __init__(
        self,
        manifests: Mapping[str, SkillManifest],
        impl: str = "jax",
        devices: tuple[Any, ...] = (),
    ) -> None:
        """Put the model on the device.

        Args:
            manifests: Whatever scripts will play.
            impl: "jax", or "warp" where warp-lang is installed.
            devices: The batch is split over them; none: all that JAX sees.

        Raises:
            SimError: The versions do not fit together, or the implementation is not there.
        """
        check_versions()
        self.manifests = dict(manifests)
        self.devices = tuple(devices) or tuple(jax.devices())
        self.host_model = batch_model(only_soles=True)
        try:
            self.model: Any = mjx.put_model(self.host_model, impl=impl)
        except (ImportError, RuntimeError, NotImplementedError, ValueError) as error:
            raise SimError(
                f"MJX has no implementation '{impl}' here ({str(error).splitlines()[0]}); "
                "'jax' always works, 'warp' needs warp-lang and an NVIDIA GPU."
            ) from error
        self.impl = impl
        self._skills: dict[str, BatchSkill] = {}
        self._compiled: dict[Any, Any] = {}

    def skill(self, name: str) -> BatchSkill:
        """Return a skill for many robots."""
        if name not in self._skills:
            self._skills[name] = batch_skill(self.manifests[name], open_jax)
        return self._skills[name]

    @cached_property
    def _sharding(self) -> NamedSharding:
        return NamedSharding(Mesh(np.array(self.devices), ("robots",)), PartitionSpec("robots"))

    # ------------------------------------------------------------------ running

    def run(
        self,
        start: Start,
        script: Script,
        draws: Draws,
        seed: tuple[int, ...],
        watch: Watch | None = None,
        last_tick: int | None = None,
        settle_tick: int | None = None,
    ) -> Outcome:
        """Simulate; see `NativeEngine.run`. Robots that have calmed down are simulated on."""
        count = start.count
        padded = self._padded(count)
        rows = np.minimum(np.arange(padded), count - 1)
        ticks = script.ticks if last_tick is None else min(last_tick, script.ticks)
        skills = tuple(self.skill(name) for name in script.skills)
        limit = tilt_limit([self.manifests[s] for s in script.skills])
        loop = _Loop(skills, script.start_tick, limit, watch is not None)
        inputs = self._inputs(start.take(rows), script, draws.take(rows), ticks, seed)
        key = (
            script.skills,
            script.start_tick,
            ticks,
            padded,
            watch is not None,
            script.phase_s.shape[2] > 1,
        )
        if key not in self._compiled:
            self._compiled[key] = jax.jit(partial(self._play, loop))
        final, recorded = self._compiled[key](inputs)
        if watch is not None:
            _show(watch, recorded, script, ticks, count)
        return _outcome(final, count)

    def _padded(self, count: int) -> int:
        """Return the batch size that is compiled for: few sizes, a multiple of the devices."""
        size = max(8, 1 << (count - 1).bit_length())
        devices = len(self.devices)
        return -(-size // devices) * devices

    def _inputs(
        self, start: Start, script: Script, draws: Draws, ticks: int, seed: tuple[int, ...]
    ) -> Tree:
        """Return everything that a compiled loop takes; robots are split over the devices."""
        robots = {
            "qpos": np.asarray(start.qpos, np.float32),
            "qvel": np.asarray(start.qvel, np.float32),
            "warmstart": np.asarray(start.warmstart, np.float32),
            "before": np.asarray(start.target, np.float32),
            "model": self._varied(draws),
            "stiffness": np.asarray(draws.stiffness_scale, np.float32)[:, None],
            "damping": np.asarray(draws.damping_scale, np.float32)[:, None],
            "delay": np.asarray(draws.delay_substeps, np.int32),
            "noise": np.concatenate(
                [np.repeat(draws.noise[:, i : i + 1], n, 1) for i, n in enumerate(NOISE_PARTS)], 1
            ).astype(np.float32),
            "push_s": np.asarray(draws.push_s, np.float32),
            "push_n": np.asarray(draws.push_n_s / PUSH_S, np.float32),
            "memories": {s: dict(m) for s, m in start.memories.items() if s == script.skills[0]},
            "steering": {s: dict(m) for s, m in start.steering.items() if s == script.skills[0]},
        }
        robots = jax.device_put(jax.tree.map(_single, robots), self._sharding)
        phase = np.asarray(script.phase_s[:ticks], np.float32)  # (T, S, N or 1)
        if phase.shape[2] > 1:
            width = len(start.qpos)
            phase = phase[:, :, np.minimum(np.arange(width), phase.shape[2] - 1)]
        numbers = np.random.default_rng([*seed, 0x3A]).integers(0, 2**31, 2)
        return {
            "robots": robots,
            "phase": phase,
            "weight": np.asarray(script.weight[:ticks], np.float32),
            "velocity": np.asarray(script.velocity, np.float32),
            "key": jax.random.key(int(numbers[0])),
        }

    def _varied(self, draws: Draws) -> dict[str, Any]:
        """Return the model fields of each robot, with the constants that follow from them."""
        count, model, ids = draws.count, self.host_model, model_ids()
        robots: Any = mujoco_batch.Batch(model, count)
        fields = {name: robots.expand(name) for name in VARIED}
        fields["body_mass"][:] = model.body_mass * draws.mass_scale[:, None]
        fields["body_inertia"][:] = model.body_inertia * draws.mass_scale[:, None, None]
        fields["body_ipos"][:, ids.torso] += draws.com_offset_m
        fields["geom_friction"][:, ids.floor_and_soles, 0] = draws.friction[:, None]
        robots.set_const()
        return {name: np.asarray(value, np.float32) for name, value in fields.items()}

    # ------------------------------------------------------------------ compiled

    def _play(self, loop: _Loop, inputs: Tree) -> tuple[Tree, Tree]:
        """Run all ticks of all robots; traced by JAX."""
        robots = inputs["robots"]
        count = robots["qpos"].shape[0]
        data = jax.vmap(self._data)(robots)
        memories, steering = _first_memories(loop, robots, data, inputs, count)
        carry = {
            "data": data,
            "memories": memories,
            "steering": steering,
            "before": robots["before"],
            "key": inputs["key"],
            "fell_tick": jnp.full(count, NEVER, jnp.int32),
            "max_tilt": jnp.zeros(count),
            "max_ratio": jnp.zeros(count),
            "min_margin": jnp.full(count, jnp.inf),
            "error": jnp.zeros(count),
        }
        ticks = inputs["phase"].shape[0]
        xs = (jnp.arange(ticks), inputs["phase"], inputs["weight"])
        final, recorded = jax.lax.scan(partial(self._tick, loop, robots, inputs), carry, xs)
        kept = ("fell_tick", "max_tilt", "max_ratio", "min_margin", "error")
        return {name: final[name] for name in kept}, recorded

    def _data(self, robot: Tree) -> Any:
        data = mjx.make_data(self.model)
        model = self.model.tree_replace(robot["model"])
        data = data.replace(
            qpos=robot["qpos"],
            qvel=robot["qvel"],
            ctrl=robot["before"],
            qacc_warmstart=robot["warmstart"],
        )
        return mjx.kinematics(model, data)

    def _tick(
        self, loop: _Loop, robots: Tree, inputs: Tree, carry: Tree, x: Tree
    ) -> tuple[Tree, Tree]:
        tick, phase, weight = x
        data = carry["data"]
        seen = {name: carry[name] for name in ("memories", "steering", "before", "fell_tick")}
        seen |= {"qpos": data.qpos, "qvel": data.qvel, "warmstart": data.qacc_warmstart}
        key, noise_key = jax.random.split(carry["key"])
        state = _measure(data, robots["noise"], noise_key)
        acted = _act(loop, carry, state, inputs, tick, phase, weight)
        since = tick * TICK_S - robots["push_s"]
        is_pushed = (since >= 0.0) & (since < PUSH_S)
        push = jnp.where(is_pushed[:, None], robots["push_n"], 0.0)
        step = jax.vmap(self._integrate, in_axes=(0, 0, 0, 0, 0, 0))
        gains = {
            "stiffness": acted["stiffness"][None] * robots["stiffness"],
            "damping": acted["damping"][None] * robots["damping"],
        }
        data = step(data, robots, carry["before"], acted["target"], gains, push)
        carry = {
            **carry,
            "key": key,
            "before": acted["target"],
            "memories": acted["memories"],
            "steering": acted["steering"],
        }
        carry = _judge(loop, carry, data, acted["reference"], tick)
        return carry, seen if loop.records else None

    def _integrate(
        self, data: Any, robot: Tree, before: Array, target: Array, gains: Tree, push: Array
    ) -> Any:
        """Four physics steps of one robot; the new targets come after its delay."""
        base = self.model
        gain = base.actuator_gainprm.at[:, 0].set(gains["stiffness"])
        bias = base.actuator_biasprm.at[:, 1].set(-gains["stiffness"])
        bias = bias.at[:, 2].set(-gains["damping"])
        model = base.tree_replace(
            {**robot["model"], "actuator_gainprm": gain, "actuator_biasprm": bias}
        )
        wrench = data.xfrc_applied.at[model_ids().torso, :2].set(push)
        data = data.replace(xfrc_applied=wrench)

        def substep(index: Array, now: Any) -> Any:
            ctrl = jnp.where(robot["delay"] > index, before, target)
            return mjx.step(model, now.replace(ctrl=ctrl))

        return jax.lax.fori_loop(0, SUBSTEPS, substep, data)


def _single(value: Any) -> Any:
    array = np.asarray(value)
    return array.astype(np.float32) if array.dtype == np.float64 else array


def _key_of(loop: _Loop, index: int) -> str:
    name = loop.skills[index].manifest.name
    return name if loop.start_tick[index] < 0 else f"{name}@{index}"


def _first_memories(
    loop: _Loop, robots: Tree, data: Any, inputs: Tree, count: int
) -> tuple[Tree, Tree]:
    """Return the memories of all skills; of those that begin later only the shape counts."""
    state = _measure(data, robots["noise"] * 0.0, inputs["key"])
    memories: dict[str, Any] = {}
    steering: dict[str, Any] = {}
    for index, skill in enumerate(loop.skills):
        key = _key_of(loop, index)
        phase = inputs["phase"][0, index]
        command = jnp.zeros((count, 3), jnp.float32)
        given = robots["memories"].get(key)
        memories[key] = skill.begin(state, phase, command, jnp) if given is None else given
        if skill.manifest.command is not None:
            heading = yaw(state.base_quat_wxyz, jnp)
            steering[key] = robots["steering"].get(key, begin_steering(heading, jnp))
    return memories, steering


def _measure(data: Any, width: Array, key: Array) -> RobotState:
    """Return what N robots measure."""
    qpos, qvel = data.qpos, data.qvel
    noise = width * jax.random.uniform(key, width.shape, minval=-1.0, maxval=1.0)
    quat = qpos[:, 3:7]
    half = 0.5 * noise[:, :3]
    small = jnp.concatenate([jnp.ones_like(half[:, :1]), half], axis=-1)
    turned = quat_mul(quat, small, jnp)
    return RobotState(
        turned / jnp.linalg.norm(turned, axis=-1, keepdims=True),
        qvel[:, 3:6] + noise[:, 3:6],
        qpos[:, 7:] + noise[:, 6:35],
        qvel[:, 6:] + noise[:, 35:64],
        quat_rotate_inverse(quat, qvel[:, :3], jnp) + noise[:, 64:67],
        qpos[:, :3],
    )


def _act(
    loop: _Loop,
    carry: Tree,
    state: RobotState,
    inputs: Tree,
    tick: Array,
    phase: Array,
    weight: Array,
) -> Tree:
    """Ask every skill of the script and mix: all of them are live in every tick."""
    count = state.joint_pos.shape[0]
    target = jnp.zeros((count, NUM_JOINTS))
    reference = jnp.zeros((count, NUM_JOINTS))
    stiffness, damping = jnp.zeros(NUM_JOINTS), jnp.zeros(NUM_JOINTS)
    memories, steering = dict(carry["memories"]), dict(carry["steering"])
    lead = jnp.argmax(weight[:, 1])
    is_leg = np.arange(NUM_JOINTS) < 12
    for index, skill in enumerate(loop.skills):
        key = _key_of(loop, index)
        begins = tick == loop.start_tick[index]
        command = jnp.zeros((count, 3), jnp.float32)
        if skill.manifest.command is not None:
            heading = yaw(state.base_quat_wxyz, jnp)
            memory = _choose(begins, begin_steering(heading, jnp), steering[key])
            wanted = inputs["velocity"][index]
            steering[key], command = steer(skill.manifest, memory, heading, wanted, jnp)
        fresh = skill.begin(state, phase[index], command, jnp)
        memory = _choose(begins, fresh, memories[key])
        memories[key], output = skill.step(memory, state, phase[index], command, jnp)
        share = jnp.where(is_leg, weight[index, 0], weight[index, 1])
        target = target + share * output.joint_pos
        stiffness = stiffness + share * skill.joint_stiffness
        damping = damping + share * skill.joint_damping
        reference = jnp.where(lead == index, output.reference, reference)
    return {
        "target": target,
        "reference": reference,
        "stiffness": stiffness,
        "damping": damping,
        "memories": memories,
        "steering": steering,
    }


def _choose(condition: Array, new: Tree, old: Tree) -> Tree:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b).astype(b.dtype), new, old)


def _judge(loop: _Loop, carry: Tree, data: Any, reference: Array, tick: Array) -> Tree:
    """Update the measures; stand fallen robots up again, so that no lane diverges."""
    ids = model_ids()
    lean = tilt(data.qpos[:, 3:7], jnp)
    stands = carry["fell_tick"] == NEVER
    down = ~(data.qpos[:, 2] > FALLEN_BELOW_M) | ~(lean <= loop.tilt_limit)
    down = down | ~jnp.all(jnp.isfinite(data.qvel), axis=-1)
    fell_tick = jnp.where(stands & down, tick.astype(jnp.int32), carry["fell_tick"])
    feet = np.array(ids.feet)
    turn = data.xmat[:, feet].reshape((-1, 2, 3, 3))
    com, com_vel = data.sensordata[:, :3], data.sensordata[:, 3:6]
    margin = capture_margin(com, com_vel, data.xpos[:, feet], turn, jnp)
    ratio = jnp.max(jnp.abs(data.actuator_force) / ids.torque_limit.astype(np.float32), axis=-1)
    off = data.qpos[:, 7:] - reference
    error = jnp.sqrt(jnp.mean(off * off, axis=-1))
    gone = (fell_tick != NEVER)[:, None]
    rest = jnp.asarray(standing_qpos(), data.qpos.dtype)
    data = data.replace(
        qpos=jnp.where(gone, rest, data.qpos),
        qvel=jnp.where(gone, 0.0, data.qvel),
        qacc_warmstart=jnp.where(gone, 0.0, data.qacc_warmstart),
    )
    return {
        **carry,
        "data": data,
        "before": jnp.where(gone, rest[7:], carry["before"]),
        "fell_tick": fell_tick,
        "max_tilt": jnp.where(stands, jnp.fmax(carry["max_tilt"], lean), carry["max_tilt"]),
        "max_ratio": jnp.where(stands, jnp.fmax(carry["max_ratio"], ratio), carry["max_ratio"]),
        "min_margin": jnp.where(stands, jnp.fmin(carry["min_margin"], margin), carry["min_margin"]),
        "error": jnp.where(stands & ~down, error, carry["error"]),
    }


def _outcome(final: Tree, count: int) -> Outcome:
    host = {name: np.asarray(value)[:count] for name, value in final.items()}
    return Outcome(
        host["fell_tick"] != NEVER,
        host["fell_tick"].astype(np.int32),
        host["max_tilt"].astype(np.float32),
        host["max_ratio"].astype(np.float32),
        host["min_margin"].astype(np.float32),
        host["error"].astype(np.float32),
    )


def _show(watch: Watch, recorded: Tree, script: Script, ticks: int, count: int) -> None:
    """Show a watcher every tick of what was recorded."""
    host = jax.tree.map(np.asarray, recorded)

    def names(trees: Mapping[str, Any], tick: int, ids: NDArray[np.int64]) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for key, memory in trees.items():
            found[key.split("@")[0]] = {k: v[tick][ids] for k, v in memory.items()}
        return found

    for tick in range(ticks):
        ids = np.flatnonzero(host["fell_tick"][tick][:count] == NEVER)

        def here(tick: int = tick, ids: NDArray[np.int64] = ids) -> Start:
            return Start(
                host["qpos"][tick][ids].astype(np.float64),
                host["qvel"][tick][ids].astype(np.float64),
                host["warmstart"][tick][ids].astype(np.float64),
                host["before"][tick][ids],
                names(host["memories"], tick, ids),
                names(host["steering"], tick, ids),
            )

        watch(tick, ids, here)


def device_memory_mib() -> float | None:
    """Return the peak memory of the first device [MiB], None where it does not tell."""
    stats = jax.devices()[0].memory_stats()
    return None if not stats else stats.get("peak_bytes_in_use", 0) / 2**20
