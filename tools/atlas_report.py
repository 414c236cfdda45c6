"""What an atlas knows, in words and tables: overview, one source, one pair, one row per pair."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from rich.table import Table

from downbeat.control.atlas import Atlas, Cell
from downbeat.control.modes import BY_NAME
from downbeat.control.slots import (
    PARTS_PER_BEAT,
    Slots,
    enters_at_zero,
    entry_slots,
    exit_slots,
)
from downbeat.policies.manifest import SkillManifest
from downbeat.runtime.errors import one_of
from downbeat.tools.errors import ToolError

PROVEN = 0.01
"""Upper bound on the share that falls that counts as proven, as control takes it by default."""
Names = tuple[str, str]
KIND_ORDER = ("planted", "stepping", "locomotion", "tracking")


@dataclass(frozen=True)
class PairSummary:
    """What an atlas knows about an ordered pair.

    Attributes:
        source: Skill that is left.
        target: Skill that is entered.
        mode: Best direct mode: the one proven at most exits, then the one with the lower bound;
            of an unproven pair the one with the lowest bound; empty: never simulated.
        bound: 95 % upper bound on the share that falls in that mode, where it is lowest.
        covered: Share of the exit slots at which some mode is proven, 0..1.
        rollouts: Behind the bounds of all modes.
        fallen: Of these.
        route: "direct", "via stand" (both halves are proven), "unproven", or "untried".
    """

    source: str
    target: str
    mode: str
    bound: float
    covered: float
    rollouts: int
    fallen: int
    route: str

    @property
    def needs_stand(self) -> bool:
        """Whether nothing direct is proven."""
        return self.covered == 0.0


def summaries(atlas: Atlas, names: Sequence[str], target: float = PROVEN) -> list[PairSummary]:
    """Return every ordered pair of some skills.

    Args:
        atlas: What is known.
        names: Skills, in the order wanted.
        target: Bound that counts as proven.
    """
    by_pair: dict[tuple[str, str], list[Cell]] = {}
    for cell in atlas.cells.values():
        by_pair.setdefault((cell.source, cell.target), []).append(cell)
    proven = {
        pair for pair, cells in by_pair.items() if any(c.bound.min() <= target for c in cells)
    }
    return [
        _summary(a, b, by_pair.get((a, b), []), target, _route(a, b, proven, by_pair))
        for a in names
        for b in names
        if a != b
    ]


def _route(a: str, b: str, proven: Container[Names], tried: Container[Names]) -> str:
    if (a, b) in proven:
        return "direct"
    if "stand" not in (a, b) and (a, "stand") in proven and ("stand", b) in proven:
        return "via stand"
    return "unproven" if (a, b) in tried else "untried"


def _summary(a: str, b: str, cells: Sequence[Cell], target: float, route: str) -> PairSummary:
    if not cells:
        return PairSummary(a, b, "", 1.0, 0.0, 0, 0, route)
    exits = np.array([(cell.bound <= target).any(axis=1) for cell in cells])  # (modes, exits)
    lowest = [float(cell.bound.min()) for cell in cells]
    best = max(range(len(cells)), key=lambda i: (exits[i].sum(), -lowest[i]))
    return PairSummary(
        a,
        b,
        cells[best].mode,
        lowest[best],
        float(exits.any(axis=0).mean()),
        sum(cell.count for cell in cells),
        sum(cell.fallen for cell in cells),
        route,
    )


def by_kind(names: Sequence[str], skills: Mapping[str, SkillManifest]) -> list[str]:
    """Return names with stand first, then kind by kind, imported policies last."""

    def rank(name: str) -> tuple[bool, bool, int, str]:
        skill = skills[name]
        order = KIND_ORDER.index(skill.kind) if skill.kind in KIND_ORDER else len(KIND_ORDER)
        return (name != "stand", skill.policy is not None, order, name)

    return sorted(names, key=rank)


def known_names(atlas: Atlas, skills: Mapping[str, SkillManifest]) -> list[str]:
    """Return the skills that an atlas says something about, as `by_kind` orders them."""
    return by_kind([name for name in skills if any(name in pair for pair in atlas.pairs)], skills)


def check_name(name: str, names: Sequence[str]) -> str:
    """Return a skill's name.

    Raises:
        ToolError: The atlas knows nothing about it.
    """
    if name not in names:
        raise ToolError(f"The atlas knows nothing about '{name}'; it knows {one_of(names)}.")
    return name


# ---------------------------------------------------------------------- tables


def totals(rows: Sequence[PairSummary]) -> dict[str, Any]:
    """Return how many pairs go which way, and what that took."""
    routes = [row.route for row in rows]
    return {
        "pairs": len(rows),
        "direct": routes.count("direct"),
        "direct_anywhere": sum(row.covered == 1.0 for row in rows),
        "via_stand": routes.count("via stand"),
        "unproven": routes.count("unproven"),
        "untried": routes.count("untried"),
        "rollouts": sum(row.rollouts for row in rows),
        "fallen": sum(row.fallen for row in rows),
    }


def totals_line(rows: Sequence[PairSummary], target: float) -> str:
    """Return the totals as a sentence."""
    t = totals(rows)
    pairs = "1 ordered pair" if t["pairs"] == 1 else f"{t['pairs']} ordered pairs"
    untried = f", {t['untried']} not simulated yet" if t["untried"] else ""
    return (
        f"{pairs}: {t['direct']} proven direct ({t['direct_anywhere']} from "
        f"every exit), {t['via_stand']} via stand, {t['unproven']} unproven{untried}; proven: at "
        f"most {100 * target:g} % fall, with 95 % confidence; {t['rollouts']:,} rollouts"
    )


def pair_table(rows: Sequence[PairSummary]) -> Table:
    """Return one line per pair."""
    table = Table("from", "to", "best direct", "bound", "exits", "rollouts", "fell", "way")
    for row in rows:
        table.add_row(
            row.source,
            row.target,
            row.mode or "-",
            percent(row.bound),
            f"{100 * row.covered:.0f} %",
            str(row.rollouts or "-"),
            str(row.fallen),
            row.route,
        )
    return table


def overview_table(rows: Sequence[PairSummary], names: Sequence[str]) -> Table:
    """Return one line per source: how many targets are reached directly, and which are not."""
    table = Table("from", "direct", "from every exit", "via stand", "unproven", "untried")
    for name in names:
        mine = [row for row in rows if row.source == name]
        table.add_row(
            name,
            f"{sum(r.route == 'direct' for r in mine)} of {len(mine)}",
            str(sum(r.covered == 1.0 for r in mine)),
            *(_targets(mine, way) for way in ("via stand", "unproven", "untried")),
        )
    return table


def _targets(rows: Sequence[PairSummary], way: str) -> str:
    names = [row.target for row in rows if row.route == way]
    return "all" if rows and len(names) == len(rows) else ", ".join(names) or "-"


def slot_tables(atlas: Atlas, a: SkillManifest, b: SkillManifest) -> list[Table]:
    """Return a table per mode of a pair: bounds over exits and, where they differ, entries."""
    tables = []
    for mode in BY_NAME:
        cell = atlas.cells.get((a.name, b.name, mode))
        if cell is not None:
            table = _slot_table(cell, a, b)
            table.title = f"{a.name} to {b.name}, {mode}: {cell.fallen} of {cell.count} fell"
            tables.append(table)
    return tables


def _slot_table(cell: Cell, a: SkillManifest, b: SkillManifest) -> Table:
    exits, entries, bound = exit_slots(a), entry_slots(b), np.asarray(cell.bound)
    if (bound == bound[:, :1]).all() and a.kind == "stepping":
        quarters = bound[:, 0].reshape(-1, PARTS_PER_BEAT)
        table = Table(f"leave {a.name}", "on the beat", "1/4 after", "1/2 after", "3/4 after")
        for beat, values in enumerate(quarters):
            table.add_row(f"beat {beat + 1}", *(percent(value) for value in values))
        return table
    if (bound == bound[:, :1]).all():
        where = _place(b, entries, 0) if entries.count == 1 else "at any beat"
        heads, bound = [f"enter {b.name} {where}"], bound[:, :1]
    else:
        heads = [_place(b, entries, j) for j in range(entries.count)]
    table = Table(f"leave {a.name}", *heads)
    for i in range(exits.count):
        table.add_row(_place(a, exits, i), *(percent(value) for value in bound[i]))
    return table


def _place(skill: SkillManifest, slots: Slots, slot: int) -> str:
    """Return a slot in the words of a dancer."""
    if slots.width_s == 0.0:
        begins = skill.kind == "tracking" or not skill.loop or enters_at_zero(skill)
        return "at its beginning" if begins else "anywhere"
    phase = slots.phase_s(slot)
    if skill.bpm > 0:
        return f"beat {phase * skill.bpm / 60.0 + 1.0:g}"
    return f"{phase:g} s"


def percent(bound: float) -> str:
    """Return a bound in per cent; "-": nothing is known."""
    return "-" if bound >= 1.0 else f"{100 * float(bound):.2g} %"


def as_json(rows: Sequence[PairSummary], meta: Mapping[str, Any]) -> dict[str, Any]:
    """Return everything for `--json`."""
    pairs = [{**asdict(row), "needs_stand": row.needs_stand} for row in rows]
    return {"meta": dict(meta), "totals": totals(rows), "pairs": pairs}
