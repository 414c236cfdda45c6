"""Recognising an utterance while it is not yet known to have ended.

The pause that ends an utterance is most of the robot's time to react, and the recogniser would
idle in it. So it begins after a tenth of a second; when the pause is over, its answer is there. A
command that it is sure of ends the pause at once; what goes on makes the guess worthless.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Generic, TypeVar

T = TypeVar("T")
LONGEST_S = 4.0
"""Commands are shorter; guessing about a speech at every breath only costs time."""


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
