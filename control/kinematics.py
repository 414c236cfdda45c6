"""Forward kinematics of the G1: feet, torso and centre of mass, seen from the base (the pelvis).

The functions that do the work are written at import (kinematics_code.py) as straight lines of sums
and products: no matrix product, the same bits in every process. With floats they are fast enough
for the control tick; the `*_batch` functions run the same lines on arrays with leading batch
dimensions, numpy or jax.numpy.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from downbeat.catalog.robot import FACTS_PATH, NUM_JOINTS, load_g1
from downbeat.control.errors import ControlError
from downbeat.control.kinematics_code import (
    Vector,
    Writer,
    com_code,
    foot_code,
    pose_code,
    sole_centre,
    tuple_of,
)
from downbeat.control.kinematics_links import read_links

Array = Any
Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]

TORSO = "torso_link"
SOLE_CENTRE: Vec3 = sole_centre()
"""The middle of the sole's contact points, (3,) [m] in the ankle-roll body's frame."""
SOLE_CORNERS: tuple[Vec3, ...] = tuple(
    (p[0] - SOLE_CENTRE[0], p[1] - SOLE_CENTRE[1], 0.0) for p in load_g1().feet.pos
)
"""Contact points of either sole from its centre, four times (3,) [m] in the foot's frame."""


class FootMotion(NamedTuple):
    """A sole seen from the base. Each field three floats, or an array (..., 3).

    Attributes:
        pos: Of the sole's centre [m].
        lin_vel: Of the sole's centre against the base [m/s].
        ang_vel: Of the foot against the base [rad/s].
        x_axis: Of the foot, unit, towards the toes.
        z_axis: Of the foot, unit, upwards when flat.
    """

    pos: Any
    lin_vel: Any
    ang_vel: Any
    x_axis: Any
    z_axis: Any


def write_source() -> str:
    """Return the source of the generated functions; their arguments are scalars or arrays.

    Raises:
        ControlError: The facts lack a foot or the torso.
    """
    links = read_links()
    names = load_g1().body_names
    missing = [n for n in (*load_g1().feet.body_names, TORSO) if n not in names]
    if missing:
        raise ControlError(
            f"Kinematics lack the bodies {', '.join(missing)}; the robot has"
            f" {', '.join(names)} ({FACTS_PATH.name}: bodies)."
        )
    legs = [names.index(n) for n in load_g1().feet.body_names]
    functions: list[str] = []
    w = Writer()
    feet_vectors = [foot_code(w, links, leg, SOLE_CENTRE) for leg in legs]
    functions.append(_function(w, "feet", True, _nested(feet_vectors)))
    w = Writer()
    pos, quat = pose_code(w, links, names.index(TORSO))
    functions.append(_function(w, "torso", False, f"{tuple_of(pos)}, {tuple_of(quat)}"))
    for name, with_velocity in (("com", False), ("com_motion", True)):
        w = Writer()
        vectors = com_code(w, links, with_velocity)
        result = ", ".join(map(tuple_of, vectors))
        functions.append(_function(w, name, with_velocity, result))
    return "\n\n".join(functions)


def _nested(feet_vectors: Sequence[Sequence[Vector]]) -> str:
    return ", ".join(f"({', '.join(map(tuple_of, vectors))})" for vectors in feet_vectors)


def _function(w: Writer, name: str, with_velocity: bool, result: str) -> str:
    """Return a function that begins by taking the joints its lines use."""
    sources = {"q": "joint_pos", "v": "joint_vel"} if with_velocity else {"q": "joint_pos"}
    used = " ".join(w.lines)
    for letter, source in sources.items():
        count = 1 + max(int(index) for index in re.findall(rf"\b{letter}(\d+)\b", used))
        w.lines.insert(0, f"{', '.join(f'{letter}{i}' for i in range(count))}, *_ = {source}")
    return w.function(name, f"{', '.join(sources.values())}, sin, cos", result)


