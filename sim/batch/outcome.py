"""What became of the rollouts of a batch, and the measures it is judged by."""

from __future__ import annotations

from dataclasses import dataclass, fields
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from downbeat.catalog.robot import load_g1

Array = Any
F32 = NDArray[np.float32]

GRAVITY_M_S2 = 9.81
DIRECTIONS = 16
NEVER = -1


@dataclass(frozen=True)
class Outcome:
    """One entry per rollout, (N,).

    Attributes:
        fell: It went down, or leaned more than safety allows.
        fell_tick: When; -1: never.
        max_tilt: Of the pelvis [rad], while it stood.
        max_torque_ratio: Largest motor torque against its limit.
        min_margin: Smallest distance of the capture point inside the hull of both soles [m];
            negative: outside.
        end_error: RMS of the joints against the skill's reference in the last tick [rad].
    """

    fell: NDArray[np.bool_]
    fell_tick: NDArray[np.int32]
    max_tilt: F32
    max_torque_ratio: F32
    min_margin: F32
    end_error: F32

    @property
    def count(self) -> int:
        """N."""
        return len(self.fell)

    @property
    def num_fallen(self) -> int:
        """How many fell."""
        return int(self.fell.sum())


def join_outcomes(parts: list[Outcome]) -> Outcome:
    """Return several outcomes as one."""
    names = [field.name for field in fields(Outcome)]
    return Outcome(*(np.concatenate([getattr(p, name) for p in parts]) for name in names))


def sole_corners() -> NDArray[np.float64]:
    """Return the corners of a sole in its foot's frame, (4, 3) [m]."""
    feet = load_g1().feet
    return np.array([[x, y, feet.sole_z] for x, y, _ in feet.pos])


def capture_margin(
    com: Array, com_vel: Array, feet_pos: Array, feet_mat: Array, xp: ModuleType = np
) -> Array:
    """Return how far the capture point lies inside the hull of both soles [m]; negative: outside.

    The hull's support function in 16 directions: exact inside up to 2 %, and without branches.

    Args:
        com: (N, 3) [m] centre of mass, world.
        com_vel: (N, 3) [m/s].
        feet_pos: (N, 2, 3) [m].
        feet_mat: (N, 2, 3, 3) world <- foot.
        xp: `numpy` or `jax.numpy`.
    """
    corners = xp.asarray(sole_corners(), com.dtype)
    soles = feet_pos[:, :, None, :] + xp.einsum("nfij,cj->nfci", feet_mat, corners)
    points = soles[..., :2].reshape((len(com), 8, 2))
    floor = xp.min(soles[..., 2].reshape((len(com), 8)), axis=-1)
    height = xp.clip(com[:, 2] - floor, 0.1, 1.5)
    capture = com[:, :2] + xp.sqrt(height / GRAVITY_M_S2)[:, None] * com_vel[:, :2]
    angles = np.arange(DIRECTIONS) * (2.0 * np.pi / DIRECTIONS)
    unit = xp.asarray(np.stack([np.cos(angles), np.sin(angles)]), com.dtype)  # (2, D)
    reach = xp.max(points @ unit, axis=1)  # (N, D)
    return xp.min(reach - capture @ unit, axis=-1)
