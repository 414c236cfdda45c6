"""The grammar of what may be said to the robot, from the skills' own phrases, and how it sounds."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable

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
_STOPPING = {text.split()[0] for text in STOP_WORDS}
ALONE = ("again", "faster", "slower", "do it again", "go faster", "go slower")

_ADDRESS = ("robot", "hey robot", "please")
_ASKING = ("can you", "could you", "would you", "please")
_NEGATION = ("don't", "do not", "never")
_VERB = ("do", "do a", "do the", "dance", "dance a", "dance the", "show me", "show me the")
_NUMBERS = ("one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "twenty")
_TAIL = ("please", "now", "again", "robot")

_WORD = re.compile(r"[a-z][a-z']*")


def plain(text: str) -> str:
    """Return the words of a text in small letters, without marks: what a grammar can hold."""
    return " ".join(_WORD.findall(text.lower().replace("’", "'")))


def grammar(phrases: Iterable[str]) -> str:
    """Return the JSGF grammar of commands.

    A negation is part of it on purpose: without one, "don't dance" is heard as "dance". Stops
    are never negated nor counted: the short words of it only swallow the sound of others.

    Args:
        phrases: As the skill manifests have them, unique or not.
    """
    known = {text for phrase in phrases if (text := plain(phrase))}
    bare = sorted({text for text in known if text.split()[0] in _STOPPING} | set(STOP_WORDS))
    bare += ALONE
    known -= set(bare)
    rare = "/1/ <NULL> | /0.0001/"  # what may be left out is only heard where the sound says so
    maybe = {
        name: f"( {rare} <{name}> )"
        for name in ("address", "asking", "negation", "verb", "amount", "tail")
    }
    phrase = f"{maybe['negation']} {maybe['verb']} <phrase> {maybe['amount']}" if known else ""
    return "\n".join(
        (
            "#JSGF V1.0;",
            "grammar commands;",
            f"<address> = {' | '.join(_ADDRESS)};",
            f"<asking> = {' | '.join(_ASKING)};",
            f"<negation> = {' | '.join(_NEGATION)};",
            f"<verb> = {' | '.join(_VERB)};",
            f"<number> = {' | '.join(_NUMBERS)};",
            "<amount> = for <number> (seconds | minutes) | <number> (meters | steps | times);",
            f"<tail> = {' | '.join(_TAIL)};",
            f"<phrase> = {' | '.join(sorted(known) or ['<NULL>'])};",
            f"<bare> = {' | '.join(bare)};",
            f"public <command> = {maybe['address']} {maybe['asking']} ( {phrase or '<bare>'} |"
            f" <bare> ) {maybe['tail']};",
        )
    )


def words(jsgf: str) -> list[str]:
    """Return every word that a grammar can say, sorted."""
    body = re.sub(r"<[^>]*>|/[^/]*/", " ", jsgf.split(";", 2)[2])
    return sorted(set(_WORD.findall(body.replace("public", " "))))


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
