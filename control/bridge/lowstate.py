"""LowState as bytes: what a robot reports in, G1_LOW_STATE out, and everything wrong named."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from downbeat.control.bridge.crc import crc32_words
from downbeat.control.bridge.layout import (
    LITTLE_ENDIAN_HEADS,
    NUM_SLOTS,
    STATE_BYTES,
    STATE_CRC,
    STATE_FIRST_MOTOR,
    STATE_HEAD,
    STATE_MOTOR,
    STATE_REMOTE,
    state_image,
)
from downbeat.control.bridge.lowcmd import NUM_JOINTS
from downbeat.control.bridge.tick_guard import TickGuard, TickVerdict
from downbeat.lcm_types import g1_low_state_t, imu_t

MODE_MACHINES = {
    0: "simulation",
    1: "23 dof",
    2: "29 dof",
    3: "29 dof, waist locked",
    4: "23 dof rev 1.0",
    5: "29 dof rev 1.0",
    6: "29 dof rev 1.0, waist locked",
    9: "dual arm",
}
OURS = 5
"""mode_machine of the 29 dof robot, rev 1.0: the one that the model and the skills are made for."""
LIMITS = np.array([[10.0], [200.0], [1e3]], np.float32)
"""[rad], [rad/s], [N m] as in `runtime/field_rules.py`; beyond is damage, not a measurement."""
IMU_LIMIT = 1e4
QUATERNION_TOLERANCE = 0.01
IMU_BYTES = 4 + 13 * 4 + 2

BAD_LENGTH = "wrong length"
BAD_ENCODING = "wrong encapsulation"
BAD_CRC = "wrong CRC"
BAD_MODE = "wrong mode_machine"
BAD_TICK = "tick went backwards"
BAD_MOTOR = "motor value not finite or out of range"
BAD_IMU = "IMU value not finite or out of range"


@dataclass(slots=True)
class StateCounters:
    """What came in.

    Attributes:
        accepted: States passed on or superseded by a newer one.
        lost: Gaps in the tick.
        rejected: Never passed on, by reason.
        restarts: Times that the robot's tick began again.
        last_reason: Of the last rejection, with the values that were wrong.
    """

    accepted: int = 0
    lost: int = 0
    restarts: int = 0
    rejected: dict[str, int] = field(default_factory=dict)
    last_reason: str = ""

    def reject(self, reason: str, detail: str = "") -> None:
        """Count and name one that is not passed on."""
        self.rejected[reason] = self.rejected.get(reason, 0) + 1
        self.last_reason = f"{reason}: {detail}" if detail else reason


class StateDecoder:
    """Reads LowState bytes into one reused G1_LOW_STATE message."""

    def __init__(self, lenient: bool = False) -> None:
        """Prepare.

        Args:
            lenient: For simulators on the loopback interface: a checksum, a tick or a mode_machine
                of zero means "not filled in". A robot fills them in.
        """
        self.counters = StateCounters()
        self.msg = new_state()
        self.mode_machine = 0
        self.mode_seen: int | None = None
        self._lenient = lenient
        self._ticks = TickGuard()
        self._values = np.zeros((3, NUM_JOINTS), np.float32)
        self._magnitude = np.zeros((3, NUM_JOINTS), np.float32)

    def take(self, payload: bytes) -> bool:
        """Judge one sample and, if it is good, fill `msg`; the caller stamps it.

        Returns:
            Whether `msg` now holds it. A bad one is counted by name, and `msg` keeps what it had.
        """
        reason = self._envelope(payload)
        if reason:
            self.counters.reject(reason, self._detail(reason, payload))
            return False
        head = np.frombuffer(payload, STATE_HEAD, 1)[0]
        motors = np.frombuffer(payload, STATE_MOTOR, NUM_SLOTS, STATE_FIRST_MOTOR)[:NUM_JOINTS]
        values = self._values
        values[0] = motors["q"]
        values[1] = motors["dq"]
        values[2] = motors["tau_est"]
        np.abs(values, out=self._magnitude)
        if not bool((self._magnitude <= LIMITS).all()):  # also catches a NaN
            self.counters.reject(BAD_MOTOR, f"motor {self._worst()}")
            return False
        imu = np.frombuffer(payload, "<f4", 13, 20)  # (13,) quat, gyro, accel, rpy
        if not self._take_imu(self.msg.imu_pelvis, imu, int(head["imu_temperature"])):
            self.counters.reject(BAD_IMU)
            return False
        if not self._in_order(int(head["tick"])):
            return False
        self._fill(head, motors, payload)
        self.counters.accepted += 1
        return True

    def _envelope(self, payload: bytes) -> str:
        """Return what is wrong with length, encoding, checksum or robot; empty: nothing."""
        if len(payload) != STATE_BYTES:
            return BAD_LENGTH
        if payload[0:2] not in LITTLE_ENDIAN_HEADS:
            return BAD_ENCODING
        stored = int.from_bytes(payload[STATE_CRC], "little")
        is_unfilled = self._lenient and stored == 0
        if not is_unfilled and stored != crc32_words(state_image(payload)):
            return BAD_CRC
        self.mode_seen = payload[13]
        if self.mode_seen != OURS and not (self._lenient and self.mode_seen == 0):
            return BAD_MODE
        return ""

    def _detail(self, reason: str, payload: bytes) -> str:
        if reason == BAD_LENGTH:
            return f"{len(payload)} bytes, valid are {STATE_BYTES}"
        if reason == BAD_MODE:
            name = MODE_MACHINES.get(payload[13], "unknown")
            return f"{payload[13]} ({name}), valid is {OURS} ({MODE_MACHINES[OURS]})"
        return ""

    def _worst(self) -> int:
        bad = ~(self._magnitude <= LIMITS)
        return int(bad.any(axis=0).argmax())

    def _take_imu(self, imu: Any, numbers: Any, temperature: int) -> bool:
        """Check and copy 13 floats; False, and nothing copied, if they cannot be."""
        w, x, y, z = numbers[:4].tolist()
        norm = w * w + x * x + y * y + z * z
        if not abs(norm - 1.0) <= QUATERNION_TOLERANCE:
            return False
        if not float(np.abs(numbers[4:]).max()) <= IMU_LIMIT:
            return False
        imu.quat[:] = numbers[:4]
        imu.gyro[:] = numbers[4:7]
        imu.accel[:] = numbers[7:10]
        imu.rpy[:] = _roll_pitch_yaw(w, x, y, z)  # some simulators leave theirs at zero
        imu.temperature = temperature
        return True

    def _in_order(self, tick: int) -> bool:
        verdict = self._ticks.judge(tick)
        self.counters.lost = self._ticks.lost
        if verdict is TickVerdict.BACKWARDS:
            self.counters.reject(BAD_TICK, str(tick))
            return False
        if verdict is TickVerdict.RESTARTED:
            self.counters.restarts += 1
        return True

    def _fill(self, head: Any, motors: Any, payload: bytes) -> None:
        msg, values = self.msg, self._values
        self.mode_machine = msg.mode_machine = payload[13]
        msg.mode_pr = payload[12]
        msg.tick = int(head["tick"])
        msg.joint_pos[:] = values[0]
        msg.joint_vel[:] = values[1]
        msg.joint_torque_est[:] = values[2]
        temperature = motors["temperature"]  # (29, 2) casing, winding
        msg.temperature_case[:] = temperature[:, 0]
        msg.temperature_winding[:] = temperature[:, 1]
        msg.motor_fault[:] = motors["motorstate"].view("<i4")
        msg.wireless_remote = payload[STATE_REMOTE]

    def take_torso_imu(self, payload: bytes) -> bool:
        """Copy an IMUState sample (rt/secondary_imu); a bad one is counted and not used."""
        if len(payload) < IMU_BYTES or payload[0:2] not in LITTLE_ENDIAN_HEADS:
            self.counters.reject(BAD_LENGTH, "secondary IMU")
            return False
        numbers = np.frombuffer(payload, "<f4", 13, 4)
        temperature = int.from_bytes(payload[56:58], "little", signed=True)
        if self._take_imu(self.msg.imu_torso, numbers, temperature):
            return True
        self.counters.reject(BAD_IMU, "secondary IMU")
        return False

    def forget_torso_imu(self) -> None:
        """Mark the torso's IMU as unknown: nothing came for too long."""
        _mark_unknown(self.msg.imu_torso)


