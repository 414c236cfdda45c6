"""LowState as bytes: what a robot reports in, G1_LOW_STATE bytes out, everything wrong named."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from downbeat.control.bridge.crc import crc32_words
from downbeat.control.bridge.layout import (
    LITTLE_ENDIAN_HEADS,
    STATE_BYTES,
    STATE_CRC,
    STATE_REMOTE,
    plain_state_image,
    state_image,
)
from downbeat.control.bridge.lowcmd import NUM_JOINTS
from downbeat.control.bridge.state_map import (
    FAULT_WORDS,
    FLOAT_WORDS,
    HEAT_HALVES,
    IMU_NUMBERS,
    gather_index,
    offsets,
)
from downbeat.control.bridge.tick_guard import TickGuard, TickVerdict
from downbeat.lcm_types import g1_low_state_t, imu_t
from downbeat.runtime.codec import codec_for

F32 = npt.NDArray[np.float32]

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
_JOINT_LIMITS = np.repeat(np.array([10.0, 200.0, 1e3], np.float32), NUM_JOINTS)
_IMU_LIMITS = np.array([1.01] * 4 + [200.0] * 3 + [1e4] * 3 + [6.3] * 3, np.float32)
LIMITS = np.concatenate([_JOINT_LIMITS, _IMU_LIMITS])
"""(100,) as in `runtime/field_rules.py`; beyond is damage, not a measurement."""
_IMU_FROM = 3 * NUM_JOINTS
QUATERNION_TOLERANCE = 0.01
IMU_BYTES = 4 + IMU_NUMBERS * 4 + 2

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
    """Judges LowState bytes and turns the newest good one into G1_LOW_STATE bytes."""

    def __init__(self, lenient: bool = False) -> None:
        """Prepare.

        Args:
            lenient: For simulators on the loopback interface: a checksum, a tick or a mode_machine
                of zero means "not filled in". A robot fills them in.
        """
        self.counters = StateCounters()
        self.mode_machine = 0
        self.battery_soc = math.nan
        self._lenient = lenient
        self._ticks = TickGuard()
        self._tick = 0
        self._index = gather_index()
        self._places = offsets()
        blank = codec_for(g1_low_state_t).encode(_blank_state())
        # The robot's bytes, and behind them a message that supplies all the others.
        self._space = np.zeros(STATE_BYTES + len(blank), np.uint8)
        self._space[STATE_BYTES:] = np.frombuffer(blank, np.uint8)
        self._words: npt.NDArray[np.uint32] = self._space[:STATE_BYTES].view("<u4")
        self._floats = self._space[:STATE_BYTES].view("<f4")
        self._halves: npt.NDArray[np.int16] = self._space[:STATE_BYTES].view("<i2")
        self._candidate = np.zeros(len(LIMITS), np.float32)
        self._magnitude = np.zeros(len(LIMITS), np.float32)
        self._within = np.zeros(len(LIMITS), np.bool_)
        self._good = np.zeros(len(LIMITS), np.float32)
        self.joint_pos: F32 = self._good[:NUM_JOINTS]
        """(29,) [rad] of the newest good state."""

    def take(self, payload: bytes) -> bool:
        """Judge one sample.

        Returns:
            Whether it is good; everything here then speaks of it. A bad one is counted by name,
            and everything stays as it was.
        """
        reason = self._envelope(payload)
        if reason:
            self.counters.reject(reason, self._detail(reason, payload))
            return False
        values = self._candidate
        np.take(np.frombuffer(payload, "<f4"), FLOAT_WORDS, out=values)
        np.abs(values, out=self._magnitude)
        within = np.less_equal(self._magnitude, LIMITS, out=self._within)
        if not within.all():  # also catches a NaN
            worst = int(within.argmin())
            is_motor = worst < _IMU_FROM
            detail = f"motor {worst % NUM_JOINTS}" if is_motor else ""
            self.counters.reject(BAD_MOTOR if is_motor else BAD_IMU, detail)
            return False
        w, x, y, z = values[_IMU_FROM : _IMU_FROM + 4].tolist()
        if not abs(w * w + x * x + y * y + z * z - 1.0) <= QUATERNION_TOLERANCE:
            self.counters.reject(BAD_IMU, "no unit quaternion")
            return False
        if not self._in_order(int.from_bytes(payload[16:20], "little")):
            return False
        self._good[:] = values
        self._space[:STATE_BYTES] = np.frombuffer(payload, np.uint8)
        self.mode_machine = payload[13]
        self.counters.accepted += 1
        return True

    def _envelope(self, payload: bytes) -> str:
        """Return what is wrong with length, encoding, checksum or robot; empty: nothing."""
        if len(payload) != STATE_BYTES:
            return BAD_LENGTH
        if payload[0:2] not in LITTLE_ENDIAN_HEADS:
            return BAD_ENCODING
        stored = int.from_bytes(payload[STATE_CRC], "little")
        if (
            stored != crc32_words(plain_state_image(payload))
            and stored != crc32_words(state_image(payload))
            and not (self._lenient and stored == 0)
        ):
            return BAD_CRC
        mode = payload[13]
        if mode != OURS and not (self._lenient and mode == 0):
            return BAD_MODE
        return ""

    def _detail(self, reason: str, payload: bytes) -> str:
        if reason == BAD_LENGTH:
            return f"{len(payload)} bytes, valid are {STATE_BYTES}"
        if reason == BAD_MODE:
            name = MODE_MACHINES.get(payload[13], "unknown")
            return f"{payload[13]} ({name}), valid is {OURS} ({MODE_MACHINES[OURS]})"
        return ""

    def _in_order(self, tick: int) -> bool:
        verdict = self._ticks.judge(tick)
        self.counters.lost = self._ticks.lost
        if verdict is TickVerdict.BACKWARDS:
            self.counters.reject(BAD_TICK, str(tick))
            return False
        if verdict is TickVerdict.RESTARTED:
            self.counters.restarts += 1
        self._tick = tick
        return True

    # ------------------------------------------------------------------ the newest good state

    @property
    def quat_wxyz(self) -> F32:
        """(4,) of the pelvis."""
        return self._good[_IMU_FROM : _IMU_FROM + 4]

    @property
    def joints(self) -> tuple[F32, F32, F32]:
        """Positions [rad], speeds [rad/s], torques [N m], (29,) each."""
        joints = self._good[:_IMU_FROM].reshape(3, NUM_JOINTS)
        return joints[0], joints[1], joints[2]

    @property
    def imu(self) -> tuple[F32, F32, F32, F32]:
        """Quaternion wxyz (4,), gyro, accelerometer and roll, pitch, yaw (3,) of the pelvis."""
        numbers = self._good[_IMU_FROM:]
        return numbers[:4], numbers[4:7], numbers[7:10], numbers[10:]

    @property
    def motor_faults(self) -> npt.NDArray[np.uint32]:
        """(29,) vendor flags; 0: healthy."""
        return np.take(self._words, FAULT_WORDS)

    @property
    def temperatures(self) -> npt.NDArray[np.int16]:
        """(2, 29) [deg C] casing, winding."""
        return np.take(self._halves, HEAT_HALVES)

    @property
    def remote(self) -> bytes:
        """The remote's frame, 40 bytes."""
        return self._space[STATE_REMOTE].tobytes()

    def message(self, utime: int) -> bytearray:
        """Return the newest good state as a G1_LOW_STATE payload; seq and epoch are the bus's.

        Args:
            utime: Of the measurement [us].
        """
        payload = bytearray(self._space[self._index])
        struct.pack_into(">q", payload, self._places[("header", "utime")], utime)
        struct.pack_into(">q", payload, self._places[("tick",)], self._tick)
        struct.pack_into(">f", payload, self._places[("battery_soc",)], self.battery_soc)
        if self._lenient:  # some simulators leave the angles at zero
            angles = _roll_pitch_yaw(*self.quat_wxyz.tolist())
            struct.pack_into(">3f", payload, self._places[("imu_pelvis", "rpy")], *angles)
        return payload

    # ------------------------------------------------------------------ the torso's IMU

    def take_torso_imu(self, payload: bytes) -> bool:
        """Take an IMUState sample (rt/secondary_imu); a bad one is counted and not used."""
        if len(payload) < IMU_BYTES or payload[0:2] not in LITTLE_ENDIAN_HEADS:
            self.counters.reject(BAD_LENGTH, "secondary IMU")
            return False
        numbers = np.frombuffer(payload, "<f4", IMU_NUMBERS, 4)
        norm = float((numbers[:4] * numbers[:4]).sum())
        is_good = abs(norm - 1.0) <= QUATERNION_TOLERANCE
        if not (is_good and bool((np.abs(numbers) <= _IMU_LIMITS).all())):
            self.counters.reject(BAD_IMU, "secondary IMU")
            return False
        big = numbers.byteswap().tobytes() + payload[57:55:-1]
        self._write_torso(big)
        return True

    def forget_torso_imu(self) -> None:
        """Mark the torso's IMU as unknown: nothing came for too long."""
        self._write_torso(struct.pack(">13fh", *[math.nan] * IMU_NUMBERS, -1))

    def _write_torso(self, big_endian: bytes) -> None:
        start = STATE_BYTES + self._places[("imu_torso", "quat")]
        self._space[start : start + len(big_endian)] = np.frombuffer(big_endian, np.uint8)


def _roll_pitch_yaw(w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return roll, pitch, yaw


def _blank_state() -> Any:
    """Return a G1_LOW_STATE of which everything the robot reports is still empty."""
    msg: Any = g1_low_state_t()
    # Simulators on DDS count as robots too: a rehearsal has the rules of the performance.
    msg.source = g1_low_state_t.SOURCE_HARDWARE
    msg.wireless_remote = bytes(40)
    msg.imu_torso = imu_t()
    for name, count in (("quat", 4), ("gyro", 3), ("accel", 3), ("rpy", 3)):
        setattr(msg.imu_torso, name, [math.nan] * count)
    msg.imu_torso.temperature = -1
    msg.battery_soc = math.nan
    return msg
