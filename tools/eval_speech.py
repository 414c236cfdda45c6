"""`downbeat eval speech`: what the grounding makes of written utterances."""

from __future__ import annotations

import csv
import json
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from downbeat.perception.errors import PerceptionError
from downbeat.perception.grounding import NOT_BY_VOICE, STAND, Grounder, Intent, IntentKind
from downbeat.perception.intent_model import IntentModel
from downbeat.policies.manifest import load_skills
from downbeat.runtime.errors import one_of
from downbeat.tools.errors import ToolError

BUNDLED_UTTERANCES = Path(__file__).with_name("utterances.tsv")
COLUMNS = ("half", "kind", "expected", "text")
KINDS = (
    "request", "parameter", "garbled", "again", "tempo", "resume", "stop", "negation", "chat",
)  # fmt: skip
CHAT, FORBIDDEN, STOP = "chat", "-", IntentKind.STOP.value
NO_SKILLS = (STOP, "again", "tempo", "resume", CHAT, FORBIDDEN)
"""What may be expected besides a skill."""


@dataclass(frozen=True)
class Utterance:
    """One row of the set.

    Attributes:
        half: "tune" or "test".
        kind: One of KINDS, for who reads the set; what counts is what is expected.
        expected: A skill, "stop", "again", "tempo", "resume", "chat", or "-": anything but a skill.
            "stand" and "stop" are one: both make the robot stand, and the grounding says "stop".
        text: As spoken.
    """

    half: str
    kind: str
    expected: str
    text: str


@dataclass(frozen=True)
class SpeechScore:
    """The contract of `--json`.

    Attributes:
        n: Utterances.
        top1: Share of commands (all but chat and negations) understood rightly.
        false_triggers: Share of chat that made the robot do something.
        negation_errors: Forbidden things that were done.
        commands, chats, negations: How many of each.
        p50_ms, p95_ms: Time per utterance on one core [ms].
        backend: "learned" or "letters".
        wrong: What went wrong: [expected, found, text].
    """

    n: int
    top1: float
    false_triggers: float
    negation_errors: int
    commands: int
    chats: int
    negations: int
    p50_ms: float
    p95_ms: float
    backend: str
    wrong: list[list[str]]


def load_utterances(path: Path) -> list[Utterance]:
    """Read a tab-separated set.

    Raises:
        ToolError: File and line of what is wrong.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file, delimiter="\t", quoting=csv.QUOTE_NONE))
    except (OSError, UnicodeDecodeError) as error:
        raise ToolError(
            f"Utterances {path} cannot be read; --utterances names a file of {', '.join(COLUMNS)}, "
            "separated by tabs, and without it the bundled set is taken."
        ) from error
    if not rows:
        raise ToolError(f"{path} holds no utterance.")
    skills = sorted(set(load_skills()) - NOT_BY_VOICE)
    valid = {"kind": KINDS, "expected": (*NO_SKILLS, *skills)}
    for number, row in enumerate(rows, 2):
        if set(row) != set(COLUMNS) or not all(isinstance(value, str) for value in row.values()):
            raise ToolError(f"{path}:{number} is not {', '.join(COLUMNS)}, separated by tabs.")
        for name, words in valid.items():
            if row[name] not in words:
                raise ToolError(
                    f"{path}:{number} has the {name} '{row[name]}'; valid are {one_of(words)}."
                )
    return [Utterance(**{name: row[name] for name in COLUMNS}) for row in rows]


def outcome(intent: Intent) -> str:
    """Return an intent in the set's words."""
    if intent.kind is IntentKind.SKILL:
        return intent.skill
    return CHAT if intent.kind is IntentKind.NONE else intent.kind.value


def score(grounder: Grounder, utterances: Iterable[Utterance], backend: str) -> SpeechScore:
    """Ground every utterance."""
    wrong: list[list[str]] = []
    right = commands = chats = negations = triggers = broken = 0
    times = []
    for one in utterances:
        start = time.perf_counter()
        intent = grounder.ground(one.text)
        times.append((time.perf_counter() - start) * 1e3)
        found = outcome(intent)
        if one.expected == FORBIDDEN:
            negations += 1
            is_good = intent.kind not in (IntentKind.SKILL, IntentKind.AGAIN)
            broken += not is_good
        elif one.expected == CHAT:
            chats += 1
            is_good = found == CHAT
            triggers += not is_good
        else:
            commands += 1
            is_good = found == (STOP if one.expected == STAND else one.expected)
            right += is_good
        if not is_good:
            wrong.append([one.expected, found, one.text])
    p50, p95 = np.percentile(times, [50, 95])
    return SpeechScore(
        n=len(times),
        top1=round(right / max(1, commands), 4),
        false_triggers=round(triggers / max(1, chats), 4),
        negation_errors=broken,
        commands=commands,
        chats=chats,
        negations=negations,
        p50_ms=round(float(p50), 2),
        p95_ms=round(float(p95), 2),
        backend=backend,
        wrong=wrong,
    )


def open_grounder(letters_only: bool) -> tuple[Grounder, str]:
    """Return a grounder over the bundled skills, and which backend it has."""
    skills = load_skills()
    if not letters_only:
        try:
            intents = IntentModel()
            return Grounder(skills, intents, intents=intents), "learned"
        except PerceptionError as error:
            Console(stderr=True).print(f"{error} Letters only, for now.")
    return Grounder(skills, None), "letters"


def eval_speech(path: Path | None, half: str, letters_only: bool, as_json: bool) -> int:
    """Score a set and print; 0 if the targets are reached, else 1.

    Args:
        path: The set; None: the bundled one.
        half: "tune", "test" or "all".
        letters_only: Without the sentence model.
        as_json: Print one JSON object.

    Raises:
        ToolError: The set cannot be read, or has no such half.
    """
    path = path or BUNDLED_UTTERANCES
    chosen = [one for one in load_utterances(path) if half in ("all", one.half)]
    if not chosen:
        raise ToolError(f"{path} has no half {half!r}; valid are tune, test and all.")
    grounder, backend = open_grounder(letters_only)
    result = score(grounder, chosen, backend)
    is_good = result.top1 >= 0.9 and result.false_triggers <= 0.03 and not result.negation_errors
    if as_json:
        print(json.dumps(asdict(result)))
    else:
        _print(result)
    return 0 if is_good else 1


def _print(result: SpeechScore) -> None:
    table = Table("what", "found", "of", "target")
    table.add_row("commands understood", f"{result.top1:.1%}", str(result.commands), ">= 90 %")
    table.add_row("false triggers", f"{result.false_triggers:.1%}", str(result.chats), "<= 3 %")
    table.add_row("forbidden, yet done", str(result.negation_errors), str(result.negations), "0")
    times = f"{result.p50_ms} / {result.p95_ms}"
    table.add_row("time p50 / p95 [ms]", times, str(result.n), "")
    console = Console()
    console.print(table)
    for expected, found, text in result.wrong:
        console.print(f"  expected {expected}, found {found}: {text}", highlight=False)
