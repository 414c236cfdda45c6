"""The channels of walk-these-ways style controllers, beside ours: states out, joint targets in.

Those controllers stamp nothing, number nothing and say nothing about how long a target holds. Here
a target holds for 100 ms from its arrival like any command of ours, and is checked before it
counts. `downbeat bridge --compat` puts them in control's place, after the same start-up.
"""

from __future__ import annotations

import logging
from typing import Any

import lcm
import numpy as np

from downbeat.catalog.robot import load_g1
from downbeat.control.bridge.core import BridgeCore
from downbeat.control.bridge.lowcmd import NUM_JOINTS
from downbeat.control.bridge.remote import BUTTONS, parse_remote
from downbeat.control.bridge.stand_pose import PoseRamp
from downbeat.control.tick import COMMAND_VALID_US
from downbeat.lcm_types import g1_low_cmd_t
from downbeat.lcm_types.compat import (
    body_control_data_lcmt,
    leg_control_data_lcmt,
    pd_tau_targets_29_lcmt,
    pd_tau_targets_lcmt,
    rc_command_lcmt,
    state_estimator_lcmt,
)
from downbeat.runtime.udpm import drain

log = logging.getLogger("downbeat.bridge")

TARGETS = "pd_plustau_targets"
PERIOD_US = 5_000
"""200 Hz."""
NUM_LEGS = 12
LIMITS = {
    "q_des": (-10.0, 10.0),
    "qd_des": (-200.0, 200.0),
    "tau_ff": (-1000.0, 1000.0),
    "kp": (0.0, 1e3),
    "kd": (0.0, 100.0),
}
"""[rad], [rad/s], [N m], gains; a target outside is dropped as a whole."""
_SWITCHES = {
    "left_upper_switch": "L1",
    "left_lower_left_switch": "L2",
    "right_upper_switch": "R1",
    "right_lower_right_switch": "R2",
}


class Compat:
    """Publishes what such a controller reads, and turns its targets into commands."""

    def __init__(self, link: Any, core: BridgeCore) -> None:
        """Subscribe.

        Args:
            link: An `lcm.LCM` of its own: these channels are not in our table.
            core: Takes the commands.
        """
        self._link, self._core = link, core
        self._next_utime = 0
        self._count = 0
        self._commands: list[Any] = []
        self.accepted = 0
        self.rejected: dict[str, int] = {}
        """Targets dropped, by reason."""
        ramp = PoseRamp(1.0)
        self._pose = np.asarray(load_g1().default_joint_pos, np.float32)  # (29,)
        self._stiffness, self._damping = ramp.stiffness, ramp.damping
        link.subscribe(TARGETS, self._arrived).set_queue_capacity(0)
        known: tuple[Any, ...] = (pd_tau_targets_lcmt, pd_tau_targets_29_lcmt)
        self._types = {c._get_packed_fingerprint(): (c, len(c().encode())) for c in known}

    def __call__(self, utime: int) -> None:
        """Take targets, and publish states when they are due at `utime` [us]."""
        drain(self._link)
        for command in self._commands[-1:]:
            command.header.utime = utime
            command.valid_until_utime = utime + COMMAND_VALID_US
            self._core.take_command(command, utime)
        self._commands.clear()
        if utime >= self._next_utime and self._core.watch.is_fresh(utime):
            # From the due time: cycles of 2 ms would make 6 ms of 5. Not from long ago, though.
            self._next_utime = max(self._next_utime, utime - PERIOD_US) + PERIOD_US
            self._publish(utime)

    # ------------------------------------------------------------------ targets in

    def _reject(self, reason: str) -> None:
        count = self.rejected[reason] = self.rejected.get(reason, 0) + 1
        if count & (count - 1) == 0:
            log.warning("dropped %d on %s: %s", count, TARGETS, reason)

    def _arrived(self, _channel: str, payload: bytes) -> None:
        """Decode and check; never raises."""
        cls, size = self._types.get(payload[:8], (None, 0))
        if cls is None:
            self._reject("unknown type")
            return
        if len(payload) != size:
            self._reject("wrong length")
            return
        msg: Any = cls.decode(payload)
        for name, (low, high) in LIMITS.items():
            values = np.asarray(getattr(msg, name, (0.0,)))
            if not bool(((values >= low) & (values <= high)).all()):  # also catches a NaN
                self._reject(f"{name} not finite or out of range")
                return
        self._commands.append(self._command(msg))
        self.accepted += 1

    def _command(self, msg: Any) -> Any:
        """Return a G1_LOW_CMD; joints without a target hold the stand pose."""
        count = len(msg.q_des)
        command: Any = g1_low_cmd_t()
        command.mode = g1_low_cmd_t.MODE_POSITION
        command.joint_pos_target = self._pose.copy()
        command.joint_vel_target = np.zeros(NUM_JOINTS, np.float32)
        command.joint_torque_ff = np.zeros(NUM_JOINTS, np.float32)
        command.joint_stiffness = self._stiffness.copy()
        command.joint_damping = self._damping.copy()
        command.joint_pos_target[:count] = msg.q_des
        command.joint_torque_ff[:count] = msg.tau_ff
        if count == NUM_LEGS:
            command.joint_vel_target[:count] = msg.qd_des
            command.joint_stiffness[:count] = msg.kp
            command.joint_damping[:count] = msg.kd
        return command

    # ------------------------------------------------------------------ states out

    def _publish(self, utime: int) -> None:
        decoder = self._core.decoder
        self._count += 1
        base: Any = state_estimator_lcmt()
        legs: Any = leg_control_data_lcmt()
        body: Any = body_control_data_lcmt()
        quat, gyro, accel, rpy = (part.tolist() for part in decoder.imu)
        base.quat, base.omegaBody, base.aBody, base.rpy = quat, gyro, accel, rpy
        base.omegaWorld, base.aWorld = _to_world(quat, gyro), _to_world(quat, accel)
        positions, speeds, torques = (part.tolist() for part in decoder.joints)
        legs.q, legs.qd = positions[:NUM_LEGS], speeds[:NUM_LEGS]
        legs.tau_est = torques[:NUM_LEGS]
        body.q, body.qd = positions, speeds
        base.timestamp_us = legs.timestamp_us = body.timestamp_us = utime
        base.id = legs.id = self._count
        self._link.publish("state_estimator_data", base.encode())
        self._link.publish("leg_control_data", legs.encode())
        self._link.publish("body_control_data", body.encode())
        self._link.publish("rc_command", self._rc().encode())

    def _rc(self) -> Any:
        remote = parse_remote(self._core.decoder.remote)
        msg: Any = rc_command_lcmt()
        msg.left_stick, msg.right_stick = list(remote.left_stick), list(remote.right_stick)
        for name, button in _SWITCHES.items():
            setattr(msg, name, remote.buttons >> BUTTONS.index(button) & 1)
        return msg


def open_compat(url: str, core: BridgeCore) -> Compat:
    """Open the channels on the show's own group."""
    return Compat(lcm.LCM(url), core)


def _to_world(quat: list[float], vector: list[float]) -> list[float]:
    """Rotate a vector from the base to the world: v + 2 q x (q x v + w v)."""
    w, x, y, z = quat
    a, b, c = vector
    tx = y * c - z * b + w * a
    ty = z * a - x * c + w * b
    tz = x * b - y * a + w * c
    return [
        a + 2.0 * (y * tz - z * ty),
        b + 2.0 * (z * tx - x * tz),
        c + 2.0 * (x * ty - y * tx),
    ]
