"""The bundled pieces by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from downbeat.perception.features import F32
from downbeat.tools.composer import midnight_bones, neon_parade, salsa_del_puerto, tide_runner
from downbeat.tools.composer.desk import Desk
from downbeat.tools.composer.form import Form


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
