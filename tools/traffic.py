"""`downbeat traffic`: play a scenario against control and the plant, and judge what happened."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from downbeat.control.policy import SkillLibrary
from downbeat.tools.scenario import Scenario, load_scenario
from downbeat.tools.traffic_judge import COMMANDS, MODES, Outcome
from downbeat.tools.traffic_play import run_scenario

__all__ = ["run_scenario", "traffic_command"]


def traffic_command(path: Path, url: str, as_json: bool) -> int:
    """`downbeat traffic`: 0 if everything happened as expected, 1 if not."""
    scenario = load_scenario(path)
    sent = None
    if url:
        from downbeat.tools.traffic_bus import play_on_bus

        outcome, sent = play_on_bus(scenario, url)
    else:
        outcome = run_scenario(scenario, SkillLibrary.load(only=scenario.needed_skills))
    if as_json:
        print(json.dumps(_summary(scenario, outcome, sent)))
    else:
        _print(scenario, outcome)
    if sent is not None:
        note = "" if outcome.ticks else "; no control was heard, so nothing is judged"
        print(f"published {sent} messages on {url}{note}", file=sys.stderr)
    return 1 if outcome.problems else 0


def _summary(scenario: Scenario, outcome: Outcome, sent: int | None) -> Mapping[str, Any]:
    return {
        "sentence": scenario.sentence,
        "ticks": len(outcome.ticks),
        "published": sent,
        "requests": outcome.requests,
        "reasons": outcome.reasons,
        "problems": outcome.problems,
        "pending": scenario.pending,
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
    if scenario.pending:
        console.print(f"pending: {scenario.pending}", style="yellow")
    if outcome.ticks and not outcome.problems:
        console.print("as expected", style="bold green")
