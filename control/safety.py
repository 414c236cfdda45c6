"""Watches the state and the actions against the fault table.

Everything here is a pure function of what the tick consumed and of the monitor's own counters.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from downbeat.catalog.robot import load_g1
from downbeat.control.faults import FAULTS, POLICY_FAULTS, STATE_FAULTS, Reaction
from downbeat.control.observation import RobotState
from downbeat.control.skill import F32, SkillOutput
from downbeat.lcm_types import g1_low_state_t
from downbeat.policies.manifest import SkillLimits
from downbeat.runtime.faults import Fault, FaultMonitor

STATE_LATE_US = 30_000
STATE_STALE_US = 70_000
"""Noticed at the next tick: damping goes out at most 90 ms after the last state."""
STATE_AHEAD_US = 50_000
CLOCK_STEP_US = 1_000_000
MOTOR_WARM_C, MOTOR_HOT_C = 85, 105
"""Of the winding. The vendor publishes no limit; motors of this kind are built for 120 to 130."""
CASE_HOT_C = 90
BATTERY_LOW, BATTERY_EMPTY = 0.20, 0.08
REMOTE_LOST_TICKS = 150
"""The vendor's wrapper calls 3 s of zeros lost."""
BODY_PERIOD_TICKS = 5
"""Temperatures, battery and remote are looked at ten times a second."""
MOTION_FAULTS = ("joint_range", "joint_speed", "torque_saturated", "motor_fault")
TARGET_REACH = 2.0
"""A target farther from the joint's range than this many times effort/kp saturates any motor."""
TARGET_SLACK_RAD = 0.5


@dataclass(frozen=True, slots=True)
class RaisedFault:
    """A row of the table with what was measured."""

    fault: Fault[Reaction]
    text: str


@dataclass(slots=True)
class SafetyCounters:
    """What the monitor remembers besides the hysteresis of the table.

    Attributes:
        saturated_ticks: (29,) for how many ticks each joint has been at its torque limit.
        last_utime: Of the previous tick [us]; 0 before the first.
        foreign_states: Messages of a second publisher at the previous tick.
        ticks: Judged so far.
        content: The measured numbers of the previous tick, as bytes.
        body: What was found at the last look at temperatures, battery and remote.
        remote_seen: The remote has been heard.
        remote_silent_ticks: Since it was last heard.
    """

    saturated_ticks: npt.NDArray[np.int32]
    last_utime: int = 0
    foreign_states: int = 0
    remote_seen: bool = False
    remote_silent_ticks: int = 0
    ticks: int = 0
    content: str = ""
    body: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Measured:
    """What one tick hands to the monitor.

    Attributes:
        utime: Of the tick [us].
        msg: The newest state message, None before the first.
        state: The same as arrays.
        tilt_rad: Of the pelvis from the vertical, NaN if unknown.
        state_age_us: Its age [us], negative if it is stamped in the future.
        foreign_states: Messages of a second publisher on G1_LOW_STATE so far.
        falling: What says that a fall is coming; empty: nothing does.
        estop: Who asked for an emergency stop, empty: nobody.
        is_active: A skill plays.
    """

    utime: int
    msg: g1_low_state_t | None
    state: RobotState | None
    tilt_rad: float
    state_age_us: int
    foreign_states: int = 0
    falling: str = ""
    estop: str = ""
    is_active: bool = False


