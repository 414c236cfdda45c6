"""What may be said around the skills' phrases, and how words sound."""

from __future__ import annotations

import re
from collections.abc import Callable

STOP_WORDS = (
    "stop",
    "stop it",
    "stop now",
    "stop moving",
    "stop dancing",
    "freeze",
    "halt",
    "basta",
    "stand still",
)
ALONE = ("again", "faster", "slower", "do it again", "go faster", "go slower")

ADDRESS = ("robot", "hey robot", "please")
ASKING = ("can you", "could you", "would you", "please")
NEGATION = ("don't", "do not", "never")
VERB = ("do", "do a", "do the", "dance", "dance a", "dance the", "show me", "show me the")
NUMBERS = ("one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "twenty")
TAIL = ("please", "now", "again", "robot")
AMOUNTS = tuple(
    [f"for {number} {unit}" for number in NUMBERS for unit in ("seconds", "minutes")]
    + [f"{number} {unit}" for number in NUMBERS for unit in ("meters", "steps", "times")]
)

_WORD = re.compile(r"[a-z][a-z']*")


def plain(text: str) -> str:
    """Return the words of a text in small letters, without marks."""
    return " ".join(_WORD.findall(text.lower().replace("’", "'")))


# Letters to sounds, longest first: for the few words that no dictionary has.
_SOUNDS = (
    ("tion", "SH AH N"), ("igh", "AY"), ("tch", "CH"), ("sch", "SH"), ("ing", "IH NG"),
    ("ch", "CH"), ("sh", "SH"), ("th", "TH"), ("ph", "F"), ("ck", "K"), ("qu", "K W"),
    ("ng", "NG"), ("wh", "W"), ("ee", "IY"), ("ea", "IY"), ("oo", "UW"), ("ou", "AW"),
    ("ow", "OW"), ("ai", "EY"), ("ay", "EY"), ("oy", "OY"), ("oi", "OY"), ("au", "AO"),
    ("er", "ER"), ("ar", "AA R"), ("or", "AO R"), ("a", "AE"), ("b", "B"), ("c", "K"),
    ("d", "D"), ("e", "EH"), ("f", "F"), ("g", "G"), ("h", "HH"), ("i", "IH"), ("j", "JH"),
    ("k", "K"), ("l", "L"), ("m", "M"), ("n", "N"), ("o", "AA"), ("p", "P"), ("q", "K"),
    ("r", "R"), ("s", "S"), ("t", "T"), ("u", "AH"), ("v", "V"), ("w", "W"), ("x", "K S"),
    ("y", "IY"), ("z", "Z"),
)  # fmt: skip
_ENDINGS = (("ing", "IH NG"), ("s", "Z"), ("er", "ER"), ("ed", "D"))
_LETTERS = {
    "b": "B IY", "c": "S IY", "d": "D IY", "f": "EH F", "g": "JH IY", "h": "EY CH", "j": "JH EY",
    "k": "K EY", "l": "EH L", "m": "EH M", "n": "EH N", "p": "P IY", "q": "K Y UW", "r": "AA R",
    "s": "EH S", "t": "T IY", "v": "V IY", "w": "D AH B AH L Y UW", "x": "EH K S", "z": "Z IY",
}  # fmt: skip


def pronounce(word: str, lookup: Callable[[str], str | None]) -> str:
    """Return the phones of a word that the dictionary lacks, from its parts or its letters.

    Args:
        word: Small letters.
        lookup: word -> phones, None where it is unknown.
    """
    for ending, phones in _ENDINGS:
        if word.endswith(ending) and len(word) > len(ending) + 1:
            stem = word[: -len(ending)]
            stems = (stem, stem[:-1]) if stem[-1] == stem[-2:-1] else (stem, stem + "e")
            if known := next(filter(None, map(lookup, stems)), None):
                return f"{known} {phones}"
    if (head := _LETTERS.get(word[0])) and word[1:2] not in "aeiouy" and (tail := lookup(word[1:])):
        return f"{head} {tail}"  # kpop, djset
    if len(word) == 1:
        return _LETTERS.get(word, "EY")
    for cut in range(len(word) - 3, 2, -1):  # two words written as one
        if (first := lookup(word[:cut])) and (second := lookup(word[cut:])):
            return f"{first} {second}"
    found, at = [], 0
    letters = re.sub(r"[^a-z]|(.)(?=\1)(?![eo])", "", word)
    while at < len(letters):
        text, sound = next(pair for pair in _SOUNDS if letters.startswith(pair[0], at))
        found.append(sound)
        at += len(text)
    return " ".join(found)


def british(phones: str) -> set[str]:
    """Return how a word may sound besides, in the south of England: dance, stop, circle.

    Args:
        phones: American, as the dictionary has them.
    """
    spoken = phones.split()
    vowel = [sound[0] in "AEIOU" for sound in spoken] + [False]
    after = [*spoken[1:], ""]
    open_o = [
        "AO" if sound == "AA" and after[at] != "R" else sound for at, sound in enumerate(spoken)
    ]
    broad_a = [
        "AA" if sound == "AE" and after[at] in {"N", "S", "F", "TH"} else sound
        for at, sound in enumerate(spoken)
    ]
    silent_r = [
        "AH" if sound == "ER" and at and not vowel[at + 1] else sound
        for at, sound in enumerate(spoken)
        if not (sound == "R" and at and vowel[at - 1] and not vowel[at + 1])
    ]
    return {" ".join(form) for form in (open_o, broad_a, silent_r)} - {phones}
