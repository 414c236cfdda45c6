"""Observation terms, written once over the array namespace with leading batch dimensions.

The robot, the simulator and the batch check run these lines. `xp` is `numpy` or `jax.numpy`;
arrays are `(..., n)`. No matrix product and no BLAS: the same bits everywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from downbeat.control.errors import ControlError
from downbeat.runtime.errors import one_of

Array = Any


@dataclass(frozen=True, slots=True)
class RobotState:
    """What the terms read.

    Attributes:
        base_quat_wxyz: (..., 4) unit, world <- base.
        base_ang_vel: (..., 3) [rad/s] base frame.
        joint_pos: (..., 29) [rad] Unitree motor order.
        joint_vel: (..., 29) [rad/s].
    """

    base_quat_wxyz: Array
    base_ang_vel: Array
    joint_pos: Array
    joint_vel: Array


def projected_gravity(quat_wxyz: Array, xp: ModuleType = np) -> Array:
    """Return the unit gravity direction in the base frame, (..., 3); (0, 0, -1) upright.

    Symbols: the last row of the rotation matrix of `quat_wxyz`, negated.
    """
    w, x, y, z = (quat_wxyz[..., i] for i in range(4))
    return xp.stack(
        [
            -2.0 * (x * z - w * y),
            -2.0 * (y * z + w * x),
            -(1.0 - 2.0 * (x * x + y * y)),
        ],
        axis=-1,
    )  # (..., 3)


def tilt(quat_wxyz: Array, xp: ModuleType = np) -> Array:
    """Return the angle between the base's z axis and the vertical, (...) [rad]."""
    return xp.arccos(xp.clip(-projected_gravity(quat_wxyz, xp)[..., 2], -1.0, 1.0))


def yaw(quat_wxyz: Array, xp: ModuleType = np) -> Array:
    """Return the heading, (...) [rad], world frame."""
    w, x, y, z = (quat_wxyz[..., i] for i in range(4))
    return xp.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


TERMS: Mapping[str, Callable[[RobotState, ModuleType], Array]] = {
    "projected_gravity": lambda s, xp: projected_gravity(s.base_quat_wxyz, xp),
    "base_ang_vel": lambda s, xp: s.base_ang_vel,
    "joint_pos": lambda s, xp: s.joint_pos,
    "joint_vel": lambda s, xp: s.joint_vel,
}
"""Term name -> function of the state; importers of other formats add theirs."""


def check_terms(names: tuple[str, ...], where: str) -> None:
    """Raise ControlError when a policy asks for a term that does not exist."""
    for name in names:
        if name not in TERMS:
            raise ControlError(
                f"Observation term '{name}' is unknown; terms are {one_of(TERMS)} ({where})."
            )


def observe(state: RobotState, names: tuple[str, ...], xp: ModuleType = np) -> Array:
    """Concatenate the named terms, (..., sum of term widths)."""
    return xp.concatenate([TERMS[name](state, xp) for name in names], axis=-1)
