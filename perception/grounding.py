"""From a transcript to what is wanted: a skill, a stop, an answer, or nothing.

Stop words and the form of the sentence come first (`grounding_rules`), numbers next
(`grounding_numbers`). What is wanted is learned for the bundled skills (`intent_model`). Skills
that were not learned, and all where the model is missing, are found among requests, by meaning
where a sentence model is there, and by their letters always; what people talk about otherwise
(`grounding_talk`) competes with them, because no single threshold tells a paraphrase from talk.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from downbeat.perception.features import F32
from downbeat.perception.grounding_examples import EXAMPLES
from downbeat.perception.grounding_learned import Judge, Learned
from downbeat.perception.grounding_misheard import Misheard, phrase_likeness
from downbeat.perception.grounding_numbers import Parameters, parameters
from downbeat.perception.grounding_rules import Clause, Form, clauses, is_address, plain
from downbeat.perception.grounding_sounds import OTHER_NAMES, SoundsLike
from downbeat.perception.grounding_talk import TALK
from downbeat.perception.intent import NOT_BY_VOICE, Intent, IntentKind
from downbeat.policies.manifest_types import SkillManifest


class Embedder(Protocol):
    """A sentence model."""

    def embed(self, texts: Sequence[str]) -> F32:
        """Return (n, d) unit vectors."""
        ...

    def knows(self, word: str) -> bool:
        """Return whether a word, in small letters, has a meaning of its own."""
        ...


@dataclass(frozen=True)
class Thresholds:
    """When a request is near enough to a skill. Found on the tuning half of the evaluation set.

    Attributes:
        request: Least score of something asked for in so many words.
        bare: Of a clause that only may be a command.
        margin: Least distance to the second skill.
        talk: Least distance to small talk; negative: small talk may be so much closer.
        letters: Least likeness of letters where meaning does not help.
    """

    request: float = 0.45
    bare: float = 0.65
    margin: float = 0.003
    talk: float = 0.0
    letters: float = 0.82


STAND = "stand"
LETTERS_WEIGHT, LETTERS_FROM = 0.4, 0.7
"""Letters add to meaning what they are more alike than this: a misheard name has no meaning."""
NAMED = 0.06
"""A skill whose very name is said is so much closer, unless others share the name (salsa)."""
_MOVES = re.compile(
    r"\b(?:danc\w*|mov(?:e|ing)|go|run|walk\w*|turn|anything|do (?:that|it|this)|come)\b|^$"
)
_FILLER = re.compile(
    r"\b(?:please|the|a|an|your|some|us|me|show|do|perform|give|dance|for|let's|to|of|can|you|best"
    r"|now|moves?|move|like|start|doing|dancing|again)\b"
)
_RESUME = re.compile(
    r"^(?:please )?(?:dance|start dancing|you (?:may|can) dance|dance again|keep dancing|resume"
    r"|continue|carry on|go on|dance to the music|continue (?:dancing|the dance|the show)"
    r"|go on dancing|resume (?:dancing|the dance|the show)|back to the music)"
    r"(?: again| now| please)*$"
)
_BEFORE = re.compile(
    r"\b(?:it|that|this|thing|same|one|just|go|from|start|beginning|whole|at|with|bit|little|much"
    r"|lot|even|way|tempo|pace|speed|have|see|play|try|let's|be|last|dance|dances|one|up|down|what"
    r"|run|motion|sequence|skill|execute"
    r"|did|perform|performance|routine|everything|all|over|once|really|nice|great)\b"
)
_REFERS = re.compile(
    r"\b(?:their|his|her) (?:\w+ )?(?:dances?|moves?|style)|\blike (?:them|him|her|that|those)\b"
    r"|\bone of (?:them|those|theirs)\b"
)
"""What was named in the clause before is meant: "she loves BTS, dance like them"."""
_WORD = re.compile(r"[\w']+")


class Grounder:
    """Knows the skills that speech may ask for."""

    def __init__(
        self,
        skills: Mapping[str, SkillManifest],
        model: Embedder | None,
        thresholds: Thresholds | None = None,
        intents: Judge | None = None,
    ) -> None:
        """Embed what the skills are called and look like; 0.5 s.

        Args:
            skills: By name; `NOT_BY_VOICE` are left out.
            model: None: letters only, which understands the phrases themselves and little more.
            thresholds: None: those found on the tuning half.
            intents: What was learned of the bundled skills; None: nothing.
        """
        self._limits = thresholds or Thresholds()
        self._model = model
        texts: list[tuple[str, str]] = []
        self._phrases: list[tuple[str, str]] = []
        self._exact: dict[str, str] = {}
        for name, skill in sorted(skills.items()):
            if name in NOT_BY_VOICE:
                continue
            said = [name.replace("_", " "), skill.title, *skill.phrases]
            self._exact |= {text: name for text in map(plain, said) if not is_address(text)}
            self._phrases += [(_letters(text), name) for text in said]
            texts += [(text, name) for text in dict.fromkeys([*said, *skill.descriptions])]
            texts += [(asked(text), name) for text in EXAMPLES.get(name, ())]
        self._own_names = {one for one in skills if sum(one in other for other in skills) == 1}
        self._phrases = [pair for pair in dict.fromkeys(self._phrases) if pair[0]]
        self._names = [name for _, name in texts]
        knows = (lambda _: False) if model is None else model.knows
        self._misheard = Misheard((text for text, _ in self._phrases), knows)
        listened = {text: name for text, name in self._exact.items() if name != STAND}
        self._sounds = SoundsLike(listened, OTHER_NAMES)
        named = set(skills) - NOT_BY_VOICE
        self._learned = Learned(intents, named, self._mended) if intents is not None else None
        self._unheard = named - {STAND} - set(intents.classes if intents is not None else ())
        if self._learned is not None and not self._unheard:
            return  # nothing is left to be found by likeness
        if model is not None:
            self._vectors = model.embed([text for text, _ in texts])
            self._talk = model.embed([asked(text) for text in TALK])

    def ground(self, text: str) -> Intent:
        """Return what is wanted. A stop anywhere in the utterance wins over everything."""
        found = clauses(text)
        if not found:
            return Intent(IntentKind.CHAT if _WORD.search(text) else IntentKind.NONE)
        if any(clause.form is Form.STOP for clause in found):
            return Intent(IntentKind.STOP, score=1.0, margin=1.0)
        if _RESUME.match(_spoken(text)):
            return Intent(IntentKind.RESUME, score=1.0, margin=1.0)
        named = self._exact.get(" ".join(_WORD.findall(plain(text))))
        if named is not None and named != STAND:
            return Intent(IntentKind.SKILL, named, 1.0, 1.0)
        forbidden: Intent | None = None
        for clause in found:
            if clause.form is Form.NEGATED:
                forbidden = forbidden or self._forbidden(clause)
        numbers, _ = parameters(_spoken(text))
        if self._learned is None:
            best = self._alike(found, numbers)
        else:
            best = self._alike(found, numbers) if self._unheard else Intent(IntentKind.CHAT)
            if best.skill not in self._unheard:
                best = self._learned.intent(text, found, numbers)
        if forbidden and best.skill == forbidden.skill:
            best = Intent(IntentKind.CHAT)
        if forbidden and best.kind is IntentKind.CHAT:
            return forbidden
        return best

    def _alike(self, found: Sequence[Clause], numbers: Parameters) -> Intent:
        """Return what the requests among the clauses are most like."""
        best = Intent(IntentKind.CHAT)
        for before, clause in zip([None, *found], found, strict=False):
            if clause.form not in (Form.REQUEST, Form.BARE):
                continue
            if before is not None and before.form is Form.OTHER and _REFERS.search(clause.text):
                clause = Clause(clause.form, f"{clause.text} {before.text}")
            intent = self._wanted(clause, numbers)
            if intent.kind is not IntentKind.CHAT and intent.score > best.score:
                best = intent
        return best

    def _mended(self, clause: Clause) -> str:
        """Return the text of a clause with the names that were probably said."""
        rest = parameters(clause.text)[1] or clause.text
        return self._misheard.mend(self._sounds.mend(rest, clause.form is Form.REQUEST))

    def _forbidden(self, clause: Clause) -> Intent | None:
        """Read "don't dance" as a stop: of everything, or of the skill that it names."""
        if self._learned is not None and (named := self._learned.named(clause.text)):
            return Intent(IntentKind.STOP, named, 1.0, negated=True)
        if self._learned is None or self._unheard:
            skill, score, _, talk = self._closest(clause.text)
            if talk >= 0.0 and score >= self._limits.request:
                return Intent(IntentKind.STOP, skill, score, negated=True)
        if _MOVES.search(clause.text):
            return Intent(IntentKind.STOP, negated=True, score=1.0)
        return None

    def _wanted(self, clause: Clause, whole: Parameters) -> Intent:
        numbers, rest = parameters(clause.text)
        chat = Intent(IntentKind.CHAT)
        if not _content(rest) and (numbers.again or numbers.repeat):
            return Intent(IntentKind.AGAIN, score=1.0, margin=1.0, parameters=whole)
        if numbers.tempo and len(_content(rest).split()) <= 1:
            return Intent(IntentKind.TEMPO, score=1.0, margin=1.0, parameters=whole)
        skill, score, margin, talk = self._closest(rest or clause.text)
        if score < 1.0:
            sounding = self._sounds.mend(rest or clause.text, clause.form is Form.REQUEST)
            mended = self._closest(sounding)
            if sounding != (rest or clause.text) and mended[1] > score:
                skill, score, margin, talk = mended
        limits = self._limits
        least = limits.request if clause.form is Form.REQUEST else limits.bare
        if not skill or score < least or margin < limits.margin or talk < limits.talk:
            return chat
        kind = IntentKind.SKILL
        if skill == STAND:
            kind = IntentKind.STOP
        return Intent(kind, skill, min(score, 1.0), min(margin, talk, 1.0), whole)

    def _closest(self, text: str) -> tuple[str, float, float, float]:
        """Return the closest skill, its score, the distance to the second and to small talk."""
        if self._model is not None:
            text = self._misheard.mend(text)
        by_skill: dict[str, float] = {}
        bonus: dict[str, float] = {}
        talk = -1.0
        if self._model is not None:
            vector = self._model.embed([text])[0]
            for name, score in zip(self._names, self._vectors @ vector, strict=True):
                by_skill[name] = max(by_skill.get(name, -1.0), float(score))
            talk = float((self._talk @ vector).max())
        letters = _letters(text)
        for phrase, name in self._phrases:
            likeness = phrase_likeness(phrase, letters)
            bonus[name] = max(bonus.get(name, 0.0), LETTERS_WEIGHT * (likeness - LETTERS_FROM))
            if self._model is None and likeness >= self._limits.letters:
                by_skill[name] = max(by_skill.get(name, -1.0), likeness)
        words = text.split()
        for name, more in bonus.items():
            if self._model is not None:
                by_skill[name] += more + (
                    NAMED if name in words and name in self._own_names else 0.0
                )
        if (named := self._exact.get(text)) is not None:
            by_skill[named] = 1.0
        if not by_skill:
            return "", 0.0, 0.0, 0.0
        ranked = sorted(by_skill.items(), key=lambda item: -item[1])
        (skill, score), second = ranked[0], ranked[1][1] if len(ranked) > 1 else 0.0
        return skill, score, score - second, score - talk


def asked(text: str) -> str:
    """Return what is compared of a sentence: what it asks for, without how, and without numbers."""
    wanted = [one.text for one in clauses(text) if one.form in (Form.REQUEST, Form.BARE)]
    if len(wanted) != 1:
        return plain(text)
    return parameters(wanted[0])[1] or wanted[0]


def _spoken(text: str) -> str:
    """Return the words of a text for counting: points inside numbers stay."""
    return " ".join(re.sub(r"[^\w'. -]|\.(?!\d)", " ", plain(text)).split())


def _letters(text: str) -> str:
    """Return the words that carry something, in small letters."""
    bare = _FILLER.sub(" ", plain(text))
    return " ".join(_WORD.findall(bare))


def _content(text: str) -> str:
    """Return what is left to be done once "it" and the like are taken for what was done before."""
    return _BEFORE.sub(" ", _letters(text)).strip()
