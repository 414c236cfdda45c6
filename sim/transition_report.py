"""The table of a transition survey, as Markdown."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

TITLES = {
    "planted": "planted -> planted, any phases, 0.6 s",
    "planted_short": "planted -> planted, any phases, 0.3 s",
    "entry": "stand -> footwork at its phase 0, 0.3 s",
    "direct": "planted dance -> footwork at its phase 0, 0.3 s",
    "exit": "footwork -> stand at an exit phase, 0.3 s",
    "exit_planted": "footwork -> planted dance at an exit phase, 0.6 s",
    "via_stand": "footwork -> 0.3 s -> stand for 0.3 s -> 0.3 s -> footwork",
    "loop": "footwork -> footwork at the loop boundary, legs at once, upper body 0.3 s",
    "walk_start": "stand -> walk at its phase 0, 0.2 s",
    "walk_stop": "walk on the spot -> stand at its phase 0, 0.2 s",
}


@dataclass(frozen=True, slots=True)
class Trial:
    """One change of skill: kind (a key of TITLES), skills, exit phase, seed."""

    kind: str
    source: str
    target: str
    seed: int
    exit_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """A trial and whether it fell; `early` marks falls before the change."""

    trial: Trial
    fell: bool
    early: bool


def _share(outcomes: Iterable[Outcome]) -> str:
    counted = [outcome for outcome in outcomes if not outcome.early]
    return f"{sum(outcome.fell for outcome in counted)}/{len(counted)}"


def _table(outcomes: Sequence[Outcome], kind: str, by: str) -> list[str]:
    mine = [outcome for outcome in outcomes if outcome.trial.kind == kind]
    groups: dict[tuple[str, float], list[Outcome]] = {}
    for outcome in mine:
        phase = outcome.trial.exit_s if by == "source" and kind == "exit" else 0.0
        groups.setdefault((getattr(outcome.trial, by), phase), []).append(outcome)
    rows = [f"### {TITLES[kind]}", ""]
    head = (
        "| skill | exit phase s | falls/trials |" if kind == "exit" else "| skill | falls/trials |"
    )
    rows += [head, "|" + "---|" * (head.count("|") - 1)]
    for (name, phase), group in sorted(groups.items()):
        middle = f" {phase:g} |" if kind == "exit" else ""
        rows.append(f"| {name} |{middle} {_share(group)} |")
    return [*rows, ""]


def report(outcomes: Sequence[Outcome], count: int) -> str:
    """Return the measured table as Markdown."""
    lines = [
        "# Transitions, measured",
        "",
        "Simulation only. Made by",
        f"`python -m downbeat.sim.transition_survey --count {count}"
        " --out docs/transitions_measured.md --write`.",
        "",
        "Each trial: hardware-like noise; the model drawn from nominal, mass +5 % / friction .57,",
        "mass -5 % / friction .63 (5 ms physics) and nominal at 2 ms; the tempo drawn from 100 to",
        "140 BPM; free phases drawn; on the feet 4 s after the change. Numbers are falls/trials.",
        "",
        "| change | falls/trials |",
        "|---|---|",
    ]
    for kind, title in TITLES.items():
        lines.append(f"| {title} | {_share(o for o in outcomes if o.trial.kind == kind)} |")
    early = sum(outcome.early for outcome in outcomes)
    lines += ["", f"Not counted: {early} trials that fell before the change.", ""]
    lines += _worst_pairs(outcomes)
    for kind, by in (("entry", "target"), ("direct", "target"), ("exit", "source")):
        lines += _table(outcomes, kind, by)
    for kind in ("exit_planted", "loop", "via_stand"):
        lines += _table(outcomes, kind, "source")
    return "\n".join(lines)


def _worst_pairs(outcomes: Sequence[Outcome]) -> list[str]:
    """List the pairs with falls among those control uses."""
    used = ("planted", "entry", "exit", "loop", "via_stand", "walk_start", "walk_stop")
    falls = Counter(
        (o.trial.kind, o.trial.source, o.trial.target)
        for o in outcomes
        if o.fell and not o.early and o.trial.kind in used
    )
    if not falls:
        return ["No pair fell in a change that control uses.", ""]
    lines = ["Pairs with falls among the changes that control uses:", ""]
    for (kind, source, target), number in sorted(falls.items()):
        lines.append(f"- {TITLES[kind]}: {source} -> {target}: {number}")
    return [*lines, ""]
