"""The native engine: MuJoCo on threads, policies in numpy and ONNX Runtime, fallen robots dropped.

Bit-identical for any number of threads: every simulation is independent, and everything between
two physics steps runs in this thread.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
from mujoco import batch as mujoco_batch
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
    model_ids,
    tilt_limit,
)
from downbeat.sim.batch.outcome import NEVER, Outcome, capture_margin
from downbeat.sim.batch.perturb import PUSH_S, Draws
from downbeat.sim.batch.script import Script
from downbeat.sim.batch.skills import BatchSkill, batch_skill
from downbeat.sim.batch.steering import begin_steering, steer

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Ids = NDArray[np.int64]

NOISE_PARTS = (3, 3, NUM_JOINTS, NUM_JOINTS, 3)
"""Orientation, gyro, joint positions, joint velocities, base velocity."""
NOISE_WIDTH = sum(NOISE_PARTS)
PUSH_TICKS = round(PUSH_S / TICK_S)
MARGIN_TICKS = 5
"""The capture point is looked at ten times a second; everything else in every tick."""
FALLEN_BELOW_M = 0.5
KEPT_BATCHES = 1
"""Of how many sizes the simulations are kept; the idle threads of more would only spin."""
SETTLE_TICKS = 25
SETTLE_MARGINS = SETTLE_TICKS // MARGIN_TICKS
SETTLED_ERROR_RAD = 0.035
SETTLED_MARGIN_M = 0.045
"""Of 28 robots that fell 2 to 6 s after a change, one had both an RMS joint error and a capture
point this good over the half second before 2 s, and so had 88 % of the 4,109 that stayed up.
"""


class NativeEngine:
    """Runs scripts with `mujoco.batch`."""

    name = "native"

    def __init__(self, manifests: Mapping[str, SkillManifest], threads: int = 0) -> None:
        """Prepare; skills are opened when a script first plays them.

        Args:
            manifests: Whatever scripts will play.
            threads: Of the physics; 0: one per core that this process may use.
        """
        self.manifests = dict(manifests)
        self.threads = threads or len(os.sched_getaffinity(0))
        self._skills: dict[str, BatchSkill] = {}
        self._batches: dict[int, _Simulations] = {}

    def skill(self, name: str) -> BatchSkill:
        """Return a skill for many robots."""
        if name not in self._skills:
            # Late: our own skills need no runtime, and some machines have none.
            from downbeat.sim.batch.ort import open_batched

            self._skills[name] = batch_skill(self.manifests[name], open_batched)
        return self._skills[name]

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
        """Simulate; see `Engine`.

        Args:
            start: Where the rollouts begin.
            script: What plays.
            draws: What is different in each.
            seed: Of the sensor noise.
            watch: Sees every tick.
            last_tick: Stop before this tick; None: play the whole script.
            settle_tick: From here on robots that have calmed down are not simulated further.
        """
        if start.count not in self._batches:
            if len(self._batches) >= KEPT_BATCHES:
                self._batches.pop(next(iter(self._batches)))
            self._batches[start.count] = _Simulations(start.count, self.threads)
        simulations = self._batches[start.count]
        simulations.prepare(start, draws)
        run = _Run(self, simulations, start, script, draws, seed)
        for tick in range(script.ticks if last_tick is None else last_tick):
            if watch is not None:
                watch(tick, run.ids, run.here)
            if not len(run.ids):
                break
            run.tick(tick)
            if settle_tick is not None and tick >= settle_tick:
                run.release_settled(tick - settle_tick)
        return run.outcome()


class _Simulations:
    """The physics of N robots."""

    def __init__(self, count: int, threads: int) -> None:
        self.model = batch_model()
        self.batch: Any = mujoco_batch.Batch(self.model, count, nthread=threads)
        batch = self.batch
        self.mass = batch.expand("body_mass")
        self.inertia = batch.expand("body_inertia")
        self.ipos = batch.expand("body_ipos")
        self.friction = batch.expand("geom_friction")
        self.gain = batch.expand("actuator_gainprm")
        self.bias = batch.expand("actuator_biasprm")
        self.qpos, self.qvel = batch.bind("qpos"), batch.bind("qvel")
        self.ctrl, self.wrench = batch.bind("ctrl"), batch.bind("xfrc_applied")
        self.warmstart = batch.bind("qacc_warmstart")
        self.sensors, self.torque = batch.bind("sensordata"), batch.bind("actuator_force")
        self.place, self.turn = batch.bind("xpos"), batch.bind("xmat")
        self._draws: Draws | None = None

    def prepare(self, start: Start, draws: Draws) -> None:
        """Put the robots where they start."""
        if draws is not self._draws:
            self._write_robots(draws)
            self._draws = draws
        self.batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE)
        self.qpos[:], self.qvel[:] = start.qpos, start.qvel
        self.warmstart[:], self.ctrl[:] = start.warmstart, start.target
        self.wrench[:] = 0.0

    def _write_robots(self, draws: Draws) -> None:
        model, ids = self.model, model_ids()
        self.mass[:] = model.body_mass * draws.mass_scale[:, None]
        self.inertia[:] = model.body_inertia * draws.mass_scale[:, None, None]
        self.ipos[:] = model.body_ipos
        self.ipos[:, ids.torso] += draws.com_offset_m
        self.friction[:] = model.geom_friction
        self.friction[:, ids.floor_and_soles, 0] = draws.friction[:, None]
        self.batch.set_const()

    def write_gains(self, ids: Ids, stiffness: F64, damping: F64) -> None:
        """Set the motors' gains, (n, 29)."""
        self.gain[ids, :, 0] = stiffness
        self.bias[ids, :, 1] = -stiffness
        self.bias[ids, :, 2] = -damping


