"""Turns the samples of `downbeat bench control` into figures, and prints them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from downbeat.control.phase import TICK_US

F64 = NDArray[np.float64]

FRAMEWORK_P50_US = 150.0
"""The closest peer spends 2310 us (RoboJuDo, the same robot and kind of policy)."""
DRIFT_MS_PER_MIN = 0.1
LATENESS_RATIO = 2.0
REQUEST_TICKS = 1.0
STATES = ("idle", "loaded")


@dataclass(frozen=True)
class Block:
    """One block of one program; lists have one entry per tick.

    Attributes:
        kind: "control", "c", "network" or "warm" (control back to back, without sleep).
        loaded: Beside busy processors.
        start_utime: First moment [us].
        end_utime: Last one [us].
        lateness_us: Wake-up after the deadline [us].
        compute_us: Of the tick; network: of its run alone [us].
        network_us: Time inside ONNX Runtime in that tick [us].
        missed: Deadlines given up.
        cpu_s: Processor time [s].
        memory_kb: Resident memory at the end [KiB].
        faults: Ticks with a fault.
    """

    kind: str
    loaded: bool
    start_utime: int
    end_utime: int
    lateness_us: list[float]
    compute_us: list[float] = field(default_factory=list)
    network_us: list[float] = field(default_factory=list)
    missed: int = 0
    cpu_s: float = 0.0
    memory_kb: int = 0
    faults: int = 0


def report_of(
    blocks: Sequence[Block],
    answers: Sequence[tuple[int, int]],
    messages: Sequence[str] = (),
    granted: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Compute the report.

    Top-level figures pool every state that was run; `idle` and `loaded` have them apart.

    Args:
        blocks: In the order in which they ran.
        answers: (utime of the request, utime of the first tick that plays it, 0: none) [us].
        messages: What the machine did not permit.
        granted: What it did.

    Returns:
        A dictionary ready for JSON; unknown values are None.
    """
    pooled = _state(blocks, answers)
    report: dict[str, Any] = {
        "framework_us": pooled["framework_us"],
        "warm_framework_us": pooled["warm_framework_us"],
        "warm_tick_us": pooled["warm_tick_us"],
        "lateness_us": pooled["control"]["lateness_us"],
        "lateness_ratio_to_c": pooled["lateness_ratio_to_c"],
        "missed": pooled["control"]["missed"],
        "drift_ms_per_min": pooled["control"]["drift_ms_per_min"],
        "request_ticks": pooled["request_ticks"],
        "memory_growth_kb": _memory_growth(blocks),
    }
    for name in STATES:
        chosen = [block for block in blocks if block.loaded == (name == "loaded")]
        report[name] = _state(chosen, answers) if chosen else None
    report["targets"] = _targets(report)
    report["granted"] = granted
    report["messages"] = list(messages)
    return report


def _state(blocks: Sequence[Block], answers: Sequence[tuple[int, int]]) -> dict[str, Any]:
    control, c, network, warm = (
        [block for block in blocks if block.kind == kind]
        for kind in ("control", "c", "network", "warm")
    )
    network_us = percentiles(_joined(network, "compute_us"), (50, 99, 99.9))
    ours, theirs = _loop(control), _loop(c)
    ratio = None
    if ours and theirs and theirs["lateness_us"]["p99"]:
        ratio = _rounded(ours["lateness_us"]["p99"] / theirs["lateness_us"]["p99"], 3)
    if ours is not None:
        compute = _joined(control, "compute_us")
        ours["compute_us"] = percentiles(compute, (50, 99, 99.9))
        ours["cpu_us_per_tick"] = _rounded(sum(b.cpu_s for b in control) * 1e6 / len(compute))
        ours["faults"] = sum(block.faults for block in control)
    return {
        "framework_us": percentiles(framework_us(control), (50, 99)),
        "warm_framework_us": percentiles(framework_us(warm), (50, 99)),
        "in_tick_network_us": percentiles(_joined(control, "network_us"), (50, 99)),
        "warm_tick_us": percentiles(_joined(warm, "compute_us"), (50, 99)),
        "lateness_ratio_to_c": ratio,
        "request_ticks": _requests(control, answers),
        "control": ours,
        "c": theirs,
        "network": {"run_us": network_us} if network else None,
    }


def framework_us(control: Sequence[Block]) -> F64:
    """Return each tick's time outside the networks [us]: compute minus what ran in ONNX Runtime."""
    return _joined(control, "compute_us") - _joined(control, "network_us")


def _loop(blocks: Sequence[Block]) -> dict[str, Any] | None:
    lateness = _joined(blocks, "lateness_us")
    if not lateness.size:
        return None
    return {
        "ticks": int(lateness.size),
        "missed": sum(block.missed for block in blocks),
        "lateness_us": percentiles(lateness, (50, 99, 99.9)),
        "drift_ms_per_min": _rounded(float(np.mean([drift(b) for b in blocks])), 4),
    }


def drift(block: Block) -> float:
    """Return how fast a block's lateness grows [ms/min].

    The change of the median from the first third to the last: a single late wake-up is not drift.
    """
    lateness = np.asarray(block.lateness_us)
    third = len(lateness) // 3
    if third == 0:
        return 0.0
    change_us = float(np.median(lateness[-third:]) - np.median(lateness[:third]))
    elapsed_s = (len(lateness) - third) * TICK_US * 1e-6
    return change_us * 1e-3 / (elapsed_s / 60.0)


