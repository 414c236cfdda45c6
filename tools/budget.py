"""`downbeat budget`: what a run cost, by its own log, against a table of budgets."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from downbeat import catalog
from downbeat.lcm_types.channels import CHANNELS
from downbeat.runtime.config import load_config
from downbeat.tools.budget_run import ChannelTimes, ProcessTimes, RunCosts, read_costs
from downbeat.tools.errors import ToolError

BUDGET_PATH = Path(catalog.__file__).with_name("budget.toml")
DEFAULT = "default"
SETTLED_S = 15.0
"""Buffers fill first: the black box holds 10 s."""
SHORTEST_GROWTH_S = 10.0
"""A slope over less says nothing."""


@dataclass(frozen=True)
class ProcessBudget:
    """Limits of one process; the file says what they are."""

    cpu_share: float
    memory_mb: float
    memory_growth_mb_per_min: float
    log_lines_per_min: float


@dataclass(frozen=True)
class ChannelBudget:
    """Limits of one channel."""

    rate_error: float
    jitter_p99_ms: float
    lost: float


@dataclass(frozen=True)
class ControlBudget:
    """Limits of control's loop and of what is written."""

    lateness_p99_us: float
    compute_p99_us: float
    missed: float
    log_mb_per_min: float
    journal_mb_per_min: float


@dataclass(frozen=True)
class Budget:
    """The table: processes and channels by name, each with a `default`."""

    process: dict[str, ProcessBudget]
    channel: dict[str, ChannelBudget]
    control: ControlBudget


@dataclass(frozen=True)
class Line:
    """One line of the comparison.

    Attributes:
        group: "process", "channel" or "control".
        name: Of the process or channel.
        what: Key of the budget file.
        value: Measured; None: the run does not say.
        limit: At most this.
    """

    group: str
    name: str
    what: str
    value: float | None
    limit: float

    @property
    def ok(self) -> bool | None:
        """Whether it is within budget; None: not measured."""
        return None if self.value is None else self.value <= self.limit


def load_budget(path: Path = BUDGET_PATH) -> Budget:
    """Read a budget file.

    Raises:
        DownbeatError: Missing, not TOML, an unknown key, channel or wrong type (file:key).
    """
    budget = load_config(path, Budget)
    for group in ("process", "channel"):
        if DEFAULT not in getattr(budget, group):
            raise ToolError(f"{path}:{group}.{DEFAULT} is missing; it holds for all not named.")
    for name in budget.channel:
        if name != DEFAULT and name not in CHANNELS:
            raise ToolError(
                f"{path}:channel.{name} is not in the channel table (lcm_types/channels.py)."
            )
    return budget


def compare(costs: RunCosts, budget: Budget) -> list[Line]:
    """Hold a run against the table; one line per limit."""
    lines: list[Line] = []
    for name, process in sorted(costs.processes.items()):
        row = budget.process.get(name, budget.process[DEFAULT])
        lines += _lines("process", name, _process_values(process), row)
    for name, channel in sorted(costs.channels.items()):
        limits = budget.channel.get(name, budget.channel[DEFAULT])
        lines += _lines("channel", name, _channel_values(channel), limits)
    lines += _lines("control", "control", _control_values(costs), budget.control)
    return lines


def _lines(group: str, name: str, values: dict[str, float | None], limits: Any) -> Iterator[Line]:
    for what, limit in asdict(limits).items():
        yield Line(group, name, what, values[what], limit)


def _process_values(process: ProcessTimes) -> dict[str, float | None]:
    found: dict[str, float | None] = {
        "cpu_share": None,
        "memory_mb": None,
        "memory_growth_mb_per_min": None,
        "log_lines_per_min": _per_minute(process.log_lines, process.duration_s),
    }
    elapsed_s = process.elapsed_s  # (n,)
    if elapsed_s.size < 2 or elapsed_s[-1] <= elapsed_s[0]:
        return found
    found["cpu_share"] = float(np.ptp(process.cpu_s) / np.ptp(elapsed_s))
    found["memory_mb"] = float(process.memory_mb[-1])
    settled = elapsed_s >= SETTLED_S
    if settled.any() and np.ptp(elapsed_s[settled]) >= SHORTEST_GROWTH_S:
        slope = np.polyfit(elapsed_s[settled], process.memory_mb[settled], 1)[0]
        found["memory_growth_mb_per_min"] = float(slope * 60.0)
    return found


def _channel_values(channel: ChannelTimes) -> dict[str, float | None]:
    found: dict[str, float | None] = {"rate_error": None, "jitter_p99_ms": None, "lost": None}
    gaps = channel.gaps_us
    if gaps.size == 0:
        return found
    nominal_us = 1e6 / CHANNELS[channel.name].rate_hz
    found["rate_error"] = float(abs(nominal_us / max(gaps.mean(), 1.0) - 1.0))
    found["jitter_p99_ms"] = float(np.percentile(np.abs(gaps - nominal_us), 99) * 1e-3)
    found["lost"] = channel.lost / (channel.lost + channel.count)
    return found


def _control_values(costs: RunCosts) -> dict[str, float | None]:
    ticks = len(costs.lateness_us)
    has_ticks = ticks > 0
    return {
        "lateness_p99_us": float(np.percentile(costs.lateness_us, 99)) if has_ticks else None,
        "compute_p99_us": float(np.percentile(costs.compute_us, 99)) if has_ticks else None,
        "missed": costs.missed / (costs.missed + ticks) if has_ticks else None,
        "log_mb_per_min": _per_minute(costs.log_bytes * 1e-6, costs.duration_s),
        "journal_mb_per_min": _per_minute(costs.journal_bytes * 1e-6, costs.duration_s),
    }


def _per_minute(amount: float, duration_s: float) -> float | None:
    return amount / (duration_s / 60.0) if duration_s > 0.0 and math.isfinite(amount) else None


def budget_command(run_dir: Path, table: Path | None, as_json: bool) -> int:
    """Compare and print; 1 if anything is over its budget."""
    budget = load_budget(table or BUDGET_PATH)
    lines = compare(read_costs(run_dir), budget)
    over = [line for line in lines if line.ok is False]
    if as_json:
        rows = [{**asdict(line), "ok": line.ok} for line in lines]
        print(json.dumps({"ok": not over, "over": len(over), "lines": rows}))
    else:
        _print(lines, Console())
    return 1 if over else 0


def _print(lines: list[Line], console: Console) -> None:
    table = Table("of", "what", "measured", "at most", "")
    previous = ""
    for line in lines:
        shown = line.name if line.name != previous else ""
        previous = line.name
        value = "-" if line.value is None else f"{line.value:.4g}"
        mark = {None: "", True: "ok", False: "OVER"}[line.ok]
        style = "red" if line.ok is False else None
        table.add_row(shown, line.what, value, f"{line.limit:g}", mark, style=style)
    console.print(table)
    missing = sum(line.value is None for line in lines)
    if missing:
        console.print(f"{missing} not measured (-): lockstep has no heartbeats, or it was short.")
