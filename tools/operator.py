"""The operator's seat: ask for a skill, stop, spy, doctor."""

from __future__ import annotations

import json
import sys
import time
from typing import Any

from rich.console import Console
from rich.table import Table

from downbeat.lcm_types import estop_t, operator_command_t, skill_request_t, skill_status_t
from downbeat.runtime.bus import DEFAULT_URL, open_udpm
from downbeat.runtime.clock import WallClock
from downbeat.tools.rundir import CACHE_DIR

ANSWER_TIMEOUT_S = 15.0
STATES = {v: k for k, v in vars(skill_status_t).items() if k.isupper() and isinstance(v, int)}
GOOD = {skill_status_t.RUNNING, skill_status_t.DONE}
FINAL = GOOD | {
    skill_status_t.REFUSED,
    skill_status_t.CANCELLED,
    skill_status_t.EXPIRED,
    skill_status_t.ABORTED,
}


def ask(skill: str, seconds: float, velocity: tuple[float, float, float], url: str) -> int:
    """Ask for a skill and print every answer; 0 once it runs."""
    clock = WallClock()
    bus = open_udpm(url or DEFAULT_URL, clock, "operator")
    bus.subscribe("SKILL_STATUS", "CONTROL_STATUS")
    now = _control_time(bus)
    if now is None:
        print("downbeat: no control process answers; `downbeat demo` starts one", file=sys.stderr)
        return 1
    msg: Any = skill_request_t()
    msg.header.utime = now
    msg.request_id = time.time_ns() // 1_000_000
    msg.skill = skill
    msg.source = skill_request_t.SOURCE_OPERATOR
    msg.priority = 10
    msg.phase_rate = 1.0
    msg.duration_s = seconds
    msg.velocity = velocity
    msg.cause = "downbeat ask"
    bus.publish("OPERATOR_SKILL_REQUEST", msg)
    deadline = time.monotonic() + ANSWER_TIMEOUT_S
    while time.monotonic() < deadline:
        bus.pump(0.1)
        for received in bus.take("SKILL_STATUS"):
            answer = received.msg
            if answer.request_id != msg.request_id:
                continue
            print(f"{STATES[answer.state].lower()} {answer.plan} {answer.reason}".strip())
            if answer.state in FINAL:
                return 0 if answer.state in GOOD else 1
    print(f"downbeat: no answer within {ANSWER_TIMEOUT_S:.0f} s", file=sys.stderr)
    return 1


def _control_time(bus: Any) -> int | None:
    """Return control's own time [us], None if no control process is on the bus."""
    deadline = time.monotonic() + 1.0
    while time.monotonic() < deadline:
        bus.pump(0.1)
        latest = bus.latest("CONTROL_STATUS")
        if latest is not None:
            return int(latest.msg.header.utime)
    return None


def stop(level: str, reason: str, url: str) -> int:
    """Publish an emergency stop (three times: UDP may lose one), or clear a trip."""
    clock = WallClock()
    bus = open_udpm(url or DEFAULT_URL, clock, "operator")
    levels = {"damp": estop_t.DAMP, "zero_torque": estop_t.ZERO_TORQUE}
    for _ in range(3):
        if level == "clear":
            command: Any = operator_command_t()
            command.header.utime = clock.utime()
            command.command = operator_command_t.CLEAR_TRIP
            command.source = reason
            bus.publish("OPERATOR_COMMAND", command)
        else:
            msg: Any = estop_t()
            msg.header.utime = clock.utime()
            msg.level = levels[level]
            msg.source = "operator"
            msg.reason = reason
            bus.publish("ESTOP", msg)
        time.sleep(0.02)
    bus.close()
    return 0


def spy(url: str) -> int:
    """Run lcm-spy until its window is closed."""
    from downbeat.tools.spy import start_spy

    return start_spy(url, CACHE_DIR).wait()


def doctor(url: str, as_json: bool, interface: str = "", domain: int = 0) -> int:
    """Print the checks; 0 if nothing fails."""
    from dataclasses import asdict

    from downbeat.tools.doctor import is_healthy, run_doctor

    results = run_doctor(url, interface, domain)
    if as_json:
        print(json.dumps([asdict(result) for result in results]))
    else:
        table = Table("check", "", "found", "what to do")
        colours = {"ok": "green", "warn": "yellow", "fail": "red"}
        for result in results:
            mark = f"[{colours[result.status]}]{result.status}[/]"
            table.add_row(result.name, mark, result.detail, result.fix)
        Console().print(table)
    return 0 if is_healthy(results) else 1
