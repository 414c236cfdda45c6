"""Vectors and rotations in plain floats: for single ones, in the tick, faster than numpy."""

from __future__ import annotations

from collections.abc import Sequence

Vec3 = tuple[float, float, float]
Rotation = tuple[Vec3, Vec3, Vec3]
"""Rows of a rotation matrix."""


def rotation_of(quat_wxyz: Sequence[float]) -> Rotation:
    """Return the rotation matrix of a quaternion of any length but zero."""
    w, x, y, z = quat_wxyz
    s = 2.0 / (w * w + x * x + y * y + z * z)
    return (
        (1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)),
        (s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x)),
        (s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y)),
    )


def turn(rotation: Rotation, vector: Vec3) -> Vec3:
    """Return the vector turned."""
    x, y, z = vector
    a, b, c = rotation
    return (
        a[0] * x + a[1] * y + a[2] * z,
        b[0] * x + b[1] * y + b[2] * z,
        c[0] * x + c[1] * y + c[2] * z,
    )


def turn_back(rotation: Rotation, vector: Vec3) -> Vec3:
    """Return the vector turned by the inverse."""
    x, y, z = vector
    a, b, c = rotation
    return (
        a[0] * x + b[0] * y + c[0] * z,
        a[1] * x + b[1] * y + c[1] * z,
        a[2] * x + b[2] * y + c[2] * z,
    )


def cross(a: Vec3, b: Vec3) -> Vec3:
    """Return a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def plus(a: Vec3, b: Vec3) -> Vec3:
    """Return a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def minus(a: Vec3, b: Vec3) -> Vec3:
    """Return a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def towards(a: Vec3, b: Vec3, share: float) -> Vec3:
    """Return a + share (b - a)."""
    return (
        a[0] + share * (b[0] - a[0]),
        a[1] + share * (b[1] - a[1]),
        a[2] + share * (b[2] - a[2]),
    )
