"""From the bytes of a LowState to the bytes of a G1_LOW_STATE in one gather.

Both are fixed layouts, little-endian there and big-endian here: byte k of the message is byte
INDEX[k] of a workspace that holds the robot's bytes first and what is not the robot's after them.
One numpy operation takes the place of decoding forty fields and encoding them again.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from downbeat.control.bridge.layout import (
    STATE_BYTES,
    STATE_FIRST_MOTOR,
    STATE_HEAD,
    STATE_MOTOR,
    STATE_REMOTE,
)
from downbeat.control.bridge.lowcmd import NUM_JOINTS
from downbeat.lcm_types import g1_low_state_t
from downbeat.runtime.codec_layout import ITEM_SIZES, layout_of

IMU_NUMBERS = 13
HEAD_BYTES = 4
"""Of encapsulation."""

_IMU_FIELDS = {"quat": "quaternion", "gyro": "gyroscope", "accel": "accelerometer", "rpy": "rpy"}
_MOTOR_FIELDS = {
    "joint_pos": ("q", 0),
    "joint_vel": ("dq", 0),
    "joint_torque_est": ("tau_est", 0),
    "temperature_case": ("temperature", 0),
    "temperature_winding": ("temperature", 2),
    "motor_fault": ("motorstate", 0),
}


def offsets() -> dict[tuple[str, ...], int]:
    """Return where each field of G1_LOW_STATE begins in its payload."""
    found, offset = {}, 8  # behind the fingerprint
    for leaf in layout_of(g1_low_state_t).leaves:
        found[leaf.path] = offset
        offset += leaf.size
    found[()] = offset
    return found


def _head_offset(name: str) -> int:
    fields: Any = STATE_HEAD.fields
    return int(fields[name][1])


def _source(path: tuple[str, ...], item: int, size: int) -> int | None:
    """Return where item `item` of a field lies in a LowState; None if it is not the robot's."""
    if path[0] == "imu_pelvis":
        name = _IMU_FIELDS.get(path[1])
        if path[1] == "temperature":
            return _head_offset("imu_temperature")
        return None if name is None else _head_offset(name) + item * size
    if path[0] in _MOTOR_FIELDS:
        name, extra = _MOTOR_FIELDS[path[0]]
        fields: Any = STATE_MOTOR.fields
        return STATE_FIRST_MOTOR + item * STATE_MOTOR.itemsize + int(fields[name][1]) + extra
    if path[0] in ("mode_pr", "mode_machine"):
        return _head_offset(path[0])
    if path[0] == "wireless_remote":
        return int(STATE_REMOTE.start) + item
    return None


def gather_index() -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Return INDEX: for each byte of the payload its place in the workspace.

    The workspace is a LowState (2092 bytes) and behind it a whole G1_LOW_STATE payload, from which
    come the bytes that are not the robot's.
    """
    places = offsets()
    size = places[()]
    index = STATE_BYTES + np.arange(size)
    for leaf in layout_of(g1_low_state_t).leaves:
        width = ITEM_SIZES[leaf.code]
        for item in range(leaf.count):
            source = _source(leaf.path, item, width)
            if source is None:
                continue
            start = places[leaf.path] + item * width
            for byte in range(width):
                index[start + byte] = source + width - 1 - byte  # little to big endian
    return index


def _float_offsets() -> list[int]:
    motor: Any = STATE_MOTOR.fields
    joints = [
        STATE_FIRST_MOTOR + joint * STATE_MOTOR.itemsize + int(motor[name][1])
        for name in ("q", "dq", "tau_est")
        for joint in range(NUM_JOINTS)
    ]
    quaternion = _head_offset("quaternion")
    return joints + [quaternion + 4 * number for number in range(IMU_NUMBERS)]


FLOAT_WORDS = np.array(_float_offsets()) // 4
"""(100,) 32-bit words of a LowState: 29 positions, speeds, torques, then 13 of the IMU."""
_FAULT = STATE_FIRST_MOTOR + 32
FAULT_WORDS = np.array([_FAULT + i * STATE_MOTOR.itemsize for i in range(NUM_JOINTS)]) // 4
"""(29,) 32-bit words of motorstate."""
_HEAT = STATE_FIRST_MOTOR + 16
HEAT_HALVES = (
    np.array(
        [[_HEAT + 2 * k + i * STATE_MOTOR.itemsize for i in range(NUM_JOINTS)] for k in (0, 1)]
    )
    // 2
)
"""(2, 29) 16-bit words: temperature of casing, winding."""
