"""What may be said to the robot, as a network of phones, from the skills' own phrases."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from downbeat.perception.acoustic_model import SILENCE, STATES, AcousticModel
from downbeat.perception.phone_network import Chain, Columns, Network, combinations
from downbeat.perception.recogniser_grammar import (
    ADDRESS,
    ALONE,
    AMOUNTS,
    ASKING,
    NEGATION,
    STOP_WORDS,
    TAIL,
    VERB,
    british,
    plain,
    pronounce,
)

STOP = "stop"
"""The meaning of every stop word."""

_RARE = math.log(1e-4)
"""What may be left out is only heard where the sound says so."""
_PAUSE = math.log(0.3)
_MOST_FORMS = 6
_FILLERS = {SILENCE, "+NSN+", "+SPN+"}
_STOPPING = {text.split()[0] for text in STOP_WORDS}
# Hubs of the part before the phrase, and, counted from the end of the sound, of the part after it.
_BEGIN, _ADDRESSED, _ASKED, _NEGATED, _VERBED, PHRASE = range(6)
_END, _TAILED, AFTER = range(3)


@dataclass(frozen=True)
class CommandNetworks:
    """The networks that hear the same sound.

    Attributes:
        columns: Which likelihoods they read.
        front: Up to the end of the phrase, which is in the hub `PHRASE`.
        back: From the end of the sound back to the end of the phrase, the hub `AFTER`.
        loop: Any phones in any order.
        meanings: What every phrase asks for; "" is a question.
    """

    columns: Columns
    front: Network
    back: Network
    loop: Network
    meanings: dict[str, str]


class Dictionary:
    """How words sound."""

    def __init__(self, file: Path, model: AcousticModel) -> None:
        """Read the dictionary of the package.

        Args:
            file: A word and its phones on every line.
            model: Which has numbers for the phones.
        """
        self._numbers = {name: number for number, name in enumerate(model.phones)}
        self._forms: dict[str, list[str]] = {}
        for line in file.read_text(encoding="utf-8").splitlines():
            word, _, phones = line.partition(" ")
            self._forms.setdefault(word.partition("(")[0], []).append(phones)

    def forms(self, word: str) -> list[str]:
        """Return the ways to say a word: American, then British; from its letters if unknown."""
        known = self._forms.get(word) or [pronounce(word, self._first)]
        return known + sorted({form for one in known for form in british(one)} - set(known))

    def ways(self, text: str) -> list[list[list[int]]]:
        """Return the ways to say some words: of each word the numbers of its phones."""
        return [
            [[self._numbers[phone] for phone in word.split()] for word in way]
            for way in combinations([self.forms(word) for word in text.split()], _MOST_FORMS)
        ]

    def _first(self, word: str) -> str | None:
        return next(iter(self._forms.get(word, ())), None)


def command_networks(
    phrases: Mapping[str, str], model: AcousticModel, dictionary: Dictionary, phone_cost: float
) -> CommandNetworks:
    """Build the networks.

    Args:
        phrases: Phrase -> what it asks for.
        model: The acoustic model.
        dictionary: How words sound.
        phone_cost: Of every phone of the loop, a logarithm.
    """
    columns = Columns(model)
    meanings = {text: meaning for phrase, meaning in phrases.items() if (text := plain(phrase))}
    meanings |= {text: text.split()[-1] for text in ALONE if text not in meanings}
    meanings |= dict.fromkeys(STOP_WORDS, STOP)
    build = _Builder(model, columns, dictionary)
    front = [build.pause(hub) for hub in (_BEGIN, _ADDRESSED)]
    steps = (ADDRESS, ASKING, NEGATION, VERB)
    for hub, words in enumerate(steps):
        front += build.words(words, hub, hub + 1, _RARE - math.log(len(words)))
    lefts, rights = build.edges([w for s in steps for w in s], [*TAIL, *AMOUNTS])
    for text, meaning in sorted(meanings.items()):
        entry = _entry(text, meaning)
        front += build.words((text,), entry, PHRASE, 0.0, lefts, rights)
    back = [build.pause(hub) for hub in (_END, AFTER)]
    back += build.words(TAIL, _END, _TAILED, _RARE - math.log(len(TAIL)))
    back += build.words(AMOUNTS, _TAILED, AFTER, _RARE - math.log(len(AMOUNTS)))
    loop = [build.pause(0, 0.0), *build.phones(phone_cost)]
    skips = [(hub, hub + 1) for hub in range(len(steps))]
    return CommandNetworks(
        columns,
        Network(model, front, skips),
        Network(model, back, [(_END, _TAILED), (_TAILED, AFTER)], is_reversed=True),
        Network(model, loop),
        meanings,
    )


def _entry(text: str, meaning: str) -> int:
    if not meaning:
        return _ADDRESSED  # nobody asks the robot to dance a question
    return _ASKED if text in ALONE or text.split()[0] in _STOPPING else _VERBED


class _Builder:
    """Makes chains."""

    def __init__(self, model: AcousticModel, columns: Columns, dictionary: Dictionary) -> None:
        self._model, self._columns, self._dictionary = model, columns, dictionary
        self._silence = model.phones.index(SILENCE)

    def pause(self, hub: int, weight: float = _PAUSE) -> Chain:
        first = self._silence * STATES
        columns = [self._columns.column((first + k,)) for k in range(STATES)]
        return Chain(columns, [self._silence] * STATES, hub, hub, weight, "")

    def words(
        self,
        texts: tuple[str, ...],
        entry: int,
        leads_to: int,
        weight: float,
        lefts: list[int] | None = None,
        rights: list[int] | None = None,
    ) -> list[Chain]:
        found = []
        for text in texts:
            for way in self._dictionary.ways(text):
                edges = lefts or [self._silence], rights or [self._silence]
                columns, phones = self._columns.chain(way, *edges)
                found.append(Chain(columns, phones, entry, leads_to, weight, text))
        return found

    def phones(self, weight: float) -> list[Chain]:
        return [
            Chain(columns, [number] * STATES, 0, 0, weight, self._model.phones[number])
            for number, columns in enumerate(self._columns.any_context())
            if self._model.phones[number] not in _FILLERS
        ]

    def edges(self, before: list[str], after: list[str]) -> tuple[list[int], list[int]]:
        """Return the phones that a phrase may follow, and those that may follow it."""
        first = {self._dictionary.ways(text)[0][0][0] for text in after}
        last = {self._dictionary.ways(text)[0][-1][-1] for text in before}
        return sorted({self._silence} | last), sorted({self._silence} | first)
