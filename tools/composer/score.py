"""Notation: phrases and chords as short texts, turned into notes on a beat grid."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from downbeat.tools.errors import ToolError

_STEPS = {"C": 0, "D": 2, "E": 4, "F": 5, "G": 7, "A": 9, "B": 11}
_PITCH = re.compile(r"^([A-G])([#b]?)(-?\d)$")
_CHORD = re.compile(r"^([A-G][#b]?)(maj7|m7|m|7|sus4|dim|6|)$")
_INTERVALS = {
    "": (0, 4, 7),
    "m": (0, 3, 7),
    "7": (0, 4, 7, 10),
    "m7": (0, 3, 7, 10),
    "maj7": (0, 4, 7, 11),
    "6": (0, 4, 7, 9),
    "sus4": (0, 5, 7),
    "dim": (0, 3, 6),
}


@dataclass(frozen=True, slots=True)
class Note:
    """One note.

    Attributes:
        beat: Onset, counted from the start of the piece.
        beats: Length.
        pitch: MIDI number, 69 = A4.
        velocity: 0..1.
    """

    beat: float
    beats: float
    pitch: float
    velocity: float = 1.0


def hertz(pitch: float) -> float:
    """Return the frequency of a MIDI pitch, equal temperament on A4 = 440 Hz."""
    return 440.0 * 2.0 ** ((pitch - 69.0) / 12.0)


def pitch_of(name: str) -> int:
    """Return the MIDI number of "C#4" or "Bb3".

    Raises:
        ToolError: Not a pitch.
    """
    match = _PITCH.match(name)
    if match is None:
        raise ToolError(f"'{name}' is not a pitch; write e.g. A4, C#5 or Bb3.")
    step, sign, octave = match.groups()
    return _STEPS[step] + {"": 0, "#": 1, "b": -1}[sign] + 12 * (int(octave) + 1)


def phrase(
    text: str, beat: float, velocity: float = 1.0, transpose: int = 0, gate: float = 0.92
) -> list[Note]:
    """Read a melody: words like "A4/1.5" (pitch/beats), "-/1" is a rest, "A4!/1" is accented.

    Args:
        text: The words; "|" between bars is for the reader.
        beat: Where the phrase begins.
        velocity: Of unaccented notes.
        transpose: Semitones added.
        gate: Share of its length that a note sounds.
    """
    notes = []
    for word in text.replace("|", " ").split():
        name, _, length = word.partition("/")
        beats = float(length)
        if name != "-":
            accented = name.endswith("!")
            pitch = pitch_of(name.rstrip("!")) + transpose
            strength = min(1.0, velocity * 1.2) if accented else velocity
            notes.append(Note(beat, beats * gate, pitch, strength))
        beat += beats
    return notes


def phrase_beats(text: str) -> float:
    """Return the length of a phrase."""
    return sum(float(word.partition("/")[2]) for word in text.replace("|", " ").split())


def chord(symbol: str) -> tuple[int, ...]:
    """Return the pitch classes of "Am", "E7", "Fmaj7" ..., root first.

    Raises:
        ToolError: Not a chord.
    """
    match = _CHORD.match(symbol)
    if match is None:
        raise ToolError(f"'{symbol}' is not a chord; write e.g. Am, E7 or Fmaj7.")
    root = pitch_of(match.group(1) + "0") % 12
    return tuple((root + step) % 12 for step in _INTERVALS[match.group(2)])


def near(pitch_class: int, centre: float) -> int:
    """Return the pitch of a class that lies nearest to `centre`."""
    return round((centre - pitch_class) / 12.0) * 12 + pitch_class


def voicing(symbol: str, centre: float) -> list[int]:
    """Return a close voicing around `centre`: common tones stay, the others move little."""
    return sorted({near(pitch_class, centre) for pitch_class in chord(symbol)})


def root(symbol: str, centre: float) -> int:
    """Return the root of a chord near `centre`."""
    return near(chord(symbol)[0], centre)


def held_chords(
    symbols: Sequence[str], beat: float, beats_each: float, centre: float, velocity: float = 1.0
) -> list[Note]:
    """Return every chord held for `beats_each`."""
    return [
        Note(beat + index * beats_each, beats_each, pitch, velocity)
        for index, symbol in enumerate(symbols)
        for pitch in voicing(symbol, centre)
    ]


def grid_hits(pattern: str, beat: float, step: float = 0.25) -> list[tuple[float, float]]:
    """Read a drum pattern: "X" loud, "x" normal, "o" soft, "." nothing; returns (beat, gain).

    Spaces are for the reader.
    """
    gains = {"X": 1.0, "x": 0.7, "o": 0.4}
    return [
        (beat + index * step, gains[sign])
        for index, sign in enumerate(pattern.replace(" ", ""))
        if sign != "."
    ]


def transposed(notes: Iterable[Note], semitones: float, velocity: float = 1.0) -> list[Note]:
    """Return the notes moved by `semitones`, their velocity scaled."""
    return [Note(n.beat, n.beats, n.pitch + semitones, n.velocity * velocity) for n in notes]
