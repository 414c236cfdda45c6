"""The control tick: a pure function of the core's state and its inputs.

No clock, no randomness, no set order, no BLAS, no environment. `ControlNode` feeds it from the bus;
the batch check restores it and runs the same lines.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from downbeat.control.allowed import allowed_fall_limits, allowed_limits
from downbeat.control.atlas import Atlas
from downbeat.control.balance import FallPredictor, tilt_and_rate
from downbeat.control.director import Director, Frame
from downbeat.control.estimate import NO_ESTIMATE, Estimate, StateEstimator
from downbeat.control.faults import Reaction
from downbeat.control.get_up import GetUp
from downbeat.control.observation import RobotState
from downbeat.control.policy import SkillLibrary
from downbeat.control.query import transition_query
from downbeat.control.safety import (
    Measured,
    RaisedFault,
    SafetyMonitor,
    fault_from_state,
    fault_to_state,
)
from downbeat.control.skill import F32, JointTargets
from downbeat.control.snapshot import from_bytes, to_bytes
from downbeat.control.tick import (
    CoreConfig,
    TickInput,
    TickOutput,
    command_for,
    estop_text,
    hash64,
    robot_state,
)
from downbeat.lcm_types import (
    control_status_t,
    estop_t,
    g1_low_cmd_t,
    g1_low_state_t,
    operator_command_t,
    transition_query_t,
)

__all__ = ["ControlCore", "CoreConfig", "TickInput", "TickOutput", "hash64", "robot_state"]


class ControlCore:
    """Modes and safety around the director."""

    def __init__(
        self,
        library: SkillLibrary,
        config: CoreConfig | None = None,
        atlas: Atlas | None = None,
    ) -> None:
        """Prepare the core.

        Args:
            library: What may be played.
            config: Settings.
            atlas: Proven changes of skill; None: the measured rules alone decide.

        Raises:
            ControlError: The fallback skill is not in the library.
        """
        self.config = config or CoreConfig()
        self.library = library
        self.mode: int = control_status_t.ZERO_TORQUE
        self.director = Director(library, self.config.fallback, atlas, self.config.proof)
        self.safety = SafetyMonitor()
        self.estimator = StateEstimator()
        self.predictor = FallPredictor()
        self.fault: RaisedFault | None = None
        self._armed = False
        self._latched_fault: RaisedFault | None = None
        self._get_up = GetUp()
        self._tripped = False
        self._sent: F32 | None = None
        self._limp = False
        self._tilt = math.nan
        self._hardest = Reaction.NONE
        self._query: transition_query_t | None = None

    def tick(self, inputs: TickInput) -> TickOutput:
        """Advance by one tick of 20 ms."""
        self.fault = self._latched_fault
        self._tripped = False
        state, estimate = self._sense(inputs)
        self._watch_state(inputs, state, estimate)
        self._take_operator(inputs)
        self._take_requests(inputs)
        self.director.prover.hear(inputs.verdicts, inputs.utime)
        self._query = None
        frame, targets = self._act(inputs, state)
        is_limp = self.mode == control_status_t.ZERO_TORQUE or self._limp
        command = command_for(inputs, targets, is_limp)
        status = self._status(inputs, state, estimate, frame, command)
        self.director.end_tick(inputs.utime)
        changes = self.director.book.take_changes()
        return TickOutput(command, status, changes, self._tripped, self._query)

    def _sense(self, inputs: TickInput) -> tuple[RobotState | None, Estimate]:
        """Return the measured and estimated state of the robot."""
        msg = inputs.state
        if msg is None:
            return None, NO_ESTIMATE
        state = robot_state(msg)
        estimate = self.estimator.update(
            state.base_quat_wxyz.tolist(),
            state.base_ang_vel.tolist(),
            np.asarray(msg.imu_pelvis.accel, np.float32).tolist(),
            state.joint_pos.tolist(),
            state.joint_vel.tolist(),
        )
        if not math.isfinite(estimate.base_height):
            return state, estimate
        lin_vel = np.array(estimate.base_lin_vel, np.float32)
        base_pos = np.array(estimate.base_pos, np.float32)
        return replace(state, base_lin_vel=lin_vel, base_pos=base_pos), estimate

    def _act(
        self, inputs: TickInput, state: RobotState | None
    ) -> tuple[Frame | None, JointTargets | None]:
        """Return what was played and the targets to send; None for a passive robot."""
        if state is None or self._latched_fault is not None:
            return None, None
        self._maybe_arm(inputs)
        if self.mode == control_status_t.MOVE_TO_POSE:
            targets = self._get_up.targets(inputs.utime)
            if targets is not None:
                return None, targets
            self.director.start(state, inputs.utime)  # a held pose does not stand, a skill does
        self.director.update(state, inputs.utime)
        self._ask(inputs, state)
        frame = self.director.play(state, inputs.utime)
        if frame is None:
            return None, None
        raised = self.safety.judge_policy(frame.parts)
        if raised:
            frame = self._replace_policy(raised, state, inputs.utime)
            if frame is None:
                return None, None
        self.mode = self.director.mode
        return frame, frame.targets

    def _ask(self, inputs: TickInput, state: RobotState) -> None:
        """Form the question to the checker, before this tick changes what it is about."""
        question = self.director.prover.question
        if question is not None:
            memory = to_bytes({"director": self.director.to_state(), "sent": self._sent})
            proof = self.config.proof
            self._query = transition_query(inputs, state, question, self.director, proof, memory)

    def _replace_policy(
        self, raised: list[RaisedFault], state: RobotState, now: int
    ) -> Frame | None:
        """A skill computed what must not be sent: let the balance policy act in the same tick."""
        for fault in raised:
            self._react(fault, state, now)
        if self._latched_fault is not None:
            return None
        frame = self.director.play(state, now)
        again = self.safety.judge_policy(frame.parts) if frame is not None else raised
        if again and frame is not None:
            for fault in self.safety.refuse_fallback(again[0].text):
                self._react(fault, state, now)
            return None
        return frame

    # ------------------------------------------------------------------ modes and safety

    def _take_operator(self, inputs: TickInput) -> None:
        for msg in inputs.operator:
            if msg.command == operator_command_t.ARM:
                # Not against a fault that is there now: it would only trip again, one tick late.
                if self._latched_fault is None and self._hardest < Reaction.DAMPING:
                    self._armed = True
            elif msg.command == operator_command_t.DISARM:
                self._go_passive("the operator disarmed", control_status_t.DAMPING)
            elif msg.command == operator_command_t.CLEAR_TRIP and self._may_clear:
                self.fault = self._latched_fault = None
                self._limp = False
                self._go_passive("the trip was cleared", control_status_t.DAMPING)
            elif msg.command == operator_command_t.STAND:
                self.director.book.abort_all("the operator asked to stand")

    @property
    def _may_clear(self) -> bool:
        """Whether there is a trip to clear, and nobody presses the emergency stop right now."""
        return self._latched_fault is not None and self._hardest < Reaction.ESTOP

    def _take_requests(self, inputs: TickInput) -> None:
        hardware = g1_low_state_t.SOURCE_HARDWARE
        on_hardware = inputs.state is not None and inputs.state.source == hardware
        is_passive = self.director.playback is None and not self._get_up.is_moving
        for request in inputs.requests:
            reason = "Control is passive; arm it first." if is_passive else ""
            self.director.receive(request, inputs.utime, inputs.tick, on_hardware, reason)

    def _go_passive(self, reason: str, mode: int) -> None:
        self._armed = False
        self._get_up.stop()
        self.director.stop(reason)
        self.mode = mode

    def _watch_state(self, inputs: TickInput, state: RobotState | None, estimate: Estimate) -> None:
        """Apply the fault table to what was measured."""
        if any(msg.level == estop_t.ZERO_TORQUE for msg in inputs.estops):
            self._limp = True
        self._tilt, rate = math.nan, 0.0
        if state is not None:
            self._tilt, rate = tilt_and_rate(
                state.base_quat_wxyz.tolist(), state.base_ang_vel.tolist()
            )
        falling = self._falling(state, estimate, rate)
        measured = Measured(
            utime=inputs.utime,
            msg=inputs.state,
            state=state,
            tilt_rad=self._tilt,
            state_age_us=inputs.state_age_us,
            foreign_states=inputs.foreign_states,
            falling=falling,
            estop=estop_text(inputs.estops),
            is_active=self.director.playback is not None,
        )
        wants_stand = ""
        self._hardest = Reaction.NONE
        for raised in self.safety.judge_state(measured, allowed_limits(self.director.playing)):
            self._hardest = max(self._hardest, raised.fault.reaction)
            self._react(raised, state, inputs.utime)
            if raised.fault.reaction == Reaction.STAND:
                wants_stand = wants_stand or raised.text
        self.director.close(wants_stand)

    def _falling(self, state: RobotState | None, estimate: Estimate, rate: float) -> str:
        """Return what says that a fall is coming; empty: nothing does, or nothing is played."""
        limits = allowed_fall_limits(self.director.playing)
        if state is None or limits is None:
            self.predictor.reset()
            return ""
        prediction = self.predictor.update(estimate, self._tilt, rate, limits)
        if not prediction.is_falling:
            return ""
        return f"{prediction.cause.replace('_', ' ')} {prediction.value:.2f}"

    def _react(self, raised: RaisedFault, state: RobotState | None, now: int) -> None:
        """Apply one raised row; the hardest reaction is the one that is reported."""
        reaction = raised.fault.reaction
        if self.fault is None or reaction > self.fault.fault.reaction:
            self.fault = raised
        active = self.director.playback is not None or self._get_up.is_moving
        if reaction == Reaction.ESTOP:
            self._trip(raised, control_status_t.ESTOP)
        elif reaction == Reaction.DAMPING and active:
            self._trip(raised, control_status_t.DAMPING)
        elif reaction == Reaction.FALLBACK and state is not None and active:
            act = self.director.catch if raised.fault.name == "falling" else self.director.fall_back
            act(raised.text, state, now)

    def _trip(self, raised: RaisedFault, mode: int) -> None:
        latched = self._latched_fault
        if latched is None or raised.fault.reaction > latched.fault.reaction:
            self._latched_fault = raised
            self._tripped = True
            self._go_passive(raised.text, mode)

    def _maybe_arm(self, inputs: TickInput) -> None:
        """Leave ZERO_TORQUE or DAMPING once armed (in simulation: by itself, once)."""
        idle = self.mode in (control_status_t.ZERO_TORQUE, control_status_t.DAMPING)
        if not idle or inputs.state is None:
            return
        simulated = inputs.state.source == g1_low_state_t.SOURCE_SIM
        fresh = self.mode == control_status_t.ZERO_TORQUE
        if self._armed or (self.config.auto_arm and simulated and fresh):
            self._armed = True
            self.mode = control_status_t.MOVE_TO_POSE
            self._get_up.begin(np.asarray(inputs.state.joint_pos, np.float32), inputs.utime)
            self.estimator.reset()

    # ------------------------------------------------------------------ snapshot

    def snapshot(self) -> bytes:
        """Return everything the next tick depends on, between two ticks."""
        return to_bytes(
            {
                "mode": self.mode,
                "armed": self._armed,
                "latched": fault_to_state(self._latched_fault),
                "get_up": self._get_up.state,
                "sent": self._sent,
                "limp": self._limp,
                "safety": self.safety.to_state(),
                "estimator": self.estimator.state,
                "predictor": self.predictor.state,
                "director": self.director.to_state(),
            }
        )

    def restore(self, data: bytes) -> None:
        """Continue exactly where `snapshot` was taken; the same library must be loaded.

        Raises:
            ControlError: The bytes are not a snapshot, or play a skill that is not loaded.
        """
        state = from_bytes(data, self.library)
        self.mode = state["mode"]
        self._armed = state["armed"]
        self._latched_fault = fault_from_state(state["latched"])
        self._get_up.state = state["get_up"]
        self._sent = state["sent"]
        self._limp = state["limp"]
        self.safety.from_state(state["safety"])
        self.estimator.state = state["estimator"]
        self.predictor.state = state["predictor"]
        self.director.from_state(state["director"])

    # ------------------------------------------------------------------ output

    def _status(
        self,
        inputs: TickInput,
        state: RobotState | None,
        estimate: Estimate,
        frame: Frame | None,
        command: g1_low_cmd_t,
    ) -> control_status_t:
        status = control_status_t()
        status.header.utime = inputs.utime
        status.tick = inputs.tick
        status.mode = self.mode
        status.state_age_us = max(min(inputs.state_age_us, 2**31 - 1), -(2**31))
        if inputs.state is not None:
            status.state_seq = inputs.state.header.seq
            status.input_hash = hash64(inputs.state.joint_pos, inputs.state.joint_vel)
        self.director.fill_status(status)
        if frame is not None:
            status.obs_hash = hash64(*(part.obs for _, part in frame.parts))
            status.action_hash = hash64(*(part.action for _, part in frame.parts))
        status.command_hash = hash64(
            command.joint_pos_target, command.joint_stiffness, command.joint_damping
        )
        status.tilt = 0.0 if state is None else self._tilt
        status.base_height = estimate.base_height
        status.support_margin = estimate.support_margin
        status.target_jump = self._target_jump(command)
        if self.fault is not None:
            status.fault = self.fault.fault.id
            status.fault_text = self.fault.text
        return status

    def _target_jump(self, command: g1_low_cmd_t) -> float:
        """Return the largest one-tick change of a position target [rad]; 0 without targets."""
        before, self._sent = self._sent, None
        if command.mode != g1_low_cmd_t.MODE_POSITION:
            return 0.0
        self._sent = np.asarray(command.joint_pos_target, np.float32)
        return 0.0 if before is None else float(np.abs(self._sent - before).max())