def _requests(control: Sequence[Block], answers: Sequence[tuple[int, int]]) -> dict[str, Any]:
    spans = [(block.start_utime, block.end_utime) for block in control]
    inside = [(asked, shown) for asked, shown in answers if any(a <= asked <= b for a, b in spans)]
    # A request that a block's end cut off says nothing.
    cut = [a for a, b in inside if b == 0 and any(0 <= end - a < 3 * TICK_US for _, end in spans)]
    ticks = np.array([(shown - asked) / TICK_US for asked, shown in inside if shown])
    found = percentiles(ticks, (50,), digits=3)
    unanswered = sum(1 for _, shown in inside if shown == 0) - len(cut)
    return {**found, "count": int(ticks.size), "unanswered": unanswered}


def _memory_growth(blocks: Sequence[Block]) -> int | None:
    """Return the growth from one of control's blocks to a later one [KiB].

    Inside a block memory grows as the black box fills, and the first block is the first of
    everything; from the end of the second block to the end of the last it must not grow.
    """
    sizes = [block.memory_kb for block in blocks if block.kind == "control"]
    settled = sizes[1:] if len(sizes) > 2 else sizes
    return settled[-1] - settled[0] if len(settled) > 1 else None


def percentiles(values: F64, points: tuple[float, ...], digits: int = 1) -> dict[str, float | None]:
    """Return {"p50": .., "p999": .., "max": ..}; None without values."""
    names = [f"p{point:g}".replace(".", "") for point in points]
    if values.size == 0:
        return dict.fromkeys([*names, "max"])
    found = dict(zip(names, (_rounded(v, digits) for v in np.percentile(values, points))))
    return {**found, "max": _rounded(values.max(), digits)}


def _joined(blocks: Sequence[Block], name: str) -> F64:
    parts = [np.asarray(getattr(block, name), np.float64) for block in blocks]
    return np.concatenate(parts) if parts else np.zeros(0)


def _rounded(value: float, digits: int = 1) -> float:
    return round(float(value), digits)


def _targets(report: dict[str, Any]) -> list[dict[str, Any]]:
    """Return what is to be reached; `ok` is None where nothing was measured."""
    request = report["request_ticks"]
    drift = report["drift_ms_per_min"]
    rows = (
        ("framework p50 [us]", report["framework_us"]["p50"], FRAMEWORK_P50_US),
        ("drift [ms/min]", None if drift is None else abs(drift), DRIFT_MS_PER_MIN),
        ("lateness p99, times C's", report["lateness_ratio_to_c"], LATENESS_RATIO),
        ("request to first tick [ticks]", request["max"], REQUEST_TICKS),
        ("requests without an answer", request["unanswered"], 0),
    )
    return [
        {
            "name": name,
            "value": value,
            "limit": limit,
            "ok": None if value is None else value <= limit,
        }
        for name, value, limit in rows
    ]


def print_report(report: dict[str, Any], console: Console) -> None:
    """Print the figures by state, then the targets."""
    states = [name for name in STATES if report[name] is not None]
    table = Table("what", *states)
    for title, *path in ROWS:
        table.add_row(escape(title), *(_cell(report[name], path) for name in states))
    console.print(table)
    targets = Table("target", "measured", "at most", "")
    for row in report["targets"]:
        mark = {None: "not measured", True: "reached", False: "missed"}[row["ok"]]
        value = "-" if row["value"] is None else f"{row['value']:g}"
        targets.add_row(escape(row["name"]), value, f"{row['limit']:g}", mark)
    console.print(targets)
    if report["memory_growth_kb"] is not None:
        console.print(f"Memory grew by {report['memory_growth_kb']} KiB from block to block.")
    for message in report["messages"]:
        console.print(message)


ROWS = (
    ("lateness, ours [us] p50 / p99 / p99.9 / max", "control", "lateness_us"),
    ("lateness, C [us]", "c", "lateness_us"),
    ("lateness p99, times C's", "lateness_ratio_to_c"),
    ("drift, ours [ms/min]", "control", "drift_ms_per_min"),
    ("drift, C [ms/min]", "c", "drift_ms_per_min"),
    ("ticks missed, ours", "control", "missed"),
    ("ticks missed, C", "c", "missed"),
    ("tick [us] p50 / p99 / p99.9 / max", "control", "compute_us"),
    ("bare network [us] p50 / p99 / p99.9 / max", "network", "run_us"),
    ("framework [us] p50 / p99 / max", "framework_us"),
    ("network, inside the tick [us] p50 / p99 / max", "in_tick_network_us"),
    ("tick back to back, warm [us] p50 / p99 / max", "warm_tick_us"),
    ("framework, warm [us] p50 / p99 / max", "warm_framework_us"),
    ("processor time per tick [us]", "control", "cpu_us_per_tick"),
    ("request to first tick [ticks] p50 / max / n / unanswered", "request_ticks"),
    ("ticks with a fault", "control", "faults"),
)


def _cell(value: Any, path: Sequence[str]) -> str:
    for key in path:
        value = None if value is None else value[key]
    if isinstance(value, dict):
        return " / ".join("-" if part is None else f"{part:g}" for part in value.values())
    return "-" if value is None else f"{value:g}"
