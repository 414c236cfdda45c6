"""Quaternions (w, x, y, z) over the array namespace, `(..., 4)`; no matrix product anywhere."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np

Array = Any


def quat_conjugate(q: Array, xp: ModuleType = np) -> Array:
    """Return the inverse rotation of a unit quaternion."""
    return xp.stack([q[..., 0], -q[..., 1], -q[..., 2], -q[..., 3]], axis=-1)


def quat_mul(a: Array, b: Array, xp: ModuleType = np) -> Array:
    """Return the rotation that does `b` first, then `a`."""
    aw, ax, ay, az = (a[..., i] for i in range(4))
    bw, bx, by, bz = (b[..., i] for i in range(4))
    return xp.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )  # (..., 4)


def quat_rotate(q: Array, v: Array, xp: ModuleType = np) -> Array:
    """Return the vectors `v` (..., 3) rotated by `q`."""
    w, x, y, z = (q[..., i] for i in range(4))
    vx, vy, vz = (v[..., i] for i in range(3))
    # t = 2 q x v;  v' = v + w t + q x t
    tx = 2.0 * (y * vz - z * vy)
    ty = 2.0 * (z * vx - x * vz)
    tz = 2.0 * (x * vy - y * vx)
    return xp.stack(
        [
            vx + w * tx + (y * tz - z * ty),
            vy + w * ty + (z * tx - x * tz),
            vz + w * tz + (x * ty - y * tx),
        ],
        axis=-1,
    )  # (..., 3)


def quat_rotate_inverse(q: Array, v: Array, xp: ModuleType = np) -> Array:
    """Return the vectors `v` (..., 3) seen from the frame `q`."""
    return quat_rotate(quat_conjugate(q, xp), v, xp)


def quat_about(axis: int, angle: Array, xp: ModuleType = np) -> Array:
    """Return the rotation by `angle` (...) [rad] about a coordinate axis, 0 x, 1 y, 2 z."""
    half = 0.5 * angle
    parts = [xp.cos(half), 0.0 * half, 0.0 * half, 0.0 * half]
    parts[1 + axis] = xp.sin(half)
    return xp.stack(parts, axis=-1)


def yaw_quat(yaw: Array, xp: ModuleType = np) -> Array:
    """Return the rotation by `yaw` (...) [rad] about the vertical."""
    return quat_about(2, yaw, xp)


def first_two_columns(q: Array, xp: ModuleType = np) -> Array:
    """Return the first two columns of the rotation matrix, row by row, (..., 6)."""
    w, x, y, z = (q[..., i] for i in range(4))
    return xp.stack(
        [
            1.0 - 2.0 * (y * y + z * z),
            2.0 * (x * y - w * z),
            2.0 * (x * y + w * z),
            1.0 - 2.0 * (x * x + z * z),
            2.0 * (x * z - w * y),
            2.0 * (y * z + w * x),
        ],
        axis=-1,
    )
