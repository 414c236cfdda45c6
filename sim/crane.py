"""A crane over the robot: it hangs clear of the floor, is lowered, and is let go by hand."""

from __future__ import annotations

from typing import Any

from downbeat.sim.gantry import support

HOIST_M = 0.08
"""Feet are off the floor, also when the knees hang straight."""
SLACK_M = 0.02
"""Lowered, the rope begins to pull this far below the standing height."""
LOWER_M_S = 0.08
ROPE_STIFFNESS, ROPE_DAMPING = 50_000.0, 1_500.0
"""[N/m], [N s/m]: the whole robot stretches it by 7 mm."""


class Crane:
    """Holds the pelvis as a rope and two hands do; physics goes on all the while."""

    def __init__(self, data: Any, release_s: float = 1.0) -> None:
        """Hoist the robot from where it stands.

        Args:
            data: MuJoCo state.
            release_s: From the full hold to none.
        """
        self._pos = data.qpos[:2].copy()  # (2,)
        self._quat = data.qpos[3:7].copy()  # (4,)
        self._standing = float(data.qpos[2])
        self._height = self._standing + HOIST_M
        data.qpos[2] = self._height
        self._release_s = release_s
        self._share = 1.0
        self._is_lowering = self._is_released = False

    def lower(self) -> None:
        """Begin to lower it; the hands stay."""
        self._is_lowering = True

    def release(self) -> None:
        """Begin to let go."""
        self._is_released = True

    @property
    def share(self) -> float:
        """How much of the hold is left, 0..1."""
        return self._share

    @property
    def is_down(self) -> bool:
        """Whether the rope is slack under a robot that stands."""
        return self._height <= self._standing - SLACK_M

    def apply(self, model: Any, data: Any, dt_s: float) -> None:
        """Write the hold into `qfrc_applied` and move the crane by one step."""
        if self._is_lowering:
            self._height = max(self._standing - SLACK_M, self._height - LOWER_M_S * dt_s)
        if self._is_released and self._share > 0.0:
            self._share = max(0.0, self._share - dt_s / self._release_s)
        data.qfrc_applied[:] = 0.0
        if self._share == 0.0:
            return
        support(model, data, self._pos, self._quat, self._share)
        sag = self._height - float(data.qpos[2])
        if sag > 0.0:  # a rope pulls, it does not push
            pull = ROPE_STIFFNESS * sag - ROPE_DAMPING * float(data.qvel[2])
            data.qfrc_applied[2] += self._share * max(0.0, pull)
