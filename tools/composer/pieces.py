"""The bundled pieces by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from downbeat.perception.features import F32
from downbeat.tools.composer import midnight_bones, neon_parade, salsa_del_puerto, tide_runner
from downbeat.tools.composer.desk import Desk
from downbeat.tools.composer.form import Form
from downbeat.tools.composer.waves import count

KEYS = (0.0, 2.0, -3.0, 4.0, -1.0)
"""A repeated piece comes back in another key, so that no passage is a copy of another."""


@dataclass(frozen=True)
class Piece:
    """A piece of music.

    Attributes:
        form: Name, tempo, sections.
        play: Plays it on a desk.
    """

    form: Form
    play: Callable[[Desk], F32]

    @property
    def name(self) -> str:
        """Its name in the catalogue."""
        return self.form.name

    def compose(self, max_beats: float | None = None) -> F32:
        """Return the piece, or its first `max_beats`: (n,) mono at 44.1 kHz, full scale 1."""
        form = self.form
        beats = form.beats if max_beats is None else min(form.beats, max_beats)
        return self.play(Desk(form.bpm, beats, form.tail_s))

    def compose_long(self, bpm: float, seconds: float) -> F32:
        """Return at least `seconds` at another tempo: the piece again and again, key by key."""
        form = self.form
        round_s = form.beats * 60.0 / bpm
        rounds = int(np.ceil(seconds / round_s))
        out = np.zeros(count(rounds * round_s + form.tail_s), np.float32)
        for number in range(rounds):
            part = self.play(Desk(bpm, form.beats, form.tail_s, KEYS[number % len(KEYS)]))
            first = count(number * round_s)
            span = slice(first, min(first + len(part), len(out)))
            out[span] += part[: span.stop - first]
        return np.clip(out, -1.0, 1.0)


PIECES = {
    piece.name: piece
    for piece in (
        Piece(midnight_bones.FORM, midnight_bones.play),
        Piece(neon_parade.FORM, neon_parade.play),
        Piece(salsa_del_puerto.FORM, salsa_del_puerto.play),
        Piece(tide_runner.FORM, tide_runner.play),
    )
}
"""The bundled pieces by name."""
