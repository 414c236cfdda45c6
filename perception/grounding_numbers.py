"""Numbers in spoken requests: for how long, how far, how often, how fast."""

from __future__ import annotations

import re
from dataclasses import dataclass

_UNIT_WORDS = (
    "zero one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen "
    "sixteen seventeen eighteen nineteen"
)
_UNITS = _UNIT_WORDS.split()
_TEN_WORDS = "twenty thirty forty fifty sixty seventy eighty ninety"
_TENS = _TEN_WORDS.split()
_SMALL = {word: value for value, word in enumerate(_UNITS)}
_SMALL |= {word: 10 * (index + 2) for index, word in enumerate(_TENS)}

MAX_DURATION_S = 600.0
MAX_DISTANCE_M = 10.0
MAX_REPEAT = 20
STEP_M = 0.25
"""Length of one step of our walk."""

_NUMBER = (
    rf"(?:\d+(?:\.\d+)?|(?:{'|'.join([*_SMALL, 'hundred', 'half', 'a', 'an', 'and', 'point'])}))"
)
_AMOUNT = re.compile(
    rf"\b(?:for |about |around |exactly |some )*(?P<number>{_NUMBER}(?:[ -]{_NUMBER})*)"
    r"(?: an?| of an?)?(?: |(?<=\d))"
    r"(?P<unit>seconds?|secs?|s|minutes?|mins?|met(?:er|re)s?|m|steps?|times)\b"
)
_FREQUENCY = re.compile(r"\b(?:(once)|(twice)|(thrice))\b(?! upon)")
_FASTER = re.compile(
    r"\b(?:faster|quicker|speed (?:it |that |things )?up|more (?:quickly|speed)"
    r"|double (?:the )?(?:speed"
    r"|tempo|time)|twice (?:as fast|the speed)|(?:pick|step) up the (?:pace|tempo|speed)"
    r"|(?:a )?(?:higher|quicker) (?:pace|tempo|speed)|hurry(?: up)?"
    r"|(?:do (?:it|that|this)|go)(?: (?:really|very|super|so|much|a lot|even))*"
    r" (?:fast|quick(?:ly)?)"
    r"|(?:raise|increase|up)(?: the| your)? (?:pace|tempo|speed)(?: by (?:\w+ ){1,2}percent)?"
    r"|accelerate|speed up(?: (?:please|the (?:dance|music|moves?)))?)\b"
)
_SLOWER = re.compile(
    r"\b(?:slower|slow (?:it |that |things )?down|more slowly|less (?:quickly|speed)"
    r"|half (?:the )?(?:speed"
    r"|tempo|time)|half as fast|(?:lower|reduce|decrease|drop) the (?:pace|tempo|speed)"
    r"|(?:a )?(?:lower|slower) (?:pace|tempo|speed)|slow down the (?:dance|moves?|pace|tempo|speed)"
    r"|decelerate|in slow motion)\b"
)
_AGAIN = re.compile(
    r"\b(?:again|once more|one more time|another (?:time|go|round)"
    r"|repeat(?: (?:that|it|this|the|your|what you (?:just )?did))?(?: last)?(?: (?:one|dance|thing"
    r"|move|moves|part|bit|motion|skill|routine|sequence|action|trick))?"
    r"|replay(?: that| it)?|(?:the )?same(?: (?:thing|one|dance|move|motion))? (?:again|once more)"
    r"|do (?:it|that) over|encore|one more|from the top)\b"
)


@dataclass(frozen=True)
class Parameters:
    """What a request says besides the skill; None: nothing.

    Attributes:
        duration_s: For how long [s], at most 600.
        distance_m: How far [m], at most 10; steps count 0.25 m.
        repeat: How often, 1 to 20.
        tempo: +1 faster, -1 slower, 0 nothing said.
        again: What was done before is wanted once more.
    """

    duration_s: float | None = None
    distance_m: float | None = None
    repeat: int | None = None
    tempo: int = 0
    again: bool = False


def number(text: str) -> float | None:
    """Return the value of a number in digits or English words below 1000; None if it is none.

    "a", "an" are one; "half" is a half ("two and a half", "half a"); "point" begins digits.
    """
    words = text.replace("-", " ").split()
    if not words:
        return None
    if "point" in words:
        at = words.index("point")
        whole = number(" ".join(words[:at])) if at else 0.0
        digits = [str(_SMALL[word]) for word in words[at + 1 :] if _SMALL.get(word, 10) < 10]
        if whole is None or len(digits) != len(words) - at - 1 or not digits:
            return None
        return whole + float("0." + "".join(digits))
    total, last, seen, fraction = 0.0, 0.0, False, 0.0
    for index, word in enumerate(words):
        if re.fullmatch(r"\d+(\.\d+)?", word):
            if seen:
                return None
            last, seen = float(word), True
        elif word in _SMALL:
            value = _SMALL[word]
            fits = not seen or (value < 10 <= last and last % 10 == 0) or (total and not last)
            if not fits:
                return None
            last, seen = last + value, True
        elif word == "hundred":
            if total or last > 9:
                return None
            total, last, seen = 100.0 * (last if seen else 1.0), 0.0, True
        elif word == "half":
            fraction = 0.5
        elif word in ("a", "an"):
            following = words[index + 1 : index + 2]
            if following != ["half"] and following != ["hundred"] and fraction == 0.0:
                if seen:
                    return None
                last, seen = 1.0, True
        elif word != "and":
            return None
    return total + last + fraction if seen or fraction else None


def parameters(text: str) -> tuple[Parameters, str]:
    """Return what a request says in numbers, and the text without it.

    Args:
        text: Small letters without marks, except points inside numbers.
    """
    duration_s: float | None = None
    distance_m: float | None = None
    repeat: int | None = None

    def take(match: re.Match[str]) -> str:
        nonlocal duration_s, distance_m, repeat
        value = number(match["number"])
        if value is None or value <= 0.0:
            return match[0]
        unit = match["unit"]
        if unit.startswith("s") and not unit.startswith("step"):
            duration_s = min(MAX_DURATION_S, value)
        elif unit.startswith("min"):
            duration_s = min(MAX_DURATION_S, 60.0 * value)
        elif unit == "times":
            repeat = max(1, min(MAX_REPEAT, round(value)))
        else:
            length = STEP_M if unit.startswith("step") else 1.0
            distance_m = min(MAX_DISTANCE_M, length * value)
        return " "

    again = bool(_AGAIN.search(text))
    rest = _AGAIN.sub(" ", text)  # "one more time" is no count
    rest = _AMOUNT.sub(take, rest)
    tempo = int(bool(_FASTER.search(rest))) - int(bool(_SLOWER.search(rest)))
    rest = _SLOWER.sub(" ", _FASTER.sub(" ", rest))  # "twice as fast" is no count
    if repeat is None and (often := _FREQUENCY.search(rest)):
        repeat = 1 + next(index for index, group in enumerate(often.groups()) if group)
        rest = _FREQUENCY.sub(" ", rest)
    found = Parameters(duration_s, distance_m, repeat, tempo, again)
    return found, " ".join(rest.split())
