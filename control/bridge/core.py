"""The bridge's decisions: from silence to a standing robot and back, one step at a time.

Pure: no bus, no clock. Inputs are handed in with their time, `output` says what the motors get.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from downbeat.control.bridge.lowcmd import NUM_JOINTS, LowCmdFrame
from downbeat.control.bridge.lowstate import StateDecoder
from downbeat.control.bridge.settings import BridgeSettings
from downbeat.control.bridge.stages import SILENT, Outbox, Stage
from downbeat.control.bridge.stand_pose import MAX_TILT_RAD, PoseRamp, tilt_of
from downbeat.control.bridge.watch import RobotWatch, sentence
from downbeat.lcm_types import estop_t, g1_low_cmd_t, operator_command_t

MAX_VALID_US = 200_000
"""However long a command says it is valid."""
OTHER_TIME_US = 1_000_000
"""A command stamped this far from now is on another time base."""
STEADY_STATES = 50
"""Good states before anything is decided."""
LISTEN_US = 500_000
"""Nobody else may command the robot for so long before we do."""
AUTO_DWELL_US = 500_000
AUTO_POSE_US = 2_000_000
"""Without a person's confirmations: time in each stage, and in the stand pose."""
ARM_PERIOD_US = 500_000


class BridgeCore:
    """One robot, one control process, and what stands between them."""

    def __init__(self, settings: BridgeSettings, lenient: bool = False, auto: bool = False) -> None:
        """Prepare.

        Args:
            settings: Of the operator.
            lenient: The other side is a simulator on the loopback interface: no remote and no
                motion service are needed, zeros mean "not filled in".
            auto: Every step confirms itself; for simulators only.
        """
        self.settings = settings
        self.decoder = StateDecoder(lenient)
        self.watch = RobotWatch(settings)
        self.outbox = Outbox()
        self.stage = Stage.CHECKING
        self.trip = ""
        """Why the bridge tripped; empty: it has not."""
        self.motion_service: str | None = "" if lenient else None
        """Name of the robot's own active motion service; empty: none; None: not known yet."""
        self.wants_release = False
        """The operator confirmed that the motion service may go."""
        self.commands_refused = 0
        self.first_jump_rad = float("nan")
        """Distance of the first position command from the measured pose."""
        self._lenient, self._auto = lenient, auto
        self._frame = LowCmdFrame()
        self._command: Any = None
        self._valid_until = 0
        self._held: bytes | None = None
        self._since = 0
        self._started = 0
        self._foreign_utime = 0
        self._foreign = 0
        self._is_limp = False
        self._armed_utime = 0
        self._arm_sent = 0
        self._ramp = PoseRamp(settings.ramp_s)
        self._zeros = np.zeros(NUM_JOINTS, np.float32)

    # ------------------------------------------------------------------ inputs

    def take_state(self, payload: bytes, utime: int) -> bool:
        """Take a LowState; returns whether it is good and `decoder` speaks of it."""
        if not self.decoder.take(payload):
            return False
        self.watch.take_state(self.decoder, utime)
        if self.watch.is_confirmed:
            self.confirm(utime)
        return True

    def take_command(self, msg: g1_low_cmd_t, utime: int) -> None:
        """Take a G1_LOW_CMD; one on another time base is counted and dropped."""
        if abs(msg.header.utime - utime) > OTHER_TIME_US:
            self.commands_refused += 1
            return
        self._command, self._held = msg, None
        self._valid_until = min(msg.valid_until_utime, utime + MAX_VALID_US)

    def take_estop(self, msg: estop_t, utime: int) -> None:
        """Take an ESTOP from the bus: whoever sends it."""
        if msg.level != estop_t.CLEAR and self.stage not in SILENT:
            self._trip(*sentence("estop_message", msg.source or "somebody"), utime, tell=False)

    def take_operator(self, command: int, utime: int) -> None:
        """Take an operator's command from the bus: CLEAR_TRIP and DISARM concern the bridge."""
        if command == operator_command_t.CLEAR_TRIP and self.stage is Stage.TRIPPED:
            if not self.watch.faults(utime):
                self.trip, self._is_limp = "", False
                self._go(Stage.DAMPING, utime)
        elif command == operator_command_t.DISARM and Stage.DAMPING < self.stage < Stage.TRIPPED:
            self._go(Stage.DAMPING, utime)

    def note_foreign(self, count: int, utime: int) -> None:
        """Take how many messages of another commander came since the last call."""
        if count == 0:
            return
        self._foreign += count
        self._foreign_utime = utime
        if self.stage not in SILENT:
            self._trip(*sentence("second_commander", str(self._foreign)), utime)

    def confirm(self, utime: int) -> None:
        """Take the operator's yes to the next step."""
        if self.stage is Stage.RELEASING:
            self.wants_release = True
        step = {
            Stage.ZERO_TORQUE: Stage.DAMPING,
            Stage.DAMPING: Stage.TO_POSE,
            Stage.TO_POSE: Stage.HANDOVER,
        }.get(self.stage)
        if step is not None and not self.hindrance(utime):
            self._go(step, utime)

    def hindrance(self, utime: int) -> str:
        """Say why the next step cannot be confirmed yet; empty: it can."""
        tilt = tilt_of(self.decoder.quat_wxyz)
        if self.stage in (Stage.DAMPING, Stage.TO_POSE) and tilt > MAX_TILT_RAD:
            return f"the robot leans by {tilt:.1f} rad, lift it"
        if self.stage is Stage.TO_POSE and not self._ramp.is_over(utime):
            return "it is still moving"
        return ""

    def leave(self, utime: int) -> None:
        """Begin to leave: through damping, unless the robot was never commanded."""
        self._go(Stage.LEAVING, utime)

    # ------------------------------------------------------------------ progress

    def missing(self, utime: int) -> str:
        """Say what is missing before the robot may be commanded; empty: nothing."""
        counters = self.decoder.counters
        if not self.watch.is_fresh(utime) or self.watch.num_states < STEADY_STATES:
            said = f", last was: {counters.last_reason}" if counters.last_reason else ""
            return f"no good state comes from the robot{said}"
        if not self._lenient and not self.watch.remote_heard:
            return "the remote is not heard; switch it on"
        if self.motion_service is None:
            return "the robot's motion service does not answer"
        if self._foreign_utime and utime - self._foreign_utime < LISTEN_US:
            return f"somebody else commands the robot ({self._foreign} messages)"
        if utime - self._started < LISTEN_US:
            return "listening whether somebody else commands the robot"
        if self.watch.battery_soc < self.settings.battery_start:
            return f"the battery is at {100 * self.watch.battery_soc:.0f} %, charge it"
        faults = self.watch.faults(utime)
        return faults[0][1] if faults else ""

    def update(self, utime: int) -> None:
        """Judge everything at `utime` [us] and take the step that is due."""
        self._started = self._started or utime
        if self.stage in SILENT:
            self._update_silent(utime)
            return
        if self.stage in (Stage.TRIPPED, Stage.LEAVING):
            return
        for row, text in self.watch.faults(utime):
            self._trip(row, text, utime)
            return
        if self.stage is Stage.ACTIVE:
            self._update_active(utime)
        elif self.stage is Stage.HANDOVER:
            self._update_handover(utime)
        elif self._auto:
            ramp_us = round(self.settings.ramp_s * 1e6)
            dwell_us = AUTO_POSE_US + ramp_us if self.stage is Stage.TO_POSE else AUTO_DWELL_US
            if utime - self._since > dwell_us:
                self.confirm(utime)

    def _update_silent(self, utime: int) -> None:
        if self.missing(utime):
            self.stage = Stage.CHECKING
        elif self.motion_service:
            if self.stage is not Stage.RELEASING:
                self.stage, self._since, self.wants_release = Stage.RELEASING, utime, False
            elif self._auto and utime - self._since > AUTO_DWELL_US:
                self.confirm(utime)
        else:
            self._go(Stage.ZERO_TORQUE, utime)

    def _update_handover(self, utime: int) -> None:
        command = self._command
        if (
            command is not None
            and command.mode == g1_low_cmd_t.MODE_POSITION
            and command.header.utime > self._armed_utime
            and utime < self._valid_until
        ):
            jump = np.abs(command.joint_pos_target - self.decoder.joint_pos)
            worst = int(jump.argmax())
            if jump[worst] <= self.settings.handover_rad:
                self._go(Stage.ACTIVE, utime)
                return
            text = f"its first target for motor {worst} is {jump[worst]:.2f} rad away"
            self._trip(*sentence("leaving_control", text), utime)
        elif (utime - self._since) * 1e-6 > self.settings.control_timeout_s:
            self._trip(*sentence("leaving_control", "no position command came"), utime)
        elif utime - self._arm_sent >= ARM_PERIOD_US:
            self._arm_sent = utime
            self.outbox.operator.append(operator_command_t.ARM)

    def _update_active(self, utime: int) -> None:
        late_us = utime - self._valid_until
        if late_us >= 0:
            self._trip(*sentence("command_expired", f"{late_us / 1e3:.0f} ms"), utime)
        elif self._command.mode == g1_low_cmd_t.MODE_DAMPING:
            self._trip(*sentence("control_passive", "damping"), utime, tell=False)
        elif self._command.mode == g1_low_cmd_t.MODE_ZERO_TORQUE:
            self._trip(*sentence("control_passive", "limp"), utime, tell=False)
            self._is_limp = True

    def _go(self, stage: Stage, utime: int) -> None:
        if stage is Stage.TO_POSE:
            self._ramp.begin(self.decoder.joint_pos, utime)
        if stage is Stage.HANDOVER:
            self._armed_utime, self._arm_sent = utime, 0
        self.stage, self._since, self._held = stage, utime, None

    def _trip(self, row: Any, text: str, utime: int, tell: bool = True) -> None:
        """Go to damping for good, and tell control."""
        if self.stage in (Stage.TRIPPED, Stage.LEAVING):
            return
        self.trip = text
        self._auto = False  # what went wrong once is not tried again without a person
        if tell:
            self.outbox.estops.append(text)
        self._go(Stage.TRIPPED, utime)

    def fail(self, text: str, utime: int) -> None:
        """Trip because the bridge itself is broken."""
        if self.stage not in SILENT:
            self._trip(*sentence("broken", text), utime)

    # ------------------------------------------------------------------ output

    @property
    def is_silent(self) -> bool:
        """Whether nothing has been sent to the motors yet."""
        return self.stage in SILENT

    def has_left(self, utime: int) -> bool:
        """Whether damping has gone on for long enough after `leave`."""
        since_s = (utime - self._since) * 1e-6
        return self.stage is Stage.LEAVING and since_s >= self.settings.leave_s

    def output(self, utime: int) -> bytes | None:
        """Return the LowCmd for this moment; None while the robot must not be commanded."""
        if self.stage in SILENT:
            return None
        if self.stage is Stage.ACTIVE and self._held is not None:
            return self._held  # the same command again: nothing in it changes
        frame, measured = self._frame, self.decoder.joint_pos
        frame.set_mode_machine(self.decoder.mode_machine)
        if self.stage is Stage.ZERO_TORQUE or (self._is_limp and self.stage is Stage.TRIPPED):
            frame.zero_torque(measured)
        elif self.stage in (Stage.TO_POSE, Stage.HANDOVER):
            ramp = self._ramp
            self._send_position(
                ramp.target(utime), self._zeros, self._zeros, ramp.stiffness, ramp.damping
            )
        elif self.stage is Stage.ACTIVE:
            command = self._command
            self._send_position(
                command.joint_pos_target,
                command.joint_vel_target,
                command.joint_torque_ff,
                command.joint_stiffness,
                command.joint_damping,
            )
            self._held = frame.payload()
            return self._held
        else:
            frame.damping(self.settings.damping, measured)
        return frame.payload()

    def _send_position(self, q: Any, dq: Any, tau: Any, kp: Any, kd: Any) -> None:
        if not self.first_jump_rad >= 0.0:  # NaN: none was sent yet
            self.first_jump_rad = float(np.abs(q - self.decoder.joint_pos).max())
        self._frame.position(q, dq, tau, kp, kd)
