"""What was learned of how people ask (`intent_model`), held against the form of the sentence.

The model judges the whole utterance; the rules' form says how sure it has to be, and what is only
forbidden is never begun, whatever it says.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from downbeat.perception.features import F32
from downbeat.perception.grounding_numbers import Parameters
from downbeat.perception.grounding_rules import Clause, Form, plain
from downbeat.perception.intent import Intent, IntentKind
from downbeat.perception.intent_model import (
    AGAIN,
    CHAT,
    FASTER,
    FORMS,
    NOT,
    RESUME,
    SLOWER,
    STOP,
)

KINDS = {
    STOP: IntentKind.STOP,
    AGAIN: IntentKind.AGAIN,
    FASTER: IntentKind.TEMPO,
    SLOWER: IntentKind.TEMPO,
    RESUME: IntentKind.RESUME,
}
TEMPO = {FASTER: 1, SLOWER: -1}


class Judge(Protocol):
    """An intent model."""

    classes: tuple[str, ...]

    def judge(self, texts: Sequence[str]) -> F32:
        """Return (n, classes) probabilities."""
        ...


@dataclass(frozen=True)
class Sureness:
    """Least probability that something is commanded at all, by the form of what was said.

    Found on the training sentences, each judged by a model that had not learned it: of 2,300 that
    ask for nothing 1 to 5 % pass, by form, and most of what does not is told from them by its form.

    Attributes:
        request: Asked for in so many words.
        bare: May be a command.
        other: By its form a question or a statement.
        mended: A name is read as another that it sounds like.
        which: Of what is wanted, among all that could be: two dances may be meant alike.
        clear: Of the same; below it a name may have been misheard.
    """

    request: float = 0.65
    bare: float = 0.8
    other: float = 0.87
    mended: float = 0.8
    which: float = 0.3
    clear: float = 0.6

    def of(self, found: Sequence[Clause]) -> float:
        """Return what the likeliest form of the clauses asks for."""
        forms = {clause.form for clause in found}
        if Form.REQUEST in forms:
            return self.request
        return self.bare if Form.BARE in forms else self.other


@dataclass(frozen=True)
class Judgement:
    """What the model says of a text.

    Attributes:
        wanted: Likeliest class that is a command.
        commanded: Probability that anything is commanded.
        likely: Probability of `wanted`; of a tempo, of both directions.
        margin: Distance to the second command.
    """

    wanted: str
    commanded: float
    likely: float
    margin: float


class Learned:
    """The intent model as part of the grounding."""

    def __init__(
        self,
        model: Judge,
        skills: Collection[str],
        mend: Callable[[Clause], str],
        sureness: Sureness | None = None,
    ) -> None:
        """Use a model.

        Args:
            model: The model.
            skills: What may be asked for; what the model says of others is talk.
            mend: Returns what was probably said in a clause that names no skill.
            sureness: Thresholds; None: those found on sentences that the model had not learned.
        """
        self._model, self._mend = model, mend
        self._known = [name in FORMS or name in skills for name in model.classes]
        self._limits = sureness or Sureness()

    def intent(self, text: str, found: Sequence[Clause], numbers: Parameters) -> Intent:
        """Return what is wanted.

        Args:
            text: The utterance.
            found: Its clauses.
            numbers: What it says in numbers.
        """
        least = self._limits.of(found)
        best = self._judged(text)
        if best.commanded < least or best.likely < self._limits.clear:
            sounding = self._sounding(text, found, max(least, self._limits.mended))
            if sounding is not None and sounding.likely > best.likely:
                best = sounding
        if best.commanded < least or best.likely < self._limits.which:
            return Intent(IntentKind.CHAT)
        kind = KINDS.get(best.wanted, IntentKind.SKILL)
        if kind is IntentKind.TEMPO:
            numbers = replace(numbers, tempo=TEMPO[best.wanted])
        elif kind is not IntentKind.STOP and all(one.form is Form.NEGATED for one in found):
            return Intent(IntentKind.CHAT)
        elif kind is IntentKind.AGAIN:
            numbers = replace(numbers, again=True)
        skill = best.wanted if kind is IntentKind.SKILL else ""
        return Intent(kind, skill, best.commanded, best.margin, numbers)

    def named(self, text: str) -> str:
        """Return the skill that a text names, such as the object of "don't"; empty: none."""
        found = self._judged(text)
        is_named = found.wanted not in FORMS and found.commanded >= self._limits.request
        return found.wanted if is_named and found.likely >= self._limits.which else ""

    def _sounding(self, text: str, found: Sequence[Clause], least: float) -> Judgement | None:
        """Judge the text with the names in it that were probably said; None: nothing is gained."""
        mended = plain(text)
        for clause in found:
            if clause.form in (Form.REQUEST, Form.BARE):
                mended = mended.replace(clause.text, self._mend(clause))
        if mended == plain(text):
            return None
        again = self._judged(mended)
        return again if again.wanted not in FORMS and again.commanded >= least else None

    def _judged(self, text: str) -> Judgement:
        """Add up what is one: what is unknown is talk, faster and slower are a tempo."""
        commands: dict[str, float] = {}
        rest = 0.0
        row = self._model.judge([text])[0]
        for name, known, value in zip(self._model.classes, self._known, row, strict=True):
            if not known or name in (CHAT, NOT):
                rest += float(value)
            else:
                commands[name] = float(value)
        wanted = max(commands, key=lambda name: commands[name])
        if wanted in TEMPO:
            both = sum(commands.pop(name, 0.0) for name in TEMPO)
            commands[wanted] = both
        first, second = sorted((0.0, 0.0, *commands.values()))[:-3:-1]
        return Judgement(wanted, min(max(1.0 - rest, 0.0), 1.0), min(first, 1.0), first - second)
