"""Tell that a fall is coming while there is still time to do something about it.

A robot whose capture point leaves both its soles cannot stop by pushing against the floor: it has
to step, and no skill of ours improvises a step. `python -m downbeat.sim.fall_prediction` measures
what the limits below rest on.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

from downbeat.control.errors import ControlError
from downbeat.control.estimate import Estimate
from downbeat.control.vectors import rotation_of

Cause = Literal["", "capture_point", "tilt", "height"]

LOOK_AHEAD_S = 0.2
"""Tilt is looked at this far ahead, at its present rate."""
UPRIGHT_RAD = 0.05
"""Below this the direction of a tilt is noise, and so is its rate."""


@dataclass(frozen=True, slots=True)
class FallLimits:
    """What counts as falling.

    Attributes:
        step_margin_m: Of the capture point inside both soles; negative: outside; -inf: not watched.
        tilt_ahead_rad: Of the pelvis, 0.2 s ahead.
        base_height_m: Of the pelvis above the soles; 0: not watched.
    """

    step_margin_m: float
    tilt_ahead_rad: float = 0.6
    base_height_m: float = 0.5


LIMITS: Mapping[str, FallLimits] = {
    "planted": FallLimits(step_margin_m=-0.02),
    "stepping": FallLimits(step_margin_m=-0.10),
    "locomotion": FallLimits(step_margin_m=-0.12),
}
"""Kind of skill -> limits.

Undisturbed, the worst margin of a tick is 0.036 m for planted skills, 0.006 m for stepping ones,
-0.040 m for walking; pushed, a planted skill never came back from -0.04 m, but one in six of the
stepping robots that stayed up had been at -0.10 m.
"""


@dataclass(frozen=True, slots=True)
class PredictorConfig:
    """Hysteresis.

    Attributes:
        raise_after_ticks: A limit must be passed for this many ticks in a row.
        clear_after_ticks: All limits must be kept for this many ticks in a row.
    """

    raise_after_ticks: int = 2
    clear_after_ticks: int = 25


@dataclass(frozen=True, slots=True)
class FallPrediction:
    """The answer of one tick.

    Attributes:
        is_falling: A fall is coming.
        cause: Which limit was passed; empty if none.
        value: What was measured when the fall was called [m] or [rad]; NaN if none.
    """

    is_falling: bool
    cause: Cause
    value: float


@dataclass(slots=True)
class PredictorState:
    """Everything a predictor remembers.

    Attributes:
        is_falling: The answer.
        beyond_ticks: For so many ticks in a row a limit has been passed.
        within_ticks: For so many ticks in a row all limits have been kept.
        cause: The limit that made the answer yes.
        value: What was measured then [m] or [rad].
    """

    is_falling: bool = False
    beyond_ticks: int = 0
    within_ticks: int = 0
    cause: Cause = ""
    value: float = math.nan


class FallPredictor:
    """Limits and hysteresis, one `update` per tick."""

    def __init__(self, config: PredictorConfig | None = None) -> None:
        self.config = config or PredictorConfig()
        self.state = PredictorState()

    def reset(self) -> None:
        """Forget everything: nobody falls."""
        self.state = PredictorState()

    def update(
        self, estimate: Estimate, tilt: float, tilt_rate: float, limits: FallLimits
    ) -> FallPrediction:
        """Look at one tick. What is NaN neither raises nor clears.

        Args:
            estimate: Of this tick.
            tilt: [rad] of the pelvis from the vertical.
            tilt_rate: [rad/s] its growth.
            limits: Of what is played.
        """
        config, state = self.config, self.state
        cause, value = _passed(estimate, tilt + LOOK_AHEAD_S * max(0.0, tilt_rate), limits)
        if cause:
            state.within_ticks = 0
            state.beyond_ticks += 1
            if not state.is_falling and state.beyond_ticks >= config.raise_after_ticks:
                state.is_falling, state.cause, state.value = True, cause, value
        elif math.isfinite(estimate.step_margin):
            state.beyond_ticks = 0
            state.within_ticks += 1
            if state.is_falling and state.within_ticks >= config.clear_after_ticks:
                state.is_falling, state.cause, state.value = False, "", math.nan
        return FallPrediction(state.is_falling, state.cause, state.value)

    def to_state(self) -> dict[str, Any]:
        """Return what is remembered, field by field."""
        return asdict(self.state)

    def from_state(self, values: dict[str, Any]) -> None:
        """Restore what `to_state` returned.

        Raises:
            ControlError: A field is missing or unknown.
        """
        if set(values) != set(asdict(self.state)):
            raise ControlError(
                f"The fall predictor's state cannot be restored from {', '.join(values)}; it has"
                f" {', '.join(asdict(self.state))}."
            )
        self.state = PredictorState(**values)


def tilt_and_rate(base_quat_wxyz: Sequence[float], gyro: Sequence[float]) -> tuple[float, float]:
    """Return the pelvis' angle from the vertical [rad] and its rate [rad/s].

    Args:
        base_quat_wxyz: (4,) world <- base.
        gyro: (3,) [rad/s] base frame.
    """
    up_x, up_y, up_z = rotation_of(base_quat_wxyz)[2]
    angle = math.acos(min(1.0, max(-1.0, up_z)))
    # cos(tilt) = up_z, and d(up)/dt = up x gyro in the base frame.
    falling = float(gyro[0]) * up_y - float(gyro[1]) * up_x
    return angle, falling / max(math.sin(angle), math.sin(UPRIGHT_RAD))


def _passed(estimate: Estimate, tilt_ahead: float, limits: FallLimits) -> tuple[Cause, float]:
    """Return the first limit that is passed, and what was measured."""
    if estimate.step_margin < limits.step_margin_m:
        return "capture_point", estimate.step_margin
    if tilt_ahead > limits.tilt_ahead_rad:
        return "tilt", tilt_ahead
    if estimate.base_height < limits.base_height_m:
        return "height", estimate.base_height
    return "", math.nan
