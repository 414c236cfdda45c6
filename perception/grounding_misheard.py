"""Misheard and misspelt names: "thriler", "zom bee" become words that have a meaning again.

A sentence model knows no more about a word that it never saw than its pieces say. Such words, alone
or with a neighbour, are read as the word of the skills' phrases that they are spelt most like.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable

LEAST = 0.7
"""Likeness of spelling from which an unknown word is taken for one of the skills'."""
MIN_LETTERS = 4
MAX_MORE = 2
"""Letters that a misspelling may have more or less."""
_SOUNDS = (
    (r"tz|ts", "s"),
    (r"ph", "f"),
    (r"[ckq]+", "k"),
    (r"[sz]+", "s"),
    (r"e?igh|ay|ey|ai", "e"),
    (r"(?:er|ar|or|ah|oh|a|o)$", "a"),
    (r"ie$|ey$|y$|ee", "i"),
    (r"(?<=[a-z])h", ""),
    (r"oo|ou|u", "a"),
    (r"(.)\1", r"\1"),
)
"""Spellings of the same sound, applied in this order."""
LEFT_OVER = 0.12
"""Each word that is no part of the phrase makes it so much less alike."""
_WORD = re.compile(r"[a-z']+")


class Misheard:
    """Words of the skills' phrases, and which words are known anyway."""

    def __init__(self, phrases: Iterable[str], knows: Callable[[str], bool]) -> None:
        """Collect the words.

        Args:
            phrases: What the skills are called by.
            knows: Whether a word, in small letters, has a meaning of its own.
        """
        found = {word for text in phrases for word in _WORD.findall(text.lower())}
        self._words = sorted(word for word in found if len(word) >= MIN_LETTERS)
        self._knows = knows

    def mend(self, text: str) -> str:
        """Return the text, in small letters, with what was probably said."""
        words = text.split()
        mended: list[str] = []
        at = 0
        while at < len(words):
            pair = words[at : at + 2]
            unknown = [word for word in pair if _WORD.fullmatch(word) and not self._is_fine(word)]
            joined = self._nearest("".join(pair)) if unknown and len(pair) == 2 else ("", 0.0)
            alone = self._nearest(pair[0]) if pair[0] in unknown else ("", 0.0)
            single = max((self._nearest(word)[1] for word in unknown), default=0.0)
            if joined[1] >= LEAST and joined[1] > single:
                mended.append(joined[0])
                at += 2
                continue
            mended.append(alone[0] if alone[1] >= LEAST else words[at])
            at += 1
        return " ".join(mended)

    def _is_fine(self, word: str) -> bool:
        return word in self._words or self._knows(word)

    def _nearest(self, word: str) -> tuple[str, float]:
        best = ("", 0.0)
        sound = sounds(word)
        for known in self._words:
            if abs(len(known) - len(word)) > MAX_MORE:
                continue  # a handstand is no stand
            likeness = 0.5 * (_alike(known, word) + _alike(sounds(known), sound))
            if likeness > best[1]:
                best = (known, likeness)
        return best


def sounds(word: str) -> str:
    """Return roughly how a word sounds, so that what sounds alike is spelt alike."""
    for letters, sound in _SOUNDS:
        word = re.sub(letters, sound, word)
    return word


def _alike(a: str, b: str) -> float:
    return difflib.SequenceMatcher(None, a, b, autojunk=False).ratio()


def phrase_likeness(phrase: str, text: str) -> float:
    """Return how like a phrase the best piece of a text is, 0 to 1: mishearings are near misses.

    Spaces do not count ("thrill er"), and what is left over makes it less alike.
    """
    words, wanted = text.split(), phrase.replace(" ", "")
    if not words:
        return 0.0
    if phrase == text:
        return 0.97
    best = 0.0
    count = len(phrase.split())
    for size in range(max(1, count - 1), count + 3):
        for start in range(len(words) - size + 1):
            piece = "".join(words[start : start + size])
            ratio = difflib.SequenceMatcher(None, wanted, piece, autojunk=False).ratio()
            left = 1.0 - LEFT_OVER * (len(words) - size)
            best = max(best, 0.95 * ratio * left)
    return best
