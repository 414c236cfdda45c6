"""`downbeat traffic`: play a scenario against control and the plant, and judge what happened."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from downbeat.control.core import ControlCore, TickInput, TickOutput
from downbeat.control.faults import FAULTS
from downbeat.control.node import ControlNode
from downbeat.control.policy import SkillLibrary
from downbeat.control.record import COMPARED, input_of, tick_record
from downbeat.lcm_types import control_status_t, g1_low_cmd_t, skill_request_t, skill_status_t
from downbeat.runtime.bus import MemqHub
from downbeat.runtime.clock import SIM_EPOCH_UTIME, SimClock
from downbeat.runtime.traffic import Impairer, Injection, Injector
from downbeat.sim.lockstep import STEP_US, Lockstep
from downbeat.sim.node import SimNode
from downbeat.sim.plant import PlantConfig
from downbeat.tools.errors import ToolError
from downbeat.tools.scenario import Expectation, Scenario, Shove, load_scenario

CONDUCTOR_EPOCH = 77
PUSH_S = 0.1
MODES = {v: k for k, v in vars(control_status_t).items() if k.isupper() and isinstance(v, int)}
STATES = {v: k for k, v in vars(skill_status_t).items() if k.isupper() and isinstance(v, int)}
COMMANDS = {
    g1_low_cmd_t.MODE_POSITION: "position",
    g1_low_cmd_t.MODE_DAMPING: "damping",
    g1_low_cmd_t.MODE_ZERO_TORQUE: "zero_torque",
}
FAULT_NAMES = {row.id: row.name for row in FAULTS}


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
        problems: What was expected and did not happen; empty: all is well.
        records: Journal records of the run.
    """

    ticks: list[Seen] = field(default_factory=list)
    requests: dict[int, list[str]] = field(default_factory=dict)
    reasons: dict[int, str] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    records: list[dict[str, Any]] = field(default_factory=list)


class _InjectorNode:
    """Publishes the injected messages at their time."""

    name = "traffic"
    period_us = STEP_US

    def __init__(self, hub: MemqHub, injector: Injector) -> None:
        self._hub = hub
        self._injector = injector

    def step(self, utime: int) -> None:
        for _, channel, payload in self._injector.take(utime):
            self._hub.deliver(utime, channel, payload)

    def close(self) -> None:
        """Nothing to release."""


class _Pusher:
    """Shoves the robot at the asked times."""

    name = "pusher"
    period_us = STEP_US

    def __init__(self, sim: SimNode, pushes: Sequence[Shove], start_utime: int) -> None:
        self._data = sim.plant.data
        self._body = sim.plant.model.body("torso_link").id
        self._pushes = pushes
        self._start = start_utime

    def step(self, utime: int) -> None:
        time_s = (utime - self._start) * 1e-6
        force = [0.0, 0.0]
        for push in self._pushes:
            if push.at_s - 1e-9 <= time_s < push.at_s + PUSH_S - 1e-9:
                angle = math.radians(push.direction_deg)
                force[0] += push.impulse_n_s / PUSH_S * math.cos(angle)
                force[1] += push.impulse_n_s / PUSH_S * math.sin(angle)
        self._data.xfrc_applied[self._body, :2] = force

    def close(self) -> None:
        """Nothing to release."""


def run_scenario(scenario: Scenario, library: SkillLibrary) -> Outcome:
    """Play a scenario in lockstep over memq, with the real control and the real plant, and judge.

    Args:
        scenario: What happens.
        library: Holds at least the scenario's skills.
    """
    outcome = _play(scenario, library)
    outcome.problems += _check_commands(outcome)
    for one in scenario.expect:
        outcome.problems += judge(one, outcome)
    if scenario.commands_unchanged:
        calm = _play(replace(scenario, impair=(), inject=()), library)
        outcome.problems += _compare(outcome, calm)
    outcome.problems += _replay(outcome, library)
    return outcome


def _play(scenario: Scenario, library: SkillLibrary) -> Outcome:
    clock = SimClock(SIM_EPOCH_UTIME)
    start = clock.utime()
    hub = MemqHub(scenario.seed)
    if scenario.impair:
        hub.impair(Impairer(scenario.impair, start, scenario.seed))
    outcome = Outcome()

    def journal(inputs: TickInput, output: TickOutput) -> None:
        outcome.records.append(tick_record(inputs, output))
        height = sim.plant.base_height
        seen = Seen((inputs.utime - start) * 1e-6, output.status, output.command, height)
        outcome.ticks.append(seen)
        for change in output.changes:
            outcome.requests.setdefault(change.key[1], []).append(STATES[change.state])
            if change.reason:
                outcome.reasons[change.key[1]] = change.reason

    sim = SimNode(hub.endpoint("sim", clock), PlantConfig(seed=scenario.seed))
    control = ControlNode(hub.endpoint("control", clock), ControlCore(library), journal)
    injections = (*_asks(scenario), *scenario.inject)
    pusher = _Pusher(sim, scenario.push, start)
    traffic = _InjectorNode(hub, Injector(injections, start, scenario.seed))
    scheduler = Lockstep(clock, (traffic, pusher, sim, control))
    scheduler.run_until(start + round(scenario.seconds * 1e6))
    scheduler.close()
    return outcome


def _asks(scenario: Scenario) -> list[Injection]:
    found = []
    for number, ask in enumerate(scenario.ask, start=1):
        defaults: dict[str, Any] = {
            "request_id": number,
            "skill": ask.skill,
            "phase_rate": 1.0,
            "start_utime": ask.at_s,
            "source": skill_request_t.SOURCE_MUSIC,
            "header.seq": number,
        }
        found.append(
            Injection(
                "SKILL_REQUEST",
                ask.at_s,
                fields={**defaults, **ask.fields},
                epoch=CONDUCTOR_EPOCH,
            )
        )
    return found