def _compile(source: str) -> dict[str, Callable[..., Any]]:
    namespace: dict[str, Any] = {}
    exec(compile(source, "<kinematics of the G1>", "exec"), namespace)
    return namespace


_WRITTEN = _compile(write_source())
_FEET, _TORSO = _WRITTEN["feet"], _WRITTEN["torso"]
_COM, _COM_MOTION = _WRITTEN["com"], _WRITTEN["com_motion"]


# ---------------------------------------------------------------------- one robot, floats


def feet(joint_pos: Sequence[float], joint_vel: Sequence[float]) -> tuple[FootMotion, FootMotion]:
    """Return the left and the right sole; 29 floats [rad] and [rad/s], motor order."""
    left, right = _FEET(joint_pos, joint_vel, math.sin, math.cos)
    return FootMotion._make(left), FootMotion._make(right)


def torso_pose(joint_pos: Sequence[float]) -> tuple[Vec3, Quat]:
    """Return the torso link in the base frame: position [m], quaternion wxyz (base <- torso)."""
    pose: tuple[Vec3, Quat] = _TORSO(joint_pos, math.sin, math.cos)
    return pose


def centre_of_mass(joint_pos: Sequence[float]) -> Vec3:
    """Return the whole body's centre of mass in the base frame [m]."""
    com: Vec3 = _COM(joint_pos, math.sin, math.cos)
    return com


def centre_of_mass_motion(
    joint_pos: Sequence[float], joint_vel: Sequence[float]
) -> tuple[Vec3, Vec3]:
    """Return the centre of mass [m] and its velocity against the base [m/s], base frame."""
    motion: tuple[Vec3, Vec3] = _COM_MOTION(joint_pos, joint_vel, math.sin, math.cos)
    return motion


# ---------------------------------------------------------------------- many robots, arrays


def feet_batch(
    joint_pos: Array, joint_vel: Array, xp: ModuleType = np
) -> tuple[FootMotion, FootMotion]:
    """Return the left and the right sole of many robots.

    Args:
        joint_pos: (..., 29) [rad].
        joint_vel: (..., 29) [rad/s].
        xp: `numpy` or `jax.numpy`.
    """
    left, right = _FEET(_columns(joint_pos), _columns(joint_vel), xp.sin, xp.cos)
    return _stack_foot(left, xp), _stack_foot(right, xp)


def torso_pose_batch(joint_pos: Array, xp: ModuleType = np) -> tuple[Array, Array]:
    """Return torso positions (..., 3) [m] and quaternions (..., 4) wxyz of joints (..., 29)."""
    pos, quat = _TORSO(_columns(joint_pos), xp.sin, xp.cos)
    return _stack(pos, xp), _stack(quat, xp)


def centre_of_mass_batch(joint_pos: Array, xp: ModuleType = np) -> Array:
    """Return centres of mass (..., 3) [m] of joints (..., 29)."""
    return _stack(_COM(_columns(joint_pos), xp.sin, xp.cos), xp)


def centre_of_mass_motion_batch(
    joint_pos: Array, joint_vel: Array, xp: ModuleType = np
) -> tuple[Array, Array]:
    """Return centres of mass (..., 3) [m] and their velocities (..., 3) [m/s]."""
    com, vel = _COM_MOTION(_columns(joint_pos), _columns(joint_vel), xp.sin, xp.cos)
    return _stack(com, xp), _stack(vel, xp)


def _columns(joints: Array) -> tuple[Array, ...]:
    return tuple(joints[..., i] for i in range(NUM_JOINTS))


def _stack(components: Sequence[Any], xp: ModuleType) -> Array:
    """Return components as the last axis; one that no joint changes is a plain number."""
    return xp.stack(xp.broadcast_arrays(*components), axis=-1)


def _stack_foot(vectors: Sequence[Any], xp: ModuleType) -> FootMotion:
    return FootMotion._make(_stack(vector, xp) for vector in vectors)
