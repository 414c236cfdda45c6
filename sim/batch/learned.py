"""Imported policies in batch: `control/network.py` with a leading batch dimension."""

from __future__ import annotations

import math
from types import ModuleType
from typing import Any

import numpy as np

from downbeat.catalog.robot import NUM_JOINTS, load_g1
from downbeat.control.motion import Motion
from downbeat.control.observation import (
    Reference,
    RobotState,
    TermInputs,
    joint_target,
    observe_input,
    torso_pos,
    torso_quat,
    yaw,
)
from downbeat.control.phase import TICK_S
from downbeat.control.rotations import quat_mul, quat_rotate, yaw_quat
from downbeat.policies.manifest import SkillManifest
from downbeat.policies.spec import PolicySpec
from downbeat.sim.batch.skills import Array, BatchOutput, Memory, OpenNetwork

STILL_COMMAND = 0.01
"""As in control: below this a velocity command means stand."""


class LearnedBatch:
    """One imported policy."""

    def __init__(self, manifest: SkillManifest, open_network: OpenNetwork) -> None:
        """Open the network.

        Args:
            manifest: With a [policy] table.
            open_network: Opens the network for N rows.
        """
        assert manifest.policy is not None
        self.manifest = manifest
        self.spec: PolicySpec = manifest.policy
        spec, robot = self.spec, load_g1()
        self._joints = np.array([robot.joint_index(name) for name in spec.joint_names])  # (n,)
        held = [robot.joint_index(name) for name in spec.held.joint_names]
        self._default = np.asarray(spec.default_joint_pos, np.float32)
        self._scale = np.asarray(spec.action_scale, np.float32)
        self._offset = np.asarray(spec.action_offset, np.float32)
        self._held = np.zeros(NUM_JOINTS, np.float32)
        self._held[held] = spec.held.joint_pos
        self.joint_stiffness = self._all(spec.joint_stiffness, held, spec.held.joint_stiffness)
        self.joint_damping = self._all(spec.joint_damping, held, spec.held.joint_damping)
        # A permutation with the held joints behind: a gather, where an assignment by index would
        # need other code for jax.
        order = np.concatenate([self._joints, np.array(held, np.int64)])
        self._to_motor = np.argsort(order)
        self._motion = None
        if spec.motion is not None:
            self._motion = Motion(manifest.folder, spec.motion, spec.num_joints)
        outputs = (spec.action_output, *(r.output for r in spec.recurrent))
        self._network = open_network(manifest, outputs)

    def _all(self, moved: Any, held_ids: list[int], held: Any) -> np.ndarray:
        values = np.zeros(NUM_JOINTS, np.float32)
        values[self._joints] = moved
        values[held_ids] = held
        return values

    def _motors(self, moved: Array, xp: ModuleType) -> Array:
        """Return values in motor order (N, 29) of the policy's joints (N, n)."""
        held = xp.asarray(np.asarray(self.spec.held.joint_pos, np.float32))
        held = xp.broadcast_to(held, (len(moved), len(held)))
        return xp.concatenate([moved, held], axis=-1)[:, self._to_motor]

    # ------------------------------------------------------------------ memory

    def begin(
        self, state: RobotState, phase_s: Array, command: Array, xp: ModuleType
    ) -> dict[str, Any]:
        """Return the memory of a fresh start: no past actions, the motion aligned here."""
        spec = self.spec
        rows = len(state.joint_pos)
        memory: dict[str, Any] = {"action": xp.zeros((rows, spec.num_joints), np.float32)}
        for index, one in enumerate(spec.recurrent):
            shape = (rows, *one.shape)
            memory[f"recurrent{index}"] = xp.zeros(shape, np.float32)
        if spec.gait is not None:
            memory["gait"] = xp.full((rows,), spec.gait.start, np.float32)
            memory["still"] = xp.zeros((rows,), bool)
        if self._motion is not None:
            turn, shift = self._align(state, phase_s, xp)
            memory["turn"], memory["shift"] = turn, shift
        inputs, _ = self._inputs(memory, state, phase_s, command, xp)
        for number, one in enumerate(spec.inputs):
            # Histories full of the first frame (or of zeros): the next step shifts the same frame
            # in, which is what control's empty history becomes.
            _, kept = observe_input(one, inputs, None, xp)
            for index, frames in enumerate(kept):
                newest = frames[..., -1:, :]
                first = newest if one.history_fill == "first" else xp.zeros_like(newest)
                fill = xp.concatenate([first] * frames.shape[-2], axis=-2)
                memory[f"history{number}.{index}"] = xp.asarray(fill, np.float32)
        return memory

    def step(
        self, memory: Memory, state: RobotState, phase_s: Array, command: Array, xp: ModuleType
    ) -> tuple[dict[str, Any], BatchOutput]:
        """Compute one tick."""
        spec, after = self.spec, dict(memory)
        inputs, gait = self._inputs(memory, state, phase_s, command, xp)
        after.update(gait)
        feeds: dict[str, Array] = {}
        for number, one in enumerate(spec.inputs):
            names = [f"history{number}.{index}" for index in range(len(one.terms))]
            obs, kept = observe_input(one, inputs, tuple(memory[name] for name in names), xp)
            feeds[one.name] = xp.asarray(obs, np.float32)
            after.update({n: xp.asarray(k, np.float32) for n, k in zip(names, kept, strict=True)})
        for index, recurrent in enumerate(spec.recurrent):
            feeds[recurrent.input] = memory[f"recurrent{index}"]
        if spec.time_step_input:
            feeds[spec.time_step_input] = self._time_step(phase_s, len(state.joint_pos), xp)
        results = self._network(feeds)
        action = results[0].reshape((len(state.joint_pos), -1))
        for index, value in enumerate(results[1:]):
            after[f"recurrent{index}"] = value
        if spec.action_clip is not None:
            action = xp.clip(action, spec.action_clip[0], spec.action_clip[1])
        after["action"] = action
        target = self._motors(joint_target(action, self._scale, self._offset), xp)
        reference = target
        if inputs.reference is not None:
            reference = self._motors(inputs.reference.joint_pos, xp)
        return after, BatchOutput(target, reference)

    # ------------------------------------------------------------------ observation

    def _inputs(
        self, memory: Memory, state: RobotState, phase_s: Array, command: Array, xp: ModuleType
    ) -> tuple[TermInputs, dict[str, Any]]:
        """Return what the terms read, and the gait clock after this tick."""
        reference = here = facing = None
        phase = xp.zeros((len(state.joint_pos),), np.float32)
        if self._motion is not None and "turn" in memory:
            frame = self._frame(phase_s, xp)
            quat = yaw_quat(memory["turn"], xp)
            reference = Reference(
                *(xp.broadcast_to(a, (len(state.joint_pos), a.shape[-1])) for a in frame[:2]),
                memory["shift"] + quat_rotate(quat, frame[2], xp),
                quat_mul(quat, xp.broadcast_to(frame[3], quat.shape), xp),
            )
            facing = self._anchor_quat(state, xp)
            if "motion_anchor_pos_b" in self.spec.term_names:
                here = self._anchor_pos(state, xp)
            phase = xp.zeros_like(phase) + self._row(phase_s, xp) / (self._motion.spec.rows - 1)
        elif self.spec.phase_duration_s > 0.0:
            phase = phase + xp.clip(phase_s / self.spec.phase_duration_s, 0.0, 1.0)
        feet, gait = self._gait(memory, command, xp)
        inputs = TermInputs(
            state=state,
            joint_pos=state.joint_pos[:, self._joints],
            joint_vel=state.joint_vel[:, self._joints],
            default_joint_pos=self._default,
            last_action=memory["action"],
            command=command,
            reference=reference,
            anchor_pos=here,
            anchor_quat_wxyz=facing,
            motion_phase=xp.asarray(phase, np.float32),
            feet_phase=feet,
        )
        return inputs, gait

    def _time_step(self, phase_s: Array, rows: int, xp: ModuleType) -> Array:
        row = phase_s * 50.0 if self._motion is None else self._row(phase_s, xp)
        if self.spec.time_step_mode == "integer":
            row = xp.floor(row + 0.5)
        return xp.broadcast_to(xp.asarray(row, np.float32)[:, None], (rows, 1))

    # ------------------------------------------------------------------ motion

    def _row(self, phase_s: Array, xp: ModuleType) -> Array:
        assert self._motion is not None
        spec = self._motion.spec
        return xp.clip(phase_s * spec.rate_hz, 0.0, spec.rows - 1.0)

    def _frame(self, phase_s: Array, xp: ModuleType) -> tuple[Array, Array, Array, Array]:
        """Return joints, joint speeds, anchor place and turn of the motion, (M, ...)."""
        assert self._motion is not None
        row = self._row(phase_s, xp)
        low = xp.floor(row + 1e-6)
        share = xp.asarray(xp.clip(row - low, 0.0, 1.0), np.float32)[:, None]
        low = low.astype(np.int32)
        high = xp.minimum(low + 1, self._motion.spec.rows - 1)
        tables = [xp.asarray(table) for table in self._motion.tables]
        first, second = tables[3][low], tables[3][high]
        sign = xp.where(xp.sum(first * second, axis=-1, keepdims=True) >= 0.0, 1.0, -1.0)
        quat = (1.0 - share) * first + share * sign * second
        quat = quat / xp.sqrt(xp.sum(quat * quat, axis=-1, keepdims=True))
        mixed = [(1.0 - share) * table[low] + share * table[high] for table in tables[:3]]
        return (*(xp.asarray(m, np.float32) for m in mixed), xp.asarray(quat, np.float32))

    def _align(self, state: RobotState, phase_s: Array, xp: ModuleType) -> tuple[Array, Array]:
        """Return where the motion's world lies: turn (N,) [rad] and shift (N, 3) [m]."""
        frame = self._frame(phase_s, xp)
        turn = yaw(self._anchor_quat(state, xp), xp) - yaw(frame[3], xp)
        turn = xp.asarray(turn, np.float32)
        shift = self._anchor_pos(state, xp) - quat_rotate(yaw_quat(turn, xp), frame[2], xp)
        return turn, xp.asarray(shift, np.float32)

    def _anchor_quat(self, state: RobotState, xp: ModuleType) -> Array:
        assert self._motion is not None
        pelvis = self._motion.spec.anchor_body == "pelvis"
        quat = state.base_quat_wxyz if pelvis else torso_quat(state, xp)
        return xp.asarray(quat, np.float32)

    def _anchor_pos(self, state: RobotState, xp: ModuleType) -> Array:
        assert self._motion is not None
        if self._motion.spec.anchor_body == "pelvis":
            return xp.asarray(state.base_pos, np.float32)
        return xp.asarray(torso_pos(state, xp), np.float32)

    # ------------------------------------------------------------------ gait clock

    def _gait(self, memory: Memory, command: Array, xp: ModuleType) -> tuple[Array, dict[str, Any]]:
        """Return the phases of the feet (N, 2) [rad] now, and the clock for the next tick."""
        gait = self.spec.gait
        if gait is None:
            return None, {}
        clock, still = memory["gait"], memory["still"]
        if gait.still == "together":
            moving = xp.max(xp.abs(command), axis=-1) >= STILL_COMMAND
            clock = xp.where(still & moving, np.float32(gait.start), clock)
            still = ~moving
        turn = 2.0 * math.pi
        left, right = turn * xp.mod(clock, 1.0), turn * xp.mod(clock + gait.right_offset, 1.0)
        feet = xp.stack([left, right], axis=-1)
        feet = xp.asarray(xp.where(still[:, None], math.pi, feet), np.float32)
        ahead = xp.mod(clock + TICK_S / gait.period_s, 1.0)
        clock = xp.asarray(xp.where(still, clock, ahead), np.float32)
        return feet, {"gait": clock, "still": still}
