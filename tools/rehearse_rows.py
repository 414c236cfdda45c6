"""What a rehearsal found, change by change, and the list of it for people."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from rich.console import Console
from rich.table import Table

GREEN, AMBER, RED = "direct", "via_stand", "red"


@dataclass(frozen=True)
class Row:
    """One change of a show.

    Attributes:
        show_s: When [s]; None for a change that may come at any time.
        source: Skill before.
        target: Skill after.
        state: "direct": proven straight away; "via_stand": proven through stand; "red": neither.
        plan: What control would do.
        bound: 95 % upper bound of the atlas on the share that falls.
        rollouts: Simulated, now and from this very phase; for a change at any time, by the sweep.
        fallen: Of these.
        advice: Why not, and the nearest proven alternative.
        asked_by: "music" or "speech".
        wait_s: At most, until there is a proven slot [s].
    """

    show_s: float | None
    source: str
    target: str
    state: str
    plan: str
    bound: float
    rollouts: int
    fallen: int
    advice: str = ""
    asked_by: str = "music"
    wait_s: float = 0.0


MARKS = {GREEN: "[green]✔[/]", AMBER: "[yellow]via stand[/]", RED: "[bold red]✘[/]"}
TITLES = {AMBER: "through stand", RED: "not proven"}
WORST_FIRST = (RED, AMBER, GREEN)
SHORTEST_WAIT_S = 0.05
"""Nobody notices less."""


def waits(wait_s: float) -> str:
    """Return the remark on a wait, or nothing when it is too short to notice."""
    return f"waits at most {wait_s:.2f} s for a proven slot" if wait_s >= SHORTEST_WAIT_S else ""


def print_rows(rows: Sequence[Row]) -> None:
    """Print the list for people; what speech may ask for is one line per skill."""
    table = Table(box=None, pad_edge=False)
    for title in ("at", "from", "to", "plan", "falls, at most", "simulated", "", "remark"):
        table.add_column(title)
    for row in rows:
        if row.asked_by == "music":
            now = f"{row.fallen} of {row.rollouts} fell" if row.rollouts else ""
            cells = (_at(row), row.source, row.target, row.plan, _bound(row.bound), now)
            table.add_row(*cells, MARKS[row.state], row.advice)
    spoken = [row for row in rows if row.asked_by == "speech"]
    for target in dict.fromkeys(row.target for row in spoken):
        table.add_row(*_from_everywhere([row for row in spoken if row.target == target]))
    console = Console(width=None if Console().is_terminal else 150)
    console.print(table)
    counts = {state: sum(row.state == state for row in rows) for state in MARKS}
    by_speech = f", {len(spoken)} of them by speech" if spoken else ""
    console.print(
        f"{counts[GREEN]} direct, {counts[AMBER]} through stand, {counts[RED]} not proven "
        f"of {len(rows)} changes{by_speech}"
    )
    for line in indirect(rows):
        console.print(line, soft_wrap=True, highlight=False)


def indirect(rows: Iterable[Row]) -> list[str]:
    """Return which changes that may come at any time are not direct, a line per reason.

    Among hundreds of rows nobody finds them; those of a set list stand in the show's order, and
    those by speech are a line per skill already.
    """
    groups: dict[tuple[str, str], dict[str, list[str]]] = {}
    for row in rows:
        if row.show_s is None and row.asked_by == "music" and row.state != GREEN:
            groups.setdefault((row.state, row.advice), {}).setdefault(row.source, []).append(
                row.target
            )
    lines = []
    for state, why in sorted(groups, key=lambda group: WORST_FIRST.index(group[0])):
        pairs = groups[state, why]
        said = "; ".join(f"{source} to {', '.join(targets)}" for source, targets in pairs.items())
        lines.append(f"{TITLES[state]} ({why}): {said}")
    return lines


def _at(row: Row) -> str:
    if row.show_s is None:
        return "any time"
    return f"{int(row.show_s // 60)}:{row.show_s % 60:04.1f}"


def _bound(bound: float) -> str:
    return f"{bound:.1%}" if bound < 1.0 else "?"


def _sources(rows: Iterable[Row]) -> str:
    return ", ".join(row.source for row in rows)


def _from_everywhere(rows: Sequence[Row]) -> tuple[str, ...]:
    """Return the cells of one skill that speech may ask for, whatever dances then."""
    state = next(s for s in WORST_FIRST if any(row.state == s for row in rows))
    by_state = {s: [row for row in rows if row.state == s] for s in WORST_FIRST}
    remarks = [
        f"not from {_sources(row for row in by_state[RED] if row.advice == why)}: {why}"
        for why in dict.fromkeys(row.advice for row in by_state[RED])
    ]
    if by_state[AMBER]:
        remarks.append(f"via stand from {_sources(by_state[AMBER])}")
    longest = waits(max(row.wait_s for row in rows))
    remarks += [longest] if longest else []
    source = rows[0].source if len(rows) == 1 else f"any of {len(rows)}"
    return (
        "by speech",
        source,
        rows[0].target,
        f"direct from {len(by_state[GREEN])} of {len(rows)}",
        _bound(max(row.bound for row in rows)),
        "",
        MARKS[state],
        "; ".join(remarks),
    )
