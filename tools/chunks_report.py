"""What the chunk study found: the contract of `--json`, and tables for people."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from downbeat.tools.chunks_paper import PAPER_ACCURACY, PaperScore
from downbeat.tools.chunks_score import ConditionScore, FalseAccepts
from downbeat.tools.chunks_stream import Cost, LockCount, StreamScore
from downbeat.tools.console import some

SHORT_S = 3.0
SHORT = f", {SHORT_S:g} s"
"""The same query, its first part only."""
MUSIC, KIN, RECOMBINED, NO_MUSIC, SILENT = (
    "music not in the catalogue",
    "by the composer of a catalogue track",
    "such music shuffled or backwards",
    "speech, animals, tones, noise",
    "silence",
)
"""Classes of what must be refused; KIN is a part of MUSIC, and a class of its own."""
LABELS = {
    MUSIC: "unknown music",
    KIN: "unknown music of kin",
    RECOMBINED: "shuffled, backwards",
    NO_MUSIC: "no music",
    SILENT: "silence",
}
"""Their names in a table of 80 columns."""
REFUSED_HOW = (
    f"unknown music: {MUSIC}. of kin: {KIN}, or of its sound bank. shuffled, backwards: "
    f"{RECOMBINED}. no music: {NO_MUSIC}. kin: of the accepted, taken for a piece of the same "
    "composer or sound bank. copies (the same recording elsewhere): accepted too, and not counted "
    "as wrong, as the track that it was taken for holds the identical recording there (as for "
    "'repeat')."
)
NONE = "-"
MOST_MISSED, MOST_WRONG = 4, 5
HOW = (
    "track: best track right, accepted or not. and place: right within 0.1 s, or at a repeat. "
    "accepted: that, and accepted. wrong: accepted, another track or place. repeat: part of "
    "'and place', where the reference is the identical recording (normalised cross-correlation 0.8 "
    "or more over 4 s, lag 60 ms at most) at another time. "
    f"{SHORT_S:g} s: 'accepted' by its first part alone."
)


@dataclass
class ChunkReport:
    """Everything that was measured; `has_groups`: whether kin can be told from others."""

    has_groups: bool = False
    conditions: dict[str, ConditionScore] = field(default_factory=dict)
    refused: dict[str, FalseAccepts] = field(default_factory=dict)
    query_ms: list[float] = field(default_factory=list)
    catalogue: int = 0
    minutes: float = 0.0
    index_s: float = 0.0
    index_bytes: int = 0
    paper: dict[str, PaperScore] = field(default_factory=dict)
    paper_shifts: int = 0
    streams: dict[str, StreamScore] = field(default_factory=dict)
    false_locks: dict[str, LockCount] = field(default_factory=dict)
    cost: Cost = field(default_factory=Cost)

    def as_json(self) -> dict[str, Any]:
        """Return the contract of `--json`; shares are 0..1."""
        clean = self.conditions.get("clean", ConditionScore())
        total, correct = clean.n, clean.accepted
        if paper := self.paper.get("clean"):
            total, correct = paper.total, paper.correct
        return {
            "chunks": {"total": total, "correct": correct},
            "conditions": {name: score.shares() for name, score in self.conditions.items()},
            "false_accepts": self._shares(self.all_refused("")),
            "false_accepts_short": self._shares(self.all_refused(SHORT)),
            "false_accepts_by_class": {n: self._shares(p) for n, p in self.refused.items()},
            "query_ms": self._quantiles(),
            "paper": {name: score.shares() for name, score in self.paper.items()},
            "paper_shifts": self.paper_shifts,
            "listener": {name: score.shares() for name, score in self.streams.items()},
            "false_locks": {name: count.as_json() for name, count in self.false_locks.items()},
            "listener_share_of_a_core": round(self.cost.share, 4),
            "catalogue": {
                "tracks": self.catalogue,
                "minutes": round(self.minutes, 2),
                "index_s": round(self.index_s, 2),
                "times_real_time": round(self.minutes * 60.0 / max(self.index_s, 1e-9)),
                "kib_per_minute": round(self.index_bytes / 1024.0 / max(self.minutes, 1e-9), 1),
            },
        }

    def _shares(self, part: FalseAccepts) -> dict[str, Any]:
        """Return shares; without groups nobody knows what is kin."""
        unknown = {} if self.has_groups else {"taken_for_kin": None, "rate_without_kin": None}
        return {**part.shares(), **unknown}

    def all_refused(self, suffix: str) -> FalseAccepts:
        """Return what must be refused of all classes, at one length of window."""
        counted = FalseAccepts()
        for name in (MUSIC, RECOMBINED, NO_MUSIC, SILENT):
            part = self.refused.get(name + suffix, FalseAccepts())
            counted.n += part.n
            counted.accepted += part.accepted
            counted.kin += part.kin
            counted.names += part.names
            counted.elsewhere += part.elsewhere
            counted.elsewhere_names += part.elsewhere_names
        return counted

    def _quantiles(self) -> dict[str, float | None]:
        """Return quantiles of the time of a query [ms]; None where nothing was asked."""
        times = self.query_ms
        return {
            f"p{q}": round(float(np.percentile(times, q)), 2) if times else None for q in (50, 99)
        }


def print_report(report: ChunkReport) -> None:
    """Print tables, and examples of what went wrong."""
    console = Console()
    contract = report.as_json()
    _print_paper(console, report)
    if report.conditions:
        _print_windows(console, report)
    if report.refused:
        _print_refused(console, report)
    _print_streams(console, report)
    errors = [e for score in report.conditions.values() for e in score.error_ms]
    place = [float(np.percentile(errors, q)) if errors else None for q in (50, 99)]
    catalogue, query = contract["catalogue"], contract["query_ms"]
    console.print(
        f"{catalogue['tracks']} tracks, {catalogue['minutes']:g} min, index "
        f"{catalogue['times_real_time']} x real time, {catalogue['kib_per_minute']:g} KiB/min; "
        f"query p50 {_figure(query['p50'], ' ms')}, p99 {_figure(query['p99'], ' ms')}; "
        f"place p50 {_figure(place[0], ' ms', '.1f')}, p99 {_figure(place[1], ' ms', '.1f')}",
        highlight=False,
    )
    for name, score in report.conditions.items():
        if score.twins:
            said = f"{score.twins} of {score.n} windows name two tracks that share the passage"
            console.print(f"{name}: {said}, and are not accepted", highlight=False)
        if score.missed and not name.endswith(SHORT):
            missed = f"missed, {name}: {some(score.missed, MOST_MISSED)}"
            console.print(missed, highlight=False, soft_wrap=True)
    for name, part in report.refused.items():
        for what, names in (("accepted", part.names), ("copies", part.elsewhere_names)):
            if names:
                said = f"{what}, {name}: {some(names, MOST_WRONG)}"
                console.print(said, highlight=False, soft_wrap=True)


def _figure(value: float | None, unit: str, form: str = "g") -> str:
    return NONE if value is None else f"{value:{form}}{unit}"


def _table(*columns: str, **options: Any) -> Table:
    """Return a table whose rows fit into 80 columns."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, **options)
    for number, title in enumerate(columns):
        table.add_column(title, no_wrap=True, justify="right" if number else "left")
    return table