class SafetyMonitor:
    """The fault table applied to what is measured."""

    def __init__(self) -> None:
        self._state = FaultMonitor(STATE_FAULTS)
        self._policy = FaultMonitor(POLICY_FAULTS)
        robot = load_g1()
        self._names = robot.joint_names
        low, high = np.asarray(robot.joint_range, np.float32).T
        self._middle = 0.5 * (low + high)  # (29,)
        self._half = 0.5 * (high - low)  # (29,)
        self._used = np.zeros((len(MOTION_FAULTS), len(self._names)), np.float32)
        self._reach: dict[str, F32] = {}
        self._speed = np.asarray(robot.velocity_limit, np.float32)  # (29,)
        self._effort = np.asarray(robot.effort_limit, np.float32)  # (29,)
        self.counters = SafetyCounters(np.zeros(len(self._names), np.int32))

    # ------------------------------------------------------------------ state

    def judge_state(self, measured: Measured, limits: SkillLimits) -> list[RaisedFault]:
        """Return the faults that are active now, hardest first.

        Args:
            measured: Of this tick.
            limits: Of the skill in play; during a blend the looser of the two.
        """
        found: dict[str, object] = {}
        if measured.estop:
            found["estop"] = measured.estop
        self._judge_time(measured, found)
        if measured.state is not None and measured.msg is not None:
            if not measured.tilt_rad <= limits.tilt_rad:  # also catches a NaN
                found["tilt"] = f"{measured.tilt_rad:.2f}"
            self._judge_motion(measured.state, measured.msg, limits, found)
            self._judge_content(measured, measured.state, found)
            if self.counters.ticks % BODY_PERIOD_TICKS == 0:
                self.counters.body = self._judge_body(measured.msg)
            found.update(self.counters.body)
            self.counters.ticks += 1
        if measured.falling:
            found["falling"] = measured.falling
        return self._raised(self._state, found)

    def _judge_time(self, measured: Measured, found: dict[str, object]) -> None:
        counters = self.counters
        age = measured.state_age_us
        if measured.state is None or age > STATE_STALE_US:
            found["state_stale"] = age // 1000
        elif age > STATE_LATE_US:
            found["state_late"] = age // 1000
        elif age < -STATE_AHEAD_US:
            found["state_ahead"] = -age // 1000
        step = measured.utime - counters.last_utime
        if counters.last_utime and not 0 < step <= CLOCK_STEP_US:
            found["clock_step"] = step // 1000
        counters.last_utime = measured.utime
        if measured.foreign_states > counters.foreign_states:
            found["second_publisher"] = measured.foreign_states
        counters.foreign_states = measured.foreign_states

    def _judge_motion(
        self,
        state: RobotState,
        msg: g1_low_state_t,
        limits: SkillLimits,
        found: dict[str, object],
    ) -> None:
        # One table, one pass: how much of what is allowed each joint uses.
        used = self._used  # (4, 29)
        np.subtract(state.joint_pos, self._middle, out=used[0])
        np.abs(used[0], out=used[0])
        np.subtract(used[0], self._half, out=used[0])
        np.divide(state.joint_vel, self._speed, out=used[1])
        np.divide(msg.joint_torque_est, self._effort, out=used[2])
        np.abs(used[1:3], out=used[1:3])
        held = self.counters.saturated_ticks
        held += 1
        held *= used[2] >= limits.torque_ratio
        used[2] = held
        used[3] = msg.motor_fault
        most = used.max(axis=1).tolist()
        allowed = (
            limits.joint_range_tolerance_rad,
            limits.joint_speed_ratio,
            limits.saturated_s * 50.0,
            0.0,
        )
        for row, (value, limit) in enumerate(zip(most, allowed, strict=True)):
            if not value <= limit:
                found[MOTION_FAULTS[row]] = self._names[int(used[row].argmax())]

    def _judge_content(
        self, measured: Measured, state: RobotState, found: dict[str, object]
    ) -> None:
        """A robot that stands still still trembles; numbers that do not move are not measured."""
        content = (state.joint_vel.tobytes() + state.base_ang_vel.tobytes()).hex()
        if measured.is_active and content == self.counters.content:
            found["state_frozen"] = ""
        self.counters.content = content

    def _judge_body(self, msg: g1_low_state_t) -> dict[str, str]:
        """Return the faults of what changes slowly: temperatures, battery, remote."""
        found: dict[str, str] = {}
        winding, case = np.asarray(msg.temperature_winding), np.asarray(msg.temperature_case)
        heat = np.maximum(winding, case + (MOTOR_HOT_C - CASE_HOT_C))
        for name, values, limit in (
            ("motor_warm", winding, MOTOR_WARM_C),
            ("motor_hot", heat, MOTOR_HOT_C),
        ):
            worst = int(values.argmax())
            if values[worst] > limit:
                found[name] = self._names[worst]
        charge = msg.battery_soc
        if charge < BATTERY_LOW:  # NaN, not known, compares false
            found["battery_low"] = f"{100.0 * charge:.0f}"
        if charge < BATTERY_EMPTY:
            found["battery_empty"] = f"{100.0 * charge:.0f}"
        if msg.source == g1_low_state_t.SOURCE_HARDWARE:
            self._judge_remote(msg, found)
        return found

    def _judge_remote(self, msg: g1_low_state_t, found: dict[str, str]) -> None:
        counters = self.counters
        if any(msg.wireless_remote):
            counters.remote_seen = True
            counters.remote_silent_ticks = 0
        elif counters.remote_seen:
            counters.remote_silent_ticks += BODY_PERIOD_TICKS
            if counters.remote_silent_ticks > REMOTE_LOST_TICKS:
                found["remote_lost"] = f"{counters.remote_silent_ticks / 50.0:.1f}"

    # ------------------------------------------------------------------ policy

    def judge_policy(self, parts: tuple[tuple[str, SkillOutput], ...]) -> list[RaisedFault]:
        """Return the faults of what the skills in play computed, hardest first."""
        found: dict[str, object] = {}
        for name, part in parts:
            if not _is_finite(part.obs):
                found["non_finite_observation"] = name
            targets = part.targets
            reach = self._reach.get(name)
            if reach is None:
                reach = self._reach[name] = self._reach_of(targets.joint_stiffness)
            # `not <=` is also true for a NaN.
            if not bool((np.abs(targets.joint_pos - self._middle) <= reach).all()):
                finite = _is_finite(targets.joint_pos) and _is_finite(part.action)
                found["action_range" if finite else "non_finite_action"] = name
        return self._raised(self._policy, found)

    def _reach_of(self, stiffness: F32) -> F32:
        """Return how far from the middle of its range a target of each joint may lie, (29,)."""
        return np.asarray(
            self._half + TARGET_REACH * self._effort / np.maximum(stiffness, 1.0) + TARGET_SLACK_RAD
        )

    def refuse_fallback(self, reason: str) -> list[RaisedFault]:
        """Return the fault of a balance policy that cannot take over."""
        return self._raised(self._policy, {"fallback_failed": reason})

    # ------------------------------------------------------------------ hysteresis

    @staticmethod
    def _raised(monitor: FaultMonitor[Reaction], found: Mapping[str, object]) -> list[RaisedFault]:
        return [
            RaisedFault(row, row.message.format(found.get(row.name, "")))
            for row in monitor.update(found)
        ]

    def to_state(self) -> dict[str, Any]:
        """Return what is remembered."""
        return {
            "state": self._state.to_state(),
            "policy": self._policy.to_state(),
            "counters": self.counters,
        }

    def from_state(self, values: Mapping[str, Any]) -> None:
        """Restore what `to_state` returned."""
        self._state.from_state(values["state"])
        self._policy.from_state(values["policy"])
        self.counters = values["counters"]


def _is_finite(values: F32) -> bool:
    # A sum is finite only if every term is, unless it overflows, which is no better.
    return math.isfinite(float(values.sum()))


def fault_to_state(raised: RaisedFault | None) -> list[Any] | None:
    """Return a raised fault as plain values."""
    return None if raised is None else [raised.fault.id, raised.text]


def fault_from_state(state: list[Any] | None) -> RaisedFault | None:
    """Return the fault that `fault_to_state` described."""
    if state is None:
        return None
    rows = {row.id: row for row in FAULTS}
    return RaisedFault(rows[state[0]], state[1])
