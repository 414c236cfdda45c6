"""Names that a recogniser wrote as other words: "dance the walls" sounds like "dance the waltz".

`grounding_misheard` mends words that do not exist; here the words exist, and only how they sound
and where they stand (after "dance the", "do a", "like a") says that a name was meant.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

LEAST = 0.76
"""Likeness of sound from which words after "dance the" are taken for a name."""
LEAST_WORD = 0.79
"""The same for a single word, which means something by itself."""
LEAST_PHRASE = 0.84
"""The same for a whole phrase ("come hear", "way of your hand"), which stands anywhere."""
SWAP = 0.5
"""Of two neighbours: twits and twist."""
MIN_SOUNDS = 4
MAX_WORDS = 3
_OTHERS = """
samba rumba mambo mamba tango polka limbo zumba charleston foxtrot quickstep jive bolero
lambada macarena bachata merengue floss flip worm splits jig hornpipe cancan ballet
breakdance swing test tests task tasks desk disc discs rest best next last same dishes
laundry moonwalk rap shopping cooking washing shooting money monday trust rob robe ropes
tour tea toast
"""
OTHER_NAMES = frozenset(_OTHERS.split())
"""Dances that we do not have, and what else is done: they sound like ours, and are meant."""
_SPELLINGS = (
    (r"[^a-z]", ""),
    (r"kn", "n"),
    (r"wh", "w"),
    (r"igh", "i"),
    (r"tch", "c"),
    (r"ph", "f"),
    (r"gh", ""),
    (r"th", "T"),
    (r"sh", "S"),
    (r"ch", "C"),
    (r"ck|q|x|c(?![eiy])", "k"),
    (r"c", "s"),
    (r"tz", "ts"),
    (r"(?<=[aeiou])y|(?<=.)y", "i"),
    (r"e$", ""),
    (r"(?<=[aeiou])r(?![aeiou])", ""),
    (r"w(?![aeiou])", ""),
    (r"[aeiou]+", "a"),
    (r"(.)\1+", r"\1"),
)
"""Applied in this order; vowels, which are misheard most, become one, and a final "er" is one."""
_ALIKE = ("pb", "td", "kg", "sz", "fv", "mn", "lr", "SC", "sS", "Tf", "Tt", "Ts", "Cj", "kC")
_WEAK = frozenset("ahwjr")
"""Sounds that come and go at little cost."""
_FRAME = re.compile(
    r"^(?P<frame>(?:(?:please|now|just|you|can|could|would|and|also) )*"
    r"(?:(?:do|dance|perform|dancing|doing)(?: (?:me|us))?(?: (?:like|in))?|(?:\w+ )?like|be"
    r"|(?:walk|move|act|make|show)(?: (?:me|us))? (?:like|some)|let's (?:do|dance))"
    r"(?: (?:a|an|the|some|that|this|your|one|more|little|bit of))* )(?P<object>.+)$"
)
"""Such words say that a dance's name follows."""
_AROUND = re.compile(
    r"^(?:please|plea|for|with|dance|now|by|like|from|again|routine|thing|to|in|until|moves?|style"
    r"|and|step|steps|video)$"
)
"""What may follow a name."""


def heard(word: str) -> str:
    """Return the sounds of words written together, consonants by class, vowels all alike."""
    for letters, sound in _SPELLINGS:
        word = re.sub(letters, sound, word)
    return word


def likeness(one: str, other: str) -> float:
    """Return how alike two strings of sounds are, 0 to 1: 1 - weighted edits / the longer."""
    if not one or not other:
        return 0.0
    row = [0.0]
    for sound in other:
        row.append(row[-1] + _gap(sound))
    above: list[float] = []
    for index, a in enumerate(one):
        twice, above, row = above, row, [row[0] + _gap(a)]
        for at, b in enumerate(other):
            cost = min(above[at + 1] + _gap(a), row[-1] + _gap(b), above[at] + _substitution(a, b))
            if index and at and a == other[at - 1] and b == one[index - 1]:
                cost = min(cost, twice[at - 1] + SWAP)
            row.append(cost)
    return 1.0 - row[-1] / max(len(one), len(other))


def _gap(sound: str) -> float:
    return 0.5 if sound in _WEAK else 0.9


def _substitution(a: str, b: str) -> float:
    if a == b:
        return 0.0
    return 0.35 if a + b in _ALIKE or b + a in _ALIKE else 1.0


class SoundsLike:
    """Names and phrases by their sound."""

    def __init__(self, names: Mapping[str, str], known: Iterable[str] = ()) -> None:
        """Collect what is listened for.

        Args:
            names: Phrase -> what it stands for.
            known: Words that are never taken for another: other dances, and the names' own words.
        """
        self._names = [(text, heard(text)) for text in names]
        self._names = [one for one in self._names if len(one[1]) >= MIN_SOUNDS]
        own = {word for text in names for word in text.split()}
        self._others = frozenset(known)
        self._known = own | self._others

    def mend(self, text: str, is_request: bool = True) -> str:
        """Return the text with the name in it that was probably said, or as it was.

        Args:
            text: A request in small letters, without what makes it one.
            is_request: False: only whole phrases are looked for.
        """
        phrase = self._phrase(text.split())
        if phrase:
            return phrase
        frame = _FRAME.match(text)
        if frame is None or not is_request:
            return text
        words, lead = frame["object"].split(), frame["frame"].split()
        best, found = 0.0, ""
        # "like a some bee": what looks like an article may be heard of the name.
        for before in ([], lead[-1:]):
            first = lead[: len(lead) - len(before)]
            for size in range(1, MAX_WORDS + 1):
                window, rest = [*before, *words][:size], [*before, *words][size:]
                if len(window) < size or size <= len(before) or set(window) & self._known:
                    continue
                if rest and not _AROUND.match(rest[0]):
                    continue
                name, score = self._nearest("".join(window), size == 1)
                if score > max(best, LEAST_WORD if size == 1 else LEAST):
                    best, found = score, " ".join([*first, name, *rest])
        return found or text

    def _phrase(self, words: list[str]) -> str:
        best, found = LEAST_PHRASE, ""
        for size in range(2, 5):
            if len(words) < size or self._others & set(words[:size]):
                continue
            for name, _ in self._names:
                if " " not in name:
                    continue
                # What is the same says nothing: "dance like cleopatra" is no "dance like a robot".
                wanted, said = _without_common(name.split(), words[:size])
                score = likeness(heard(said), heard(wanted))
                if score > best:
                    best, found = score, " ".join([name, *words[size:]])
        return found

    def _nearest(self, joined: str, is_one_word: bool) -> tuple[str, float]:
        sound = heard(joined)
        scored = [
            (likeness(sound, one), name)
            for name, one in self._names
            if " " not in name or not is_one_word
        ]
        score, name = max(scored, default=(0.0, ""))
        return name, score


def _without_common(one: list[str], other: list[str]) -> tuple[str, str]:
    """Return two phrases, written together, without the words that both begin with."""
    while one and other and one[0] == other[0]:
        one, other = one[1:], other[1:]
    return "".join(one), "".join(other)
