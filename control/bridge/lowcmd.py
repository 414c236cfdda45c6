"""LowCmd as bytes: G1_LOW_CMD in, what the motors obey out."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from downbeat.control.bridge.crc import crc32_words
from downbeat.control.bridge.layout import (
    CDR_HEAD,
    CMD_BYTES,
    CMD_CRC,
    CMD_FIRST_MOTOR,
    CMD_MOTOR,
    NUM_SLOTS,
    cmd_image,
)

F32 = npt.NDArray[np.float32]

NUM_JOINTS = 29
MODE_ENABLE = 1
_MODE_PR, _MODE_MACHINE, _FIRST_MODE = 4, 5, 6


class LowCmdFrame:
    """One LowCmd that is written over and over; every `payload` carries a fresh checksum.

    The ankles and the waist are commanded in pitch and roll (mode_pr 0), the 29 motors enabled,
    the six spare slots zero.
    """

    def __init__(self) -> None:
        self._bytes = bytearray(CMD_BYTES)
        self._bytes[0:4] = CDR_HEAD
        self._bytes[_FIRST_MODE] = MODE_ENABLE
        motors = np.frombuffer(self._bytes, CMD_MOTOR, NUM_SLOTS - 1, CMD_FIRST_MOTOR)
        motors["next_mode"][: NUM_JOINTS - 1] = MODE_ENABLE
        used = motors[:NUM_JOINTS]
        self._q, self._dq, self._tau = used["q"], used["dq"], used["tau"]
        self._kp, self._kd = used["kp"], used["kd"]

    def set_mode_machine(self, mode_machine: int) -> None:
        """Echo what the robot says it is."""
        self._bytes[_MODE_MACHINE] = mode_machine

    def position(self, q: F32, dq: F32, tau: F32, kp: F32, kd: F32) -> None:
        """Command targets, (29,) each, motor order: [rad], [rad/s], [N m], gains."""
        self._q[:] = q
        self._dq[:] = dq
        self._tau[:] = tau
        self._kp[:] = kp
        self._kd[:] = kd

    def damping(self, kd: float | F32, measured: F32) -> None:
        """Brake every joint. Targets are the measured pose: harmless if a gain is misread."""
        self._q[:] = measured
        self._dq[:] = 0.0
        self._tau[:] = 0.0
        self._kp[:] = 0.0
        self._kd[:] = kd

    def zero_torque(self, measured: F32) -> None:
        """Let every joint go."""
        self.damping(0.0, measured)

    def payload(self) -> bytes:
        """Return the wire bytes with their checksum."""
        checksum = crc32_words(cmd_image(self._bytes))
        self._bytes[CMD_CRC] = checksum.to_bytes(4, "little")
        return bytes(self._bytes)


class LowCmdView:
    """A LowCmd that came over the wire, as a robot reads it. Arrays are (29,) float64."""

    def __init__(self, payload: bytes) -> None:
        """Read it; the length must be right."""
        motors = np.frombuffer(payload, CMD_MOTOR, NUM_SLOTS - 1, CMD_FIRST_MOTOR)[:NUM_JOINTS]
        self.mode_machine = payload[_MODE_MACHINE]
        self.modes = bytes([payload[_FIRST_MODE], *motors["next_mode"][:-1].tolist()])
        self.q = motors["q"].astype(np.float64)  # (29,)
        self.dq = motors["dq"].astype(np.float64)  # (29,)
        self.tau = motors["tau"].astype(np.float64)  # (29,)
        self.kp = motors["kp"].astype(np.float64)  # (29,)
        self.kd = motors["kd"].astype(np.float64)  # (29,)
        stored = int.from_bytes(payload[CMD_CRC], "little")
        self.is_intact = stored == crc32_words(cmd_image(payload))
