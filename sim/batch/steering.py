"""Control's velocity command (`control/player.Velocity`) for many robots at once."""

from __future__ import annotations

from collections.abc import Mapping
from types import ModuleType
from typing import Any

import numpy as np

from downbeat.control.phase import TICK_S
from downbeat.policies.manifest import SkillManifest

Array = Any
TURN = 2.0 * np.pi


def begin_steering(heading: Array, xp: ModuleType = np) -> dict[str, Array]:
    """Return the memory of a command that begins at rest; heading (N,) [rad]."""
    rows = heading.shape[0]
    return {
        "heading": heading,
        "target": heading,
        "holds": xp.zeros((rows,), bool),
        "current": xp.zeros((rows, 3), np.float32),
    }


def steer(
    manifest: SkillManifest,
    memory: Mapping[str, Array],
    heading: Array,
    wanted: Array,
    xp: ModuleType = np,
) -> tuple[dict[str, Array], Array]:
    """Move the commands one tick towards what is wanted.

    Args:
        manifest: Of a locomotion skill.
        memory: As `begin_steering` returns it.
        heading: (N,) measured [rad].
        wanted: (3,) vx, vy [m/s], yaw rate [rad/s].
        xp: `numpy` or `jax.numpy`.

    Returns:
        The new memory, and the commands (N, 3).
    """
    limits = manifest.command
    assert limits is not None
    share = TICK_S / limits.heading_filter_s
    low_passed = memory["heading"] + share * _wrap(heading - memory["heading"], xp)
    is_turning = xp.abs(wanted[2]) > 1e-6
    is_moving = xp.max(xp.abs(wanted)) > 1e-6
    holds = memory["holds"] & ~is_turning
    target = xp.where(is_moving & ~holds, low_passed, memory["target"])
    holds = (holds | is_moving) & ~is_turning
    correction = limits.heading_gain * _wrap(target - low_passed, xp)
    yaw_rate = xp.where(is_moving & ~is_turning, correction, wanted[2])
    ones = xp.ones_like(yaw_rate)
    goal = xp.stack([wanted[0] * ones, wanted[1] * ones, yaw_rate], axis=-1)  # (N, 3)
    low = np.array([limits.vx[0], limits.vy[0], limits.yaw_rate[0]], np.float32)
    high = np.array([limits.vx[1], limits.vy[1], limits.yaw_rate[1]], np.float32)
    slew = np.array([limits.slew_linear, limits.slew_linear, limits.slew_yaw], np.float32)
    step = slew * np.float32(TICK_S)
    goal = xp.clip(goal, low, high)
    current = memory["current"] + xp.clip(goal - memory["current"], -step, step)
    current = xp.asarray(current, np.float32)
    kept = {"heading": low_passed, "target": target, "holds": holds, "current": current}
    return kept, current


def _wrap(angle: Array, xp: ModuleType) -> Array:
    return xp.mod(angle + 0.5 * TURN, TURN) - 0.5 * TURN
