"""Judge a scenario: what was seen against what was expected, in sentences."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from downbeat.control.faults import FAULTS
from downbeat.lcm_types import control_status_t, g1_low_cmd_t
from downbeat.tools.scenario import STATES, Expectation

MODES = {v: k for k, v in vars(control_status_t).items() if k.isupper() and isinstance(v, int)}
COMMANDS = {
    g1_low_cmd_t.MODE_POSITION: "position",
    g1_low_cmd_t.MODE_DAMPING: "damping",
    g1_low_cmd_t.MODE_ZERO_TORQUE: "zero_torque",
}
FAULT_NAMES = {row.id: row.name for row in FAULTS}
MAX_BLIND_US = 100_000
"""Without a state for longer than this, no position is commanded, whatever else happens."""
TOLERANCE_S = 1e-6


@dataclass(frozen=True, slots=True)
class Seen:
    """One tick, as an observer has it.

    Attributes:
        time_s: Scenario time [s].
        status: CONTROL_STATUS.
        command: G1_LOW_CMD.
        height_m: True height of the pelvis.
    """

    time_s: float
    status: Any
    command: Any
    height_m: float


@dataclass
class Outcome:
    """What happened in a scenario.

    Attributes:
        ticks: Every tick.
        requests: Id -> states that it went through.
        reasons: Id -> last reason.
        refused: Messages that the robot's side (the plant) did not take; None: not known.
        problems: What was expected and did not happen; empty: all is well.
        records: Journal records of the run; none from a running bus.
    """

    ticks: list[Seen] = field(default_factory=list)
    requests: dict[int, list[str]] = field(default_factory=dict)
    reasons: dict[int, str] = field(default_factory=dict)
    refused: int | None = None
    problems: list[str] = field(default_factory=list)
    records: list[dict[str, Any]] = field(default_factory=list)

    def add_change(self, request_id: int, state: int, reason: str) -> None:
        """Note a line of SKILL_STATUS."""
        self.requests.setdefault(request_id, []).append(STATES[state])
        if reason:
            self.reasons[request_id] = reason


def judge(one: Expectation, outcome: Outcome) -> list[str]:
    """Return what is wrong, in sentences; empty if the expectation holds."""
    problems = _judge_requests(one, outcome) + _judge_counters(one, outcome)
    wanted = _wanted(one)
    if not wanted:
        return problems
    last_s = max(one.until_s, one.after_s + one.within_ms * 1e-3)
    window = [
        tick
        for tick in outcome.ticks
        if one.after_s - TOLERANCE_S <= tick.time_s <= last_s + TOLERANCE_S
    ]
    if not window:
        return [*problems, f"There is no tick between {one.after_s:g} s and {last_s:g} s."]
    if one.until_s:
        first_s = one.after_s + one.within_ms * 1e-3 - TOLERANCE_S
        must = [tick for tick in window if tick.time_s >= first_s]
        bad = next((tick for tick in must if not _holds(one, tick)), None)
        if bad is not None:
            problems.append(f"{wanted} does not hold at {bad.time_s:.2f} s: {_what(bad)}.")
    elif not any(_holds(one, tick) for tick in window):
        problems.append(
            f"{wanted} is not reached between {one.after_s:g} s and {last_s:g} s: "
            f"{_what(window[-1])} at the end."
        )
    return problems


def _wanted(one: Expectation) -> str:
    parts = [
        f"{name} {value}"
        for name in ("mode", "command", "skill", "fault")
        if (value := getattr(one, name))
    ]
    parts += ["no fault"] if one.no_fault else []
    parts += [f"height above {one.height_min_m:g} m"] if one.height_min_m else []
    return ", ".join(parts)


def _holds(one: Expectation, tick: Seen) -> bool:
    status = tick.status
    return (
        (not one.mode or MODES[status.mode] == one.mode)
        and (not one.command or COMMANDS[tick.command.mode] == one.command)
        and (not one.skill or status.skill == one.skill)
        and (not one.fault or FAULT_NAMES.get(status.fault) == one.fault)
        and (not one.no_fault or status.fault == 0)
        and (not one.height_min_m or tick.height_m > one.height_min_m)
    )


def _what(tick: Seen) -> str:
    status = tick.status
    fault = FAULT_NAMES.get(status.fault, "no fault")
    return (
        f"mode {MODES[status.mode]}, command {COMMANDS[tick.command.mode]}, skill "
        f"'{status.skill}', {fault}, height {tick.height_m:.2f} m"
    )


def _judge_requests(one: Expectation, outcome: Outcome) -> list[str]:
    if not one.request:
        return []
    states = outcome.requests.get(one.request, [])
    if one.state in states:
        return []
    return [f"Request {one.request} never was {one.state}; it was {', '.join(states) or 'unseen'}."]


def _judge_counters(one: Expectation, outcome: Outcome) -> list[str]:
    last = outcome.ticks[-1].status
    problems = []
    for name, least, found in (
        ("rejected", one.rejected_min, last.rejected),
        ("lost", one.lost_min, last.states_lost),
        ("refused by the robot", one.refused_min, outcome.refused),
    ):
        if found is not None and found < least:
            problems.append(f"Only {found} messages were {name}, at least {least} are expected.")
    return problems


def judge_always(outcome: Outcome) -> list[str]:
    """Return what may never happen and did.

    Only finite numbers go to the motors, gains are never negative, and nobody moves a robot that
    has not been heard for 100 ms.
    """
    for tick in outcome.ticks:
        command = tick.command
        for name in ("joint_pos_target", "joint_stiffness", "joint_damping"):
            values = np.asarray(getattr(command, name))
            if not np.isfinite(values).all() or (name != "joint_pos_target" and values.min() < 0):
                return [f"{name} at {tick.time_s:.2f} s is not fit for a motor."]
        is_blind = tick.status.state_age_us > MAX_BLIND_US
        if is_blind and command.mode == g1_low_cmd_t.MODE_POSITION:
            age_ms = tick.status.state_age_us // 1000
            return [f"A position is commanded at {tick.time_s:.2f} s on a state {age_ms} ms old."]
    return []


def compare(outcome: Outcome, calm: Outcome) -> list[str]:
    """Return where the commands differ from the undisturbed run's."""
    for disturbed, undisturbed in zip(outcome.records, calm.records, strict=True):
        if disturbed["command"] != undisturbed["command"]:
            tick = disturbed["tick"]
            return [f"The command of tick {tick} differs from the undisturbed run's."]
    return []
