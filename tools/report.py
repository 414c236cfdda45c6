"""The result of a run: metrics.json and the table that a person reads."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.box import SIMPLE
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from downbeat.tools.metrics import compute_metrics, write_metrics

GOOD, BAD, UNKNOWN = "green", "bold red", "dim"
BOUNDARY_WORDS = {"start": "start", "announced": "known", "unannounced": "surprise"}


def report(run_dir: Path, replay_equal: bool | None = None) -> dict[str, Any]:
    """Compute the metrics of a run folder, write metrics.json, return them.

    Args:
        run_dir: The folder.
        replay_equal: Whether control was re-executed bit for bit; None: not tried.

    Raises:
        ToolError: The log or the truth file is missing or wrong.
    """
    metrics = compute_metrics(run_dir)
    if replay_equal is not None:
        metrics["replay_equal"] = replay_equal
    write_metrics(run_dir, metrics)
    return metrics


def is_good(metrics: dict[str, Any]) -> bool:
    """Return whether the robot stayed up and followed every section."""
    groups = (metrics["announced"], metrics["unannounced"])
    followed = all(group["followed"] == group["total"] for group in groups)
    return followed and metrics["falls"] == 0


def print_report(metrics: dict[str, Any], console: Console | None = None) -> None:
    """Print the sections and the numbers."""
    (console or Console()).print(result_table(metrics))


def result_table(metrics: dict[str, Any]) -> RenderableType:
    """Return everything that a person wants to see after a run."""
    return Group(_sections_table(metrics["sections"]), _numbers_table(metrics), _verdict(metrics))


def _sections_table(rows: list[dict[str, Any]]) -> Table:
    """Return one line per section; it fits a terminal of 80 columns."""
    table = Table(box=None, header_style="bold dim", pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("from", justify="right", no_wrap=True)
    for name in ("track", "asked", "boundary"):
        table.add_column(name, no_wrap=True)
    for name in ("onset", "danced", "beat p95"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    for row in rows:
        table.add_row(
            _clock(row["start_s"]),
            _short(row["track"]),
            Text(row["skill"], style="bold"),
            BOUNDARY_WORDS[row["boundary"]],
            _onset(row),
            f"{100 * row['followed_fraction']:.0f} %",
            _value(row["beat_phase_error_p95_ms"], "{:.0f} ms"),
            _mark(row),
        )
    return table


def _short(name: str, length: int = 13) -> str:
    return name if len(name) <= length else f"{name[: length - 1]}\u2026"


def _clock(seconds: float) -> str:
    tenths = round(seconds * 10)
    return f"{tenths // 600}:{tenths % 600 / 10:04.1f}"


def _onset(row: dict[str, Any]) -> Text:
    """An announced onset is an error in milliseconds, a surprised one a reaction in seconds."""
    if row["onset_error_ms"] is not None:
        return Text(f"{round(row['onset_error_ms']):+d} ms")
    return _value(row["reaction_s"], "{:+.2f} s")


def _mark(row: dict[str, Any]) -> Text:
    if not row["upright"]:
        return Text("fell", style=BAD)
    return Text("\u2714", style=GOOD) if row["followed"] else Text("missed", style=BAD)


def _value(value: float | None, form: str) -> Text:
    return Text("-", style=UNKNOWN) if value is None else Text(form.format(value))


def _numbers_table(metrics: dict[str, Any]) -> Table:
    table = Table(box=SIMPLE, show_header=False, pad_edge=False)
    table.add_column(style="dim")
    table.add_column()
    announced, surprising = metrics["announced"], metrics["unannounced"]
    errors, reactions = announced["onset_error_ms"], surprising["reaction_s"]
    beat, control = metrics["beat_phase_error_ms"], metrics["control"]
    table.add_row("falls, safety trips", _zero(metrics["falls"], metrics["safety_trips"]))
    table.add_row(
        "announced changes",
        _followed(announced) + _spread(", onset error", errors, ("p50", "p95", "max"), "ms"),
    )
    table.add_row(
        "start and surprises",
        _followed(surprising) + _spread(", reaction", reactions, ("p50", "p95", "max"), "s"),
    )
    table.add_row("beat phase error", _spread("", beat, ("p50", "p95", "max"), "ms"))
    table.add_row("body behind the music", _value(metrics["physical_lag_ms"], "{:.0f} ms"))
    kinds = metrics["transitions"]
    table.add_row("transitions", Text(", ".join(f"{n} {k}" for k, n in kinds.items())))
    if metrics["checks"]["asked"]:
        table.add_row("checked ahead", Text(_checked(metrics["checks"])))
    chunks = metrics["chunks"]
    table.add_row("windows named right", Text(f"{chunks['correct']} of {chunks['total']}"))
    late = _spread(", lateness", control["lateness_us"], ("p50", "p99", "max"), "us")
    compute = _spread(", compute", control["compute_us"], ("p50", "p99", "max"), "us")
    missed = Text(f"{control['missed']} missed", style=BAD if control["missed"] else GOOD)
    table.add_row("control ticks", Text(f"{control['ticks']}, ") + missed + late + compute)
    bus = metrics["bus"]
    table.add_row("bus", Text(f"{bus['lost']} lost, {bus['rejected']} rejected"))
    if metrics["replay_equal"] is not None:
        equal = metrics["replay_equal"]
        word = "bit-identical" if equal else "DIFFERENT (downbeat replay RUN --verify)"
        table.add_row("control, re-executed", Text(word, style=GOOD if equal else BAD))
    table.add_row("plant, share of real time", _value(metrics["plant_realtime_factor"], "{:.3f}"))
    return table


def _checked(checks: dict[str, Any]) -> str:
    """Return what came of the plans that the checker was asked about; the timeline shows each."""
    parts = [f"{checks['simulated']} of {checks['asked']} plans simulated"]
    parts += [f"{checks['no_time']} without time"] if checks["no_time"] else []
    parts += [f"{checks['unanswered']} unanswered"] if checks["unanswered"] else []
    told = ", ".join([*parts, f"{checks['refused']} refused"])
    told += f"; {checks['rollouts_fallen']} of {checks['rollouts']} rollouts fell"
    if checks["latency_ms"] is not None:
        told += f"; {checks['latency_ms']:.0f} ms each"
    return told


def _zero(*counts: int) -> Text:
    return Text(", ").join(Text(str(n), style=BAD if n else GOOD) for n in counts)


def _followed(group: dict[str, Any]) -> Text:
    all_followed = group["followed"] == group["total"]
    style = GOOD if all_followed else BAD
    return Text(f"{group['followed']} of {group['total']} followed", style=style)


def _spread(name: str, values: dict[str, float | None], points: tuple[str, ...], unit: str) -> Text:
    """Return e.g. ", reaction p50 1.2 p95 2 max 2 s", or nothing when nothing was measured."""
    if values["max"] is None:
        return Text("" if name else "-", style=UNKNOWN)
    numbers = " ".join(f"{point} {values[point]:g}" for point in points)
    return Text(f"{name} {numbers} {unit}".lstrip())


def _verdict(metrics: dict[str, Any]) -> Text:
    rows = metrics["sections"]
    followed = sum(row["followed"] for row in rows)
    text = f"{followed} of {len(rows)} sections followed, {metrics['falls']} falls"
    return Text(text, style="bold green" if is_good(metrics) else BAD)
