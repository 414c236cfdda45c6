"""Watch the state and the action against the fault table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from downbeat.catalog.robot import load_g1
from downbeat.control import faults as f
from downbeat.control.observation import RobotState, tilt
from downbeat.control.policy import F32

STATE_LATE_US = 30_000
STATE_STALE_US = 100_000
TILT_LIMIT_RAD = 0.8
"""Skills bow by at most 0.3 rad; beyond 0.8 no policy of ours has come back."""
RANGE_TOLERANCE_RAD = 0.15
SPEED_TOLERANCE = 1.2


@dataclass(frozen=True, slots=True)
class RaisedFault:
    """A row of the table with what was measured."""

    fault: f.Fault
    text: str


class SafetyMonitor:
    """Counts, per fault, for how many ticks its condition has held.

    Conditions are evaluated in a fixed order; `check_*` return the raised faults of this tick.
    """

    def __init__(self) -> None:
        self._held: dict[int, int] = {}
        robot = load_g1()
        self._names = robot.joint_names
        self._low = np.asarray(robot.joint_range[:, 0], np.float32)  # (29,)
        self._high = np.asarray(robot.joint_range[:, 1], np.float32)  # (29,)
        self._speed = np.asarray(robot.velocity_limit, np.float32) * SPEED_TOLERANCE  # (29,)

    def _hold(self, fault: f.Fault, condition: bool, value: object, out: list[RaisedFault]) -> None:
        held = self._held.get(fault.id, 0) + 1 if condition else 0
        self._held[fault.id] = held
        if condition and held >= fault.raise_after_ticks:
            out.append(RaisedFault(fault, fault.message.format(value)))

    def check_state(
        self, state: RobotState | None, state_age_us: int, motor_fault: npt.NDArray[Any] | None
    ) -> list[RaisedFault]:
        """Return the faults that the measured state raises this tick."""
        out: list[RaisedFault] = []
        age_ms = state_age_us // 1000
        stale = state is None or state_age_us > STATE_STALE_US
        self._hold(f.STATE_STALE, stale, age_ms, out)
        self._hold(f.STATE_LATE, not stale and state_age_us > STATE_LATE_US, age_ms, out)
        if state is None:
            return out
        lean = float(tilt(state.base_quat_wxyz))
        self._hold(f.TILT, lean > TILT_LIMIT_RAD, f"{lean:.2f}", out)
        beyond = np.maximum(self._low - state.joint_pos, state.joint_pos - self._high)  # (29,)
        self._hold_joint(f.JOINT_RANGE, beyond - RANGE_TOLERANCE_RAD, out)
        self._hold_joint(f.JOINT_SPEED, np.abs(state.joint_vel) - self._speed, out)
        flags = np.zeros(len(self._names)) if motor_fault is None else motor_fault
        self._hold_joint(f.MOTOR_FAULT, np.asarray(flags, np.float32), out)
        return out

    def _hold_joint(self, fault: f.Fault, excess: F32, out: list[RaisedFault]) -> None:
        worst = int(np.argmax(excess))
        self._hold(fault, bool(excess[worst] > 0.0), self._names[worst], out)

    def check_policy(self, obs: F32, target: F32, skill: str) -> list[RaisedFault]:
        """Return the faults of a policy's observation and of its joint position targets."""
        out: list[RaisedFault] = []
        self._hold(f.NON_FINITE_OBSERVATION, not bool(np.isfinite(obs).all()), skill, out)
        self._hold(f.NON_FINITE_ACTION, not bool(np.isfinite(target).all()), skill, out)
        return out

    def reset(self) -> None:
        """Forget all counts (after CLEAR_TRIP)."""
        self._held.clear()