def _roll_pitch_yaw(w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return roll, pitch, yaw


def new_state() -> Any:
    """Return an empty G1_LOW_STATE with arrays of the wire's types."""
    msg: Any = g1_low_state_t()
    for name in ("joint_pos", "joint_vel", "joint_torque_est"):
        setattr(msg, name, np.zeros(NUM_JOINTS, np.float32))
    for name in ("temperature_case", "temperature_winding"):
        setattr(msg, name, np.full(NUM_JOINTS, -1, np.int16))
    msg.motor_fault = np.zeros(NUM_JOINTS, np.int32)
    # Simulators on DDS count as robots too: a rehearsal has the rules of the performance.
    msg.source = g1_low_state_t.SOURCE_HARDWARE
    msg.imu_pelvis, msg.imu_torso = _new_imu(), _new_imu()
    _mark_unknown(msg.imu_torso)
    msg.battery_soc = math.nan
    msg.wireless_remote = bytes(40)
    return msg


def _new_imu() -> Any:
    imu: Any = imu_t()
    imu.quat = np.array([1.0, 0.0, 0.0, 0.0], np.float32)
    imu.gyro = np.zeros(3, np.float32)
    imu.accel = np.zeros(3, np.float32)
    imu.rpy = np.zeros(3, np.float32)
    imu.temperature = -1
    return imu


def _mark_unknown(imu: Any) -> None:
    for name in ("quat", "gyro", "accel", "rpy"):
        getattr(imu, name)[:] = math.nan
    imu.temperature = -1
