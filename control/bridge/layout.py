"""Where everything lies in the bytes of LowCmd and LowState.

On the wire (CDR, little-endian, 4 bytes of encapsulation first) every field stands at a multiple of
its own size; in the C struct whose image the checksum covers, a motor also begins at a multiple of
4. The two differ only at the first motor: two bytes on the wire, four in the image. Everything
after it is the same, so that one numpy view reads all motors and one join makes the image.
"""

from __future__ import annotations

import numpy as np

NUM_SLOTS = 35
CDR_HEAD = b"\x00\x01\x00\x00"
"""Encapsulation that we write: plain CDR, little-endian."""
LITTLE_ENDIAN_HEADS = (b"\x00\x01", b"\x00\x07")
"""Encapsulations that we read; for these types plain CDR and XCDR2 lie the same."""

CMD_BYTES = 1004
"""Of a LowCmd on the wire, with the encapsulation."""
CMD_FIRST_MOTOR = 8
"""Offset of the first motor's `q`, with the encapsulation; its `mode` stands two bytes earlier."""
STATE_BYTES = 2092
STATE_FIRST_MOTOR = 76

CMD_MOTOR = np.dtype(
    [
        ("q", "<f4"),
        ("dq", "<f4"),
        ("tau", "<f4"),
        ("kp", "<f4"),
        ("kd", "<f4"),
        ("reserve", "<u4"),
        ("next_mode", "u1"),
        ("pad", "V3"),
    ]
)
"""One motor from its `q` to the next motor's `mode`, 28 bytes."""

STATE_HEAD = np.dtype(
    [
        ("encapsulation", "V4"),
        ("version", "<u4", 2),
        ("mode_pr", "u1"),
        ("mode_machine", "u1"),
        ("pad", "V2"),
        ("tick", "<u4"),
        ("quaternion", "<f4", 4),
        ("gyroscope", "<f4", 3),
        ("accelerometer", "<f4", 3),
        ("rpy", "<f4", 3),
        ("imu_temperature", "<i2"),
        ("first_mode", "u1"),
        ("pad2", "V1"),
    ]
)
"""A LowState up to the first motor's `q`, 76 bytes."""

STATE_MOTOR = np.dtype(
    [
        ("q", "<f4"),
        ("dq", "<f4"),
        ("ddq", "<f4"),
        ("tau_est", "<f4"),
        ("temperature", "<i2", 2),
        ("vol", "<f4"),
        ("sensor", "<u4", 2),
        ("motorstate", "<u4"),
        ("reserve", "<u4", 4),
        ("next_mode", "u1"),
        ("pad", "V3"),
    ]
)
"""One motor from its `q` to the next motor's `mode`, 56 bytes."""

_STATE_REMOTE = STATE_FIRST_MOTOR + NUM_SLOTS * STATE_MOTOR.itemsize - 4
STATE_REMOTE = slice(_STATE_REMOTE, _STATE_REMOTE + 40)
"""wireless_remote; the last motor has no next one behind it."""
STATE_CRC = slice(STATE_BYTES - 4, STATE_BYTES)
CMD_CRC = slice(CMD_BYTES - 4, CMD_BYTES)


def _mask(size: int, used: list[tuple[int, int]]) -> np.ndarray[tuple[int], np.dtype[np.uint8]]:
    """Return 0xFF where a field lies, 0 in the gaps; offsets without the encapsulation."""
    mask = np.zeros(size, np.uint8)
    for start, count in used:
        mask[start : start + count] = 0xFF
    return mask


def _state_mask() -> np.ndarray[tuple[int], np.dtype[np.uint8]]:
    first = STATE_FIRST_MOTOR - 4
    used = [(0, 10), (12, 59)]
    for slot in range(NUM_SLOTS):
        start = first + slot * STATE_MOTOR.itemsize
        used.append((start, 53 if slot < NUM_SLOTS - 1 else 52))
    used.append((_STATE_REMOTE - 4, 40 + 16 + 4))
    return _mask(STATE_BYTES - 4, used)


_STATE_MASK = _state_mask()


def plain_state_image(payload: bytes) -> bytes:
    """Return the same as `state_image` for a sender that leaves zeros in the gaps, as most do."""
    return b"".join((payload[4:74], b"\x00\x00", payload[74:75], b"\x00\x00\x00", payload[76:-4]))


def state_image(payload: bytes) -> bytes:
    """Return the C struct image of a LowState on the wire, without its checksum, 2088 bytes.

    Gaps are zeroed: what a sender leaves in them is no part of its struct.
    """
    body = np.frombuffer(payload, np.uint8, STATE_BYTES - 4, 4) & _STATE_MASK
    return plain_state_image(payload[:4] + body.tobytes())


def cmd_image(payload: bytes | bytearray) -> bytes:
    """Return the C struct image of a LowCmd on the wire, without its checksum, 1000 bytes.

    Its gaps must be zero, as they are in what we write.
    """
    return (
        bytes(payload[4:6])
        + b"\x00\x00"
        + bytes(payload[6:7])
        + b"\x00\x00\x00"
        + bytes(payload[8:-4])
    )
