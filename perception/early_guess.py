"""Recognising an utterance while it is not yet known to have ended.

The pause that ends an utterance is most of the robot's time to react, and the recogniser would
idle in it. So it begins after a tenth of a second; when the pause is over, its answer is there. A
command that it is very sure of (`ends_a_pause`) ends the pause at once; what goes on makes the
guess worthless.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Generic, TypeVar

from downbeat.perception.recognisers import Recognition

T = TypeVar("T")
LONGEST_S = 4.0
"""Commands are shorter; guessing about a speech at every breath only costs time."""
SURE = 0.95
"""Confidence from which a pause is ended: a few words into a sentence, when the rest that would
make it none is still to come, a command has to sound far better than the 0.25 to 0.4 that do for a
whole utterance. It saves 0.09 s where it is right and makes the robot move where it is wrong."""
_AROUND_WORDS = "a again an and can could do hey it me now okay please robot show the us you"
AROUND = frozenset(_AROUND_WORDS.split())
FEWEST_WORDS = 2
"""One word is too easily the beginning of a sentence: "the monkey, I think, ..." sounds like "do
the monkey", "we stopped" like "please stop it", and both with a confidence of 0.9 to 1.0."""


@dataclass
class Guesses(Generic[T]):
    """At most one guess at a time; `serial` numbers the pauses (see `segments.Segment`).

    Attributes:
        running: Pause whose utterance is being recognised, None: none.
    """

    running: int | None = None
    _ended: int | None = None
    _known: dict[int, T] = field(default_factory=dict)

    def begin(self, serial: int) -> None:
        """Note that a pause's utterance is being recognised; older guesses are over."""
        self._known.clear()
        self.running = serial

    def drop(self, serial: int) -> None:
        """Forget a guess: the utterance is not listened to."""
        self._known.pop(serial, None)

    def end(self, serial: int) -> tuple[bool, T | None]:
        """Note that the pause has become the end.

        Returns:
            Whether there is, or will be, a guess; and the guess, None: it is on its way.
        """
        if serial in self._known:
            return True, self._known.pop(serial)
        if serial == self.running:
            self._ended = serial
            return True, None
        return False, None

    def arrive(self, guess: T | None) -> T | None:
        """Take what was recognised; returns it if the utterance has ended meanwhile."""
        serial, self.running = self.running, None
        if serial is None or guess is None:
            self._ended = None
            return None
        if serial == self._ended:
            self._ended = None
            return guess
        self._known[serial] = guess
        return None

    def known(self) -> list[tuple[int, T]]:
        """Return the guesses about pauses that may still be over: (serial, guess)."""
        return list(self._known.items())


def ends_a_pause(recognition: Recognition) -> bool:
    """Return whether a guess is so sure that the rest of the pause need not be waited for.

    Words that may stand around any command ("now", "please") do not count, nor does a confidence
    that is no number: such a guess waits for the whole pause, and is used then.
    """
    words = [word for word in recognition.words or recognition.text.split() if word not in AROUND]
    return len(words) >= FEWEST_WORDS and recognition.confidence >= SURE