class _Run:
    """One script under way. Arrays of skills have one row per robot that still stands (`ids`)."""

    def __init__(
        self,
        engine: NativeEngine,
        simulations: _Simulations,
        start: Start,
        script: Script,
        draws: Draws,
        seed: tuple[int, ...],
    ) -> None:
        self._engine, self._sims, self._script = engine, simulations, script
        self._draws, self._count = draws, start.count
        self._rng = np.random.default_rng([*seed, 0x5E15])
        self.ids: Ids = np.arange(start.count)
        self._rows: Any = slice(None)
        """Who still stands, as an index: everybody is a view, not a copy."""
        pushed = draws.push_n_s.any(axis=1)
        begin = np.round(draws.push_s / TICK_S).astype(np.int64)
        self._push_ticks = np.where(pushed, begin, -PUSH_TICKS - 1)  # (N,)
        self._memories = {s: dict(m) for s, m in start.memories.items()}
        self._steering = {s: dict(m) for s, m in start.steering.items()}
        self._before = np.array(start.target, np.float64)  # (N, 29)
        delays = {int(delay) for delay in draws.delay_substeps}
        self._delays = sorted(delay for delay in delays if 0 < delay < SUBSTEPS)
        self._gains: tuple[F32, F32] | None = None
        self._tilt_limit = tilt_limit([engine.manifests[s] for s in script.skills])
        widths = [np.repeat(draws.noise[:, i : i + 1], n, 1) for i, n in enumerate(NOISE_PARTS)]
        self._noise_scale = np.concatenate(widths, axis=1).astype(np.float32)  # (N, 67)
        learned = [engine.manifests[s].policy for s in script.skills]
        self._needs_speed = any(p is not None and p.needs_position for p in learned)
        self._fell_tick = np.full(start.count, NEVER, np.int32)
        self._max_tilt = np.zeros(start.count, np.float32)
        self._max_ratio = np.zeros(start.count, np.float32)
        self._min_margin = np.full(start.count, np.inf, np.float32)
        self._error = np.zeros(start.count, np.float32)
        self._recent_error = np.full((SETTLE_TICKS, start.count), np.nan, np.float32)
        self._recent_margin = np.full((SETTLE_MARGINS, start.count), np.nan, np.float32)

    # ------------------------------------------------------------------ one tick

    def tick(self, tick: int) -> None:
        """Observe, act, integrate, judge."""
        state = self._measure()
        target, reference = self._act(tick, state)
        self._push(tick)
        self._integrate(target)
        self._judge(tick, reference)

    def _measure(self) -> RobotState:
        sims, rows = self._sims, self._rows
        unit = self._rng.random((self._count, NOISE_WIDTH), np.float32)[rows]
        noise = (2.0 * unit - 1.0) * self._noise_scale[rows]  # (n, 67)
        qpos, qvel = sims.qpos[rows].astype(np.float32), sims.qvel[rows].astype(np.float32)
        quat = qpos[:, 3:7]
        local = noise[:, 64:67]
        if self._needs_speed:
            local = local + quat_rotate_inverse(quat, qvel[:, :3])
        return RobotState(
            tilted(quat, noise[:, :3]),
            qvel[:, 3:6] + noise[:, 3:6],
            qpos[:, 7:] + noise[:, 6:35],
            qvel[:, 6:] + noise[:, 35:64],
            local,
            qpos[:, :3],
        )

    def _act(self, tick: int, state: RobotState) -> tuple[F32, F32]:
        """Return the mixed targets and the reference of what leads, (n, 29)."""
        script = self._script
        target = np.zeros((len(self.ids), NUM_JOINTS), np.float32)
        stiffness = np.zeros(NUM_JOINTS, np.float32)
        damping = np.zeros(NUM_JOINTS, np.float32)
        reference, lead = target, -1.0
        for index in script.playing(tick):
            name = script.skills[index]
            skill = self._engine.skill(name)
            phase = script.phase_s[tick, index]
            phase = phase[self.ids] if len(phase) > 1 else phase
            command = self._command(tick, index, state)
            key = name if script.start_tick[index] < 0 else f"{name}@{index}"
            if tick == script.start_tick[index]:
                self._memories[key] = skill.begin(state, phase, command, np)
            memory, output = skill.step(self._memories.get(key, {}), state, phase, command, np)
            self._memories[key] = memory
            share = mix_weights(script.weight[tick, index])
            target += share * output.joint_pos
            stiffness += share * skill.joint_stiffness
            damping += share * skill.joint_damping
            if share[-1] > lead:
                reference, lead = output.reference, float(share[-1])
        self._set_gains(stiffness, damping)
        return target, reference

    def _command(self, tick: int, index: int, state: RobotState) -> F32:
        script = self._script
        name = script.skills[index]
        manifest = self._engine.manifests[name]
        if manifest.command is None:
            return np.zeros((len(self.ids), 3), np.float32)
        key = name if script.start_tick[index] < 0 else f"{name}@{index}"
        heading = yaw(state.base_quat_wxyz)
        if tick == script.start_tick[index] or key not in self._steering:
            self._steering[key] = begin_steering(heading)
        memory = self._steering[key]
        self._steering[key], command = steer(manifest, memory, heading, script.velocity[index])
        return command

    def _set_gains(self, stiffness: F32, damping: F32) -> None:
        """Write the gains if they changed; fallen robots keep theirs."""
        new = (stiffness, damping)
        old = self._gains
        if old is not None and all(np.array_equal(a, b) for a, b in zip(old, new, strict=True)):
            return
        self._gains = new
        draws, ids = self._draws, self.ids
        self._sims.write_gains(
            ids,
            stiffness * draws.stiffness_scale[ids, None],
            damping * draws.damping_scale[ids, None],
        )

    def _push(self, tick: int) -> None:
        since = tick - self._push_ticks
        changes = (since == 0) | (since == PUSH_TICKS)
        if changes.any():
            pushed = (since >= 0) & (since < PUSH_TICKS)
            force = np.where(pushed[:, None], self._draws.push_n_s / PUSH_S, 0.0)
            self._sims.wrench[:, model_ids().torso, :2] = force

    def _integrate(self, target: F32) -> None:
        """Four physics steps; the new targets reach the motors after each robot's delay."""
        sims, rows = self._sims, self._rows
        ids = None if len(self.ids) == self._count else self.ids
        late = self._draws.delay_substeps[rows]
        old, new = self._before[rows], target.astype(np.float64)
        done = 0
        for substep in (*self._delays, SUBSTEPS):
            sims.ctrl[rows] = np.where((late > done)[:, None], old, new)
            sims.batch.step(ids, nstep=substep - done)
            done = substep
        self._before[rows] = new

    def _judge(self, tick: int, reference: F32) -> None:
        sims, rows, ids = self._sims, self._rows, self.ids
        qpos = sims.qpos[rows]
        lean = tilt(qpos[:, 3:7])
        # `not >` and `not <=` also catch a NaN.
        down = ~(qpos[:, 2] > FALLEN_BELOW_M) | ~(lean <= self._tilt_limit)
        self._max_tilt[rows] = np.fmax(self._max_tilt[rows], lean)
        ratio = (np.abs(sims.torque[rows]) / model_ids().torque_limit).max(axis=1)
        self._max_ratio[rows] = np.fmax(self._max_ratio[rows], ratio)
        error = qpos[:, 7:] - reference
        self._error[rows] = np.sqrt(np.mean(error * error, axis=1))
        self._recent_error[tick % SETTLE_TICKS, rows] = self._error[rows]
        if tick % MARGIN_TICKS == 0:
            margin = self._margin()
            self._min_margin[rows] = np.fmin(self._min_margin[rows], margin)
            self._recent_margin[tick // MARGIN_TICKS % SETTLE_MARGINS, rows] = margin
        if down.any():
            self._fell_tick[ids[down]] = tick
            self._keep(~down)

    def release_settled(self, ticks: int) -> None:
        """Every half a second, let go of the robots that have calmed down."""
        if ticks % SETTLE_TICKS:
            return
        error, margin = self._recent_error[:, self.ids], self._recent_margin[:, self.ids]
        rms = np.sqrt(np.mean(error * error, axis=0))
        settled = (rms <= SETTLED_ERROR_RAD) & (margin.min(axis=0) >= SETTLED_MARGIN_M)
        if settled.any():
            self._keep(~settled)

    def _margin(self) -> F64:
        sims, rows, feet = self._sims, self._rows, model_ids().feet
        sensors = sims.sensors[rows]
        place = np.stack([sims.place[rows, foot] for foot in feet], axis=1)
        turn = np.stack([sims.turn[rows, foot] for foot in feet], axis=1).reshape(-1, 2, 3, 3)
        return capture_margin(sensors[:, :3], sensors[:, 3:6], place, turn)

    def _keep(self, standing: NDArray[np.bool_]) -> None:
        self.ids = self._rows = self.ids[standing]
        for trees in (self._memories, self._steering):
            for name, memory in trees.items():
                trees[name] = {key: value[standing] for key, value in memory.items()}

    # ------------------------------------------------------------------ results

    def here(self) -> Start:
        """Return where the robots that still stand are now."""
        sims, ids = self._sims, self.ids
        names = {k.split("@")[0]: k for k in self._memories}
        return Start(
            sims.qpos[ids].copy(),
            sims.qvel[ids].copy(),
            sims.warmstart[ids].copy(),
            self._before[ids].astype(np.float32),
            {name: dict(self._memories[key]) for name, key in names.items()},
            {k.split("@")[0]: dict(m) for k, m in self._steering.items()},
        )

    def outcome(self) -> Outcome:
        """Return what became of everybody."""
        return Outcome(
            self._fell_tick != NEVER,
            self._fell_tick,
            self._max_tilt,
            self._max_ratio,
            self._min_margin,
            self._error,
        )


def mix_weights(share: F32) -> F32:
    """Return the weights of all joints (29,) of the weights of legs and rest (2,)."""
    weights = np.full(NUM_JOINTS, share[1], np.float32)
    weights[:12] = share[0]
    return weights


def tilted(quat_wxyz: Any, angles: Any, xp: Any = np) -> Any:
    """Return orientations (N, 4) turned by small angles (N, 3) [rad] about the body's axes."""
    half = 0.5 * angles
    small = xp.concatenate([xp.ones_like(half[:, :1]), half], axis=-1)
    turned = quat_mul(quat_wxyz, small, xp)
    return turned / xp.sqrt(xp.sum(turned * turned, axis=-1, keepdims=True))
