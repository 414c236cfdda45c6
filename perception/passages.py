"""Passages that two tracks of a catalogue share: found when it is built, minded by a query."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

WITHIN = 0.5
"""A window lies in a passage with this share of it."""


@dataclass(frozen=True, slots=True, order=True)
class Passage:
    """The same sound in two tracks.

    Attributes:
        one: Name of the track that comes first in the alphabet.
        one_s: Where it begins there [s].
        other: Name of the other track.
        other_s: Where it begins there [s].
        seconds: How long it is [s].
    """

    one: str
    one_s: float
    other: str
    other_s: float
    seconds: float

    def text(self) -> str:
        """Say it: X 0:12-0:20 is in Y 0:40-0:48."""
        return (
            f"'{self.one}' {_span(self.one_s, self.seconds)} is in "
            f"'{self.other}' {_span(self.other_s, self.seconds)}"
        )


class Twins:
    """Which tracks a window cannot be told apart from by itself."""

    def __init__(self, names: Sequence[str], shared: Iterable[Passage]) -> None:
        """Take the names of the tracks and what they share."""
        numbers = {name: number for number, name in enumerate(names)}
        self._of: dict[int, list[tuple[float, float, int]]] = {}
        for passage in shared:
            one, other = numbers[passage.one], numbers[passage.other]
            for track, twin, begin_s in (
                (one, other, passage.one_s),
                (other, one, passage.other_s),
            ):
                span = (begin_s, begin_s + passage.seconds, twin)
                self._of.setdefault(track, []).append(span)

    def of(self, track: int, tau_s: float, seconds: float) -> set[int]:
        """Return the numbers of the tracks that hold what a window of this track holds.

        Args:
            track: Number of the track.
            tau_s: Where the window starts [s].
            seconds: How long it is [s].
        """
        return {
            twin
            for begin_s, end_s, twin in self._of.get(track, ())
            if min(end_s, tau_s + seconds) - max(begin_s, tau_s) >= WITHIN * seconds
        }


def shared_among(shared: Iterable[Passage], names: Iterable[str]) -> tuple[Passage, ...]:
    """Return the passages of which both tracks are among the names."""
    known = set(names)
    return tuple(p for p in shared if p.one in known and p.other in known)


def _span(begin_s: float, seconds: float) -> str:
    return f"{_clock(begin_s)}-{_clock(begin_s + seconds)}"


def _clock(seconds: float) -> str:
    whole = max(round(seconds), 0)
    return f"{whole // 60}:{whole % 60:02d}"
