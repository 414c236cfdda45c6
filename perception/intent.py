"""What an utterance wants: the answer of the grounding."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from downbeat.perception.grounding_numbers import Parameters

NOT_BY_VOICE = frozenset({"talk"})
"""Gestures of the robot's own speech: an answer brings them."""


class IntentKind(Enum):
    """What an utterance wants."""

    NONE = "none"
    """Nothing was said."""
    STOP = "stop"
    """Stand, at once."""
    SKILL = "skill"
    AGAIN = "again"
    """What was done before, once more."""
    TEMPO = "tempo"
    """The same, faster or slower."""
    RESUME = "resume"
    """Dance to the music again, after a stop."""
    CHAT = "chat"
    """No command: answer it."""


@dataclass(frozen=True)
class Intent:
    """What an utterance wants.

    Attributes:
        kind: What to do.
        skill: Of SKILL: its name; of a forbidding STOP: what is forbidden; else empty.
        score: Closeness to that skill, 0 to 1.
        margin: Distance to the second skill or to small talk, whichever is closer.
        parameters: Numbers in the request.
        negated: Something was forbidden.
    """

    kind: IntentKind
    skill: str = ""
    score: float = 0.0
    margin: float = 0.0
    parameters: Parameters = field(default_factory=Parameters)
    negated: bool = False