# ---------------------------------------------------------------------------- judging


def judge(one: Expectation, outcome: Outcome) -> list[str]:
    """Return what is wrong, in sentences; empty if the expectation holds."""
    problems = _judge_requests(one, outcome) + _judge_counters(one, outcome)
    wanted = _wanted(one)
    if not wanted:
        return problems
    last_s = max(one.until_s, one.after_s + one.within_ms * 1e-3)
    window = [t for t in outcome.ticks if one.after_s - 1e-6 <= t.time_s <= last_s + 1e-6]
    if not window:
        return [*problems, f"There is no tick between {one.after_s:g} s and {last_s:g} s."]
    if one.until_s:
        must = [t for t in window if t.time_s >= one.after_s + one.within_ms * 1e-3 - 1e-6]
        bad = next((t for t in must if not _holds(one, t)), None)
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
    ):
        if found < least:
            problems.append(f"Only {found} messages were {name}, at least {least} are expected.")
    return problems


def _check_commands(outcome: Outcome) -> list[str]:
    """Whatever happens: only finite numbers go to the motors, and gains are never negative."""
    for tick in outcome.ticks:
        command = tick.command
        for name in ("joint_pos_target", "joint_stiffness", "joint_damping"):
            values = np.asarray(getattr(command, name))
            if not np.isfinite(values).all() or (name != "joint_pos_target" and values.min() < 0):
                return [f"{name} at {tick.time_s:.2f} s is not fit for a motor."]
    return []


def _compare(outcome: Outcome, calm: Outcome) -> list[str]:
    for a, b in zip(outcome.records, calm.records, strict=True):
        if a["command"] != b["command"]:
            return [f"The command of tick {a['tick']} differs from the undisturbed run's."]
    return []


def _replay(outcome: Outcome, library: SkillLibrary) -> list[str]:
    """Every scenario replays bit for bit, whatever it does to the bus."""
    core = ControlCore(library)
    for record in outcome.records:
        inputs = input_of(record)
        again = tick_record(inputs, core.tick(inputs))
        for name in COMPARED:
            if record[name] != again[name] and record[name] == record[name]:
                return [f"Replay differs at tick {record['tick']} in {name}."]
    return []


# ---------------------------------------------------------------------------- command


def traffic_command(path: Path, url: str, as_json: bool) -> int:
    """`downbeat traffic`: 0 if everything happened as expected."""
    scenario = load_scenario(path)
    if url:
        return play_on_bus(scenario, url)
    library = SkillLibrary.load(only=scenario.needed_skills)
    missing = scenario.needed_skills - set(library.names)
    if missing:
        raise ToolError(f"{path}: skill '{min(missing)}' is unknown (ask.skill).")
    outcome = run_scenario(scenario, library)
    if as_json:
        print(json.dumps(_summary(scenario, outcome)))
    else:
        _print(scenario, outcome)
    return 1 if outcome.problems else 0


def _summary(scenario: Scenario, outcome: Outcome) -> Mapping[str, Any]:
    return {
        "sentence": scenario.sentence,
        "ticks": len(outcome.ticks),
        "requests": outcome.requests,
        "reasons": outcome.reasons,
        "problems": outcome.problems,
    }


def _print(scenario: Scenario, outcome: Outcome) -> None:
    table = Table("from", "mode", "motors", "skill", "fault", title=scenario.sentence)
    before = None
    for tick in outcome.ticks:
        status = tick.status
        row = (
            MODES[status.mode],
            COMMANDS[tick.command.mode],
            status.skill,
            status.fault_text or "-",
        )
        if before is None or (row[:3], row[3][:12]) != (before[:3], before[3][:12]):
            table.add_row(f"{tick.time_s:.2f} s", *row)
        before = row
    console = Console()
    console.print(table)
    for number, states in sorted(outcome.requests.items()):
        reason = outcome.reasons.get(number, "")
        console.print(f"request {number}: {' -> '.join(states)} {reason}", highlight=False)
    for problem in outcome.problems:
        console.print(problem, style="bold red")
    if not outcome.problems:
        console.print("as expected", style="bold green")


def play_on_bus(scenario: Scenario, url: str) -> int:
    """Publish a scenario's requests and injections on a running bus, in real time.

    Raises:
        ToolError: It would command motors, or impair messages that it does not carry.
    """
    import lcm

    if scenario.impair:
        raise ToolError(
            "A scenario with [[impair]] cannot be played on a running bus: nobody but the network "
            "stands between its processes. Without --url it is played in lockstep."
        )
    if any(one.channel in ("G1_LOW_CMD", "G1_LOW_STATE") for one in scenario.inject):
        raise ToolError(
            "A scenario that injects G1_LOW_CMD or G1_LOW_STATE is not played on a running bus: a "
            "robot may be listening. Without --url it is played in lockstep."
        )
    link = lcm.LCM(url)
    start = time.time_ns() // 1000
    injector = Injector((*_asks(scenario), *scenario.inject), start, scenario.seed)
    count = 0
    while injector.next_utime is not None:
        time.sleep(max(0.0, (injector.next_utime - time.time_ns() // 1000) * 1e-6))
        for _, channel, payload in injector.take(time.time_ns() // 1000):
            link.publish(channel, payload)
            count += 1
    print(f"published {count} messages on {url}")
    return 0
