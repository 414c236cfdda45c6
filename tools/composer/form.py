"""The form of a piece: its tempo and its sections in bars."""

from __future__ import annotations

from dataclasses import dataclass

BEATS_PER_BAR = 4


@dataclass(frozen=True)
class Form:
    """Sections follow each other on bar lines.

    Attributes:
        name: Of the piece.
        title: For people.
        bpm: Tempo; beat 0 stands at 0 s.
        sections: (name, bars) in order; names are unique.
        tail_s: What rings after the last bar [s].
    """

    name: str
    title: str
    bpm: float
    sections: tuple[tuple[str, int], ...]
    tail_s: float = 2.0

    @property
    def beats(self) -> float:
        """Length without the tail."""
        return float(BEATS_PER_BAR * sum(bars for _, bars in self.sections))

    def start(self, section: str, bar: int = 0) -> float:
        """Return the beat at which a bar of a section starts."""
        bars = 0
        for name, length in self.sections:
            if name == section:
                return float(BEATS_PER_BAR * (bars + bar))
            bars += length
        raise KeyError(section)

    def bars(self, section: str) -> int:
        """Return the length of a section."""
        return dict(self.sections)[section]

    def times_s(self) -> list[tuple[str, float, float]]:
        """Return (name, start, end) of every section [s]; the last one ends with the tail."""
        rows = []
        at = 0
        for name, bars in self.sections:
            rows.append((name, self._time_s(at), self._time_s(at + bars)))
            at += bars
        name, start_s, end_s = rows[-1]
        rows[-1] = (name, start_s, end_s + self.tail_s)
        return rows

    def _time_s(self, bars: int) -> float:
        return bars * BEATS_PER_BAR * 60.0 / self.bpm
