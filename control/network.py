"""Runs imported policy networks as their `[policy]` table describes them.

Everything that differs between the public formats is data (`policies/spec.py`): inputs, histories,
recurrent state, joint order and subset, scales, motion, gait clock. This is the one interpreter.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from downbeat.catalog.robot import load_g1
from downbeat.control.errors import ControlError
from downbeat.control.motion import Alignment, Motion, anchor_pos, anchor_quat
from downbeat.control.observation import RobotState, TermInputs, joint_target, observe_input
from downbeat.control.phase import TICK_S
from downbeat.control.session import WARM_UP_CALLS, open_session
from downbeat.control.skill import F32, NUM_JOINTS, JointTargets, SkillMemory, SkillOutput
from downbeat.policies.manifest import SkillManifest
from downbeat.policies.spec import PolicySpec

STILL_COMMAND = 0.01
"""Below this norm a velocity command means: stand (holosoma's value)."""


class NetworkSkill:
    """One imported policy."""

    def __init__(self, manifest: SkillManifest) -> None:
        """Open the network, check it against its table, warm it up.

        Raises:
            ControlError: The network does not fit the table, or the motion cannot be read.
        """
        if manifest.policy is None:
            raise ControlError(f"Skill '{manifest.name}' has no [policy] table.")
        self.manifest = manifest
        self.spec: PolicySpec = manifest.policy
        self.session = open_session(manifest.onnx_path)
        spec, robot = self.spec, load_g1()
        self._joints = np.array([robot.joint_index(name) for name in spec.joint_names])  # (n,)
        self._default = np.asarray(spec.default_joint_pos, np.float32)  # (n,)
        self._scale = np.asarray(spec.action_scale, np.float32)  # (n,)
        self._offset = np.asarray(spec.action_offset, np.float32)  # (n,)
        held = [robot.joint_index(name) for name in spec.held.joint_names]
        self._target = np.zeros(NUM_JOINTS, np.float32)
        self._target[held] = spec.held.joint_pos
        self._stiffness = self._all_joints(spec.joint_stiffness, held, spec.held.joint_stiffness)
        self._damping = self._all_joints(spec.joint_damping, held, spec.held.joint_damping)
        self._motion = None
        if spec.motion is not None:
            self._motion = Motion(manifest.folder, spec.motion, spec.num_joints)
        self._outputs = [spec.action_output, *(r.output for r in spec.recurrent)]
        self._needs_anchor_pos = "motion_anchor_pos_b" in spec.term_names
        self._check_interface()
        self._warm_up()

    def _all_joints(self, moved: Any, held_ids: list[int], held: Any) -> F32:
        values = np.zeros(NUM_JOINTS, np.float32)
        values[self._joints] = moved
        values[held_ids] = held
        return values

    def _check_interface(self) -> None:
        spec, path = self.spec, self.manifest.onnx_path
        inputs = {node.name: node.shape for node in self.session.get_inputs()}
        outputs = {node.name: node.shape for node in self.session.get_outputs()}
        wanted = {one.name for one in spec.inputs} | {r.input for r in spec.recurrent}
        if spec.time_step_input:
            wanted.add(spec.time_step_input)
        if wanted != set(inputs) or not set(self._outputs) <= set(outputs):
            raise ControlError(
                f"Policy {path} has inputs {', '.join(inputs)} and outputs {', '.join(outputs)}; "
                f"its manifest describes {', '.join(sorted(wanted))} and "
                f"{', '.join(self._outputs)}."
            )
        for one in spec.inputs:
            width = one.width(spec.num_joints)
            if inputs[one.name][-1] != width:
                raise ControlError(
                    f"Policy {path}: input '{one.name}' takes {inputs[one.name][-1]} numbers, its "
                    f"manifest describes {width}."
                )
        if outputs[spec.action_output][-1] != spec.num_joints:
            raise ControlError(
                f"Policy {path}: output '{spec.action_output}' has "
                f"{outputs[spec.action_output][-1]} numbers for {spec.num_joints} joints."
            )

    def _warm_up(self) -> None:
        zeros = np.zeros(NUM_JOINTS, np.float32)
        upright = np.array([1.0, 0.0, 0.0, 0.0], np.float32)
        state = RobotState(upright, np.zeros(3, np.float32), zeros, zeros)
        memory = self.begin(state, 0.0)
        for _ in range(WARM_UP_CALLS):
            self.step(memory, state, 0.0, np.zeros(3, np.float32))

    def begin(self, state: RobotState, phase_s: float) -> SkillMemory:
        """Return a fresh memory: no past actions, the motion aligned at the entry frame."""
        spec = self.spec
        memory = SkillMemory(np.zeros(spec.num_joints, np.float32))
        memory.recurrent = {r.input: np.zeros(r.shape, np.float32) for r in spec.recurrent}
        if spec.gait is not None:
            memory.gait_phase = spec.gait.start
        if self._motion is not None:
            frame = self._motion.frame(phase_s)
            memory.alignment = Alignment.at_entry(state, frame, self._motion.spec.anchor_body)
        return memory

    def step(
        self, memory: SkillMemory, state: RobotState, phase_s: float, command: F32
    ) -> SkillOutput:
        """Compute one tick; see `Skill.step`."""
        spec = self.spec
        inputs = self._term_inputs(memory, state, phase_s, command)
        feeds: dict[str, F32] = {}
        for one in spec.inputs:
            obs, kept = observe_input(one, inputs, memory.histories.get(one.name))
            feeds[one.name] = np.asarray(obs, np.float32)[None, :]
            memory.histories[one.name] = kept
        seen = np.concatenate([feeds[one.name][0] for one in spec.inputs])
        for recurrent in spec.recurrent:
            feeds[recurrent.input] = memory.recurrent[recurrent.input]
        if spec.time_step_input:
            feeds[spec.time_step_input] = self._time_step(phase_s)
        results = self.session.run(self._outputs, feeds)
        action: F32 = results[0].reshape(-1)  # (n,)
        for recurrent, value in zip(spec.recurrent, results[1:], strict=True):
            memory.recurrent[recurrent.input] = value
        if spec.action_clip is not None:
            action = np.clip(action, spec.action_clip[0], spec.action_clip[1])
        memory.last_action = action
        self._advance_gait(memory, command)
        target = self._target.copy()
        target[self._joints] = joint_target(action, self._scale, self._offset)
        return SkillOutput(seen, action, JointTargets(target, self._stiffness, self._damping))

    def _term_inputs(
        self, memory: SkillMemory, state: RobotState, phase_s: float, command: F32
    ) -> TermInputs:
        reference = here = facing = None
        phase = np.float32(0.0)
        if self._motion is not None and memory.alignment is not None:
            reference = memory.alignment.apply(self._motion.frame(phase_s))
            body = self._motion.spec.anchor_body
            facing = anchor_quat(state, body)
            here = anchor_pos(state, body) if self._needs_anchor_pos else None
            phase = np.float32(self._motion.row(phase_s) / (self._motion.spec.rows - 1))
        elif self.spec.phase_duration_s > 0.0:
            phase = np.float32(min(max(phase_s / self.spec.phase_duration_s, 0.0), 1.0))
        return TermInputs(
            state=state,
            joint_pos=state.joint_pos[self._joints],
            joint_vel=state.joint_vel[self._joints],
            default_joint_pos=self._default,
            last_action=memory.last_action,
            command=command,
            reference=reference,
            anchor_pos=here,
            anchor_quat_wxyz=facing,
            motion_phase=phase,
            feet_phase=self._feet_phase(memory, command),
        )

    def _time_step(self, phase_s: float) -> F32:
        row = phase_s * 50.0 if self._motion is None else self._motion.row(phase_s)
        if self.spec.time_step_mode == "integer":
            row = math.floor(row + 0.5)
        return np.array([[row]], np.float32)

    # ------------------------------------------------------------------ gait clock

    def _feet_phase(self, memory: SkillMemory, command: F32) -> F32 | None:
        gait = self.spec.gait
        if gait is None:
            return None
        if gait.still == "together":
            moving = float(np.abs(command).max()) >= STILL_COMMAND
            if not moving:
                memory.is_still = True
            elif memory.is_still:
                memory.is_still = False
                memory.gait_phase = gait.start
        if memory.is_still:
            return np.full(2, math.pi, np.float32)
        turn = 2.0 * math.pi
        left = memory.gait_phase % 1.0
        right = (memory.gait_phase + gait.right_offset) % 1.0
        return np.array([turn * left, turn * right], np.float32)

    def _advance_gait(self, memory: SkillMemory, command: F32) -> None:
        gait = self.spec.gait
        if gait is not None and not memory.is_still:
            memory.gait_phase = (memory.gait_phase + TICK_S / gait.period_s) % 1.0