def _print_windows(console: Console, report: ChunkReport) -> None:
    table = _table(
        "condition", "n", "track", "and place", "accepted", "wrong", "repeat", f"{SHORT_S:g} s",
        title="[%] of the windows that hold sound",
        caption=HOW,
    )  # fmt: skip
    for name, score in report.conditions.items():
        if name.endswith(SHORT):
            continue
        cells = score.shares()
        shares = [f"{100.0 * cells[key]:.1f}" for key in ("top1", "right", "accepted", "wrong")]
        short = report.conditions[name + SHORT].shares()["accepted"]
        repeats = f"{100.0 * cells['elsewhere']:.1f}"
        table.add_row(name, str(score.n), *shares, repeats, f"{100.0 * short:.1f}")
    console.print(table)


def _print_refused(console: Console, report: ChunkReport) -> None:
    kin = "" if report.has_groups else " Who is kin is only known with --groups."
    table = _table(
        "must be refused", "n", "accepted", "%", "upper 95 %", "kin", "copies",
        caption=REFUSED_HOW + kin,
    )  # fmt: skip
    rows = {LABELS[name.removesuffix(SHORT)] + (SHORT if name.endswith(SHORT) else ""): part
            for name, part in report.refused.items()}  # fmt: skip
    totals = {f"all{suffix}": report.all_refused(suffix) for suffix in ("", SHORT)}
    for name, part in {**rows, **totals}.items():
        if part.n == 0:
            table.add_row(name, "0", *[NONE] * 5)
            continue
        rate, bound = f"{100.0 * part.accepted / part.n:.2f}", f"{100.0 * part.upper95:.2f}"
        known = str(part.kin) if report.has_groups else NONE
        table.add_row(
            name, str(part.n), str(part.accepted), rate, bound, known, str(part.elsewhere)
        )
    console.print(table)


def _print_paper(console: Console, report: ChunkReport) -> None:
    """Print the paper's figure, and apart from it what is not in its total."""
    for name, score in report.paper.items():
        shares = score.shares()
        console.print(
            f"{name}, {report.paper_shifts} shifts: policy right in {score.correct} of "
            f"{score.total} chunks inside one section "
            f"({100.0 * score.correct / max(score.total, 1):.1f} %; the "
            f"paper has {100.0 * PAPER_ACCURACY:.1f} %). Not among these: {score.straddling} over "
            f"a boundary ({100.0 * float(shares['straddling_by_start']):.1f} % right by their "
            f"start, {100.0 * float(shares['straddling_by_end']):.1f} % by their end), "
            f"{score.repeats} at a verbatim repeat with another policy, {len(score.silent)} silent",
            highlight=False,
            soft_wrap=True,
        )
        for what, chunks in (("wrong", score.wrong), ("silent", score.silent)):
            if chunks:
                text = f"{what}, {name}: {some(chunks, MOST_WRONG)}"
                more = " (--json has all)" if len(chunks) > MOST_WRONG else ""
                console.print(text + more, highlight=False, soft_wrap=True)


def _print_streams(console: Console, report: ChunkReport) -> None:
    for name, score in report.streams.items():
        shares = score.shares()
        lock = shares["first_lock_s"]
        console.print(
            f"listener, {name}, clips of 10 s: right at the end {100.0 * shares['right']:.1f} % of "
            f"{score.n} ({100.0 * shares['held']:.1f} % with those in doubt just then), "
            f"wrong {100.0 * shares['wrong']:.1f} %; {score.ended} more end in silence; "
            f"first lock p50 {_figure(lock['p50'], ' s')}, "
            f"p95 {_figure(lock['p95'], ' s')}",
            highlight=False,
            soft_wrap=True,
        )
    if report.cost.heard_s:
        console.print(f"listener: {100.0 * report.cost.share:.1f} % of a core", highlight=False)
    for name, count in report.false_locks.items():
        line = f"false locks in {count.seconds / 60.0:g} min of {name}: {len(count.locks)}"
        line += f"; {some(count.locks, MOST_WRONG)}" if count.locks else ""
        if count.elsewhere:
            line += f"; on the identical recording under another name: {len(count.elsewhere)}"
        console.print(line, highlight=False, soft_wrap=True)
