"""The robot's links, in frames of our choice that leave few constant rotations.

A constant rotation about the axis of its own joint, or of the joint before, becomes a constant
added to that joint's angle: on the G1 only the shoulders keep a constant matrix.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from downbeat.catalog.robot import FACTS_PATH, load_facts
from downbeat.control.errors import ControlError

Numbers = tuple[float, float, float]
Quat = tuple[float, float, float, float]

IDENTITY: Quat = (1.0, 0.0, 0.0, 0.0)
_ZERO = 1e-12
"""A component of a unit quaternion below this is zero."""


def unit(quat: Sequence[float]) -> Quat:
    """Return `quat` wxyz with unit length."""
    size = math.sqrt(sum(v * v for v in quat))
    w, x, y, z = (float(v) / size for v in quat)
    return w, x, y, z


def conjugate(quat: Quat) -> Quat:
    """Return the inverse of a unit quaternion."""
    return quat[0], -quat[1], -quat[2], -quat[3]


def times(a: Quat, b: Quat) -> Quat:
    """Return the product a b; what is zero but for rounding is zero."""
    w = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    x = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    y = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    z = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]
    w, x, y, z = (0.0 if abs(v) < _ZERO else v for v in (w, x, y, z))
    return unit((w, x, y, z))


def matrix(quat: Quat) -> tuple[Numbers, Numbers, Numbers]:
    """Return the rotation matrix of a unit quaternion."""
    w, x, y, z = quat
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


def rotated(quat: Quat, vector: Sequence[float]) -> Numbers:
    """Return `vector` turned by a unit quaternion."""
    x, y, z = (sum(a * float(b) for a, b in zip(row, vector)) for row in matrix(quat))
    return x, y, z


def angle_about(quat: Quat, axis: int) -> float | None:
    """Return the angle [rad] of a rotation about axis 0, 1 or 2; None if it turns otherwise."""
    others = [abs(v) for i, v in enumerate(quat[1:]) if i != axis]
    if max(others) > _ZERO:
        return None
    return 2.0 * math.atan2(quat[1 + axis], quat[0])


@dataclass(frozen=True, slots=True)
class Link:
    """A body and the joint that moves it; frames are chosen so that little is left constant.

    Attributes:
        parent: Index of the parent, -1 for the base itself.
        joint: Motor index, -1 for the base.
        axis: 0, 1, 2 for x, y, z.
        angle_offset: [rad] added to the joint's angle.
        quat: wxyz, what is left of the constant rotation before the joint.
        pos: (3,) [m] in the parent's frame.
        mass: [kg].
        com: (3,) [m] in the body's frame.
        own: Frame of this link seen from the body's frame in the facts, wxyz.
    """

    parent: int
    joint: int
    axis: int
    angle_offset: float
    quat: Quat
    pos: Numbers
    mass: float
    com: Numbers
    own: Quat

    @property
    def angle(self) -> str:
        """Expression of the angle to turn by."""
        name = f"q{self.joint}"
        if self.angle_offset == 0.0:
            return name
        return f"{name} {'-' if self.angle_offset < 0.0 else '+'} {abs(self.angle_offset)!r}"


def read_links() -> tuple[Link, ...]:
    """Return the bodies in the order of the facts, parents first.

    Raises:
        ControlError: A joint does not turn about one axis of its body.
    """
    bodies = load_facts()["bodies"]
    joints = {joint["body"]: joint for joint in load_facts()["joints"]}
    index = {body["name"]: i for i, body in enumerate(bodies)}
    axes = [_axis(joints[b["name"]]) if b["name"] in joints else -1 for b in bodies]
    quats = [unit(body["quat"]) for body in bodies]
    own = [_own_frame(name, bodies, axes, quats, index) for name in index]
    links: list[Link] = []
    for i, body in enumerate(bodies):
        parent = index.get(body["parent"], -1)
        before = IDENTITY if parent < 0 else conjugate(own[parent])
        quat = times(before, quats[i]) if i else IDENTITY
        offset = angle_about(own[i], axes[i]) or 0.0
        about = angle_about(quat, axes[i])
        if about is not None:
            quat, offset = IDENTITY, offset + about
        joint = joints.get(body["name"])
        links.append(
            Link(
                parent=parent,
                joint=-1 if joint is None else int(joint["motor_index"]),
                axis=axes[i],
                angle_offset=offset,
                quat=quat,
                pos=rotated(before, body["pos"]) if i else (0.0, 0.0, 0.0),
                mass=float(body["mass"]),
                com=rotated(conjugate(own[i]), body["ipos"]),
                own=own[i],
            )
        )
    return tuple(links)


def _own_frame(
    name: str, bodies: Any, axes: list[int], quats: list[Quat], index: dict[str, int]
) -> Quat:
    """Return the rotation to give a body's frame so that its child's constant one vanishes."""
    children = [index[b["name"]] for b in bodies if b["parent"] == name]
    if len(children) != 1 or axes[index[name]] < 0:
        return IDENTITY
    child = quats[children[0]]
    already_simple = angle_about(child, axes[children[0]]) is not None
    turns_with_body = angle_about(child, axes[index[name]]) is not None
    return child if turns_with_body and not already_simple else IDENTITY


def _axis(joint: Any) -> int:
    axis = [float(v) for v in joint["axis"]]
    if sorted(axis) != [0.0, 0.0, 1.0] or any(joint["pos"]):
        raise ControlError(
            f"Joint {joint['name']} turns about {axis} at {joint['pos']}; kinematics need x, y or"
            f" z through the body's origin ({FACTS_PATH.name}: joints)."
        )
    return axis.index(1.0)
