"""The bundled pieces by name: composed at first use, the same bytes every time."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import soundfile
from downbeat.perception.features import F32
from downbeat.runtime.errors import one_of
from downbeat.tools.composer import midnight_bones, neon_parade, salsa_del_puerto, tide_runner
from downbeat.tools.composer.desk import Desk
from downbeat.tools.composer.form import BEATS_PER_BAR, Form
from downbeat.tools.composer.waves import RATE_HZ, count
from downbeat.tools.errors import ToolError

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

    @property
    def title(self) -> str:
        """Its name for people."""
        return self.form.title

    @property
    def tempo_bpm(self) -> float:
        """Its tempo; beat 0 stands at 0 s."""
        return self.form.bpm

    @property
    def beats_per_bar(self) -> int:
        """Beats of a bar."""
        return BEATS_PER_BAR

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


@lru_cache(maxsize=1)
def code_version() -> str:
    """Return a hash of the composer's code: a changed piece is composed again."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def render(name: str, cache_dir: Path) -> Path:
    """Return the sound file of a piece, composed if the cache has none.

    The file is `cache_dir`/VERSION/NAME.flac: the folder holds nothing but pieces and can be used
    like any folder of recordings.

    Raises:
        ToolError: There is no such piece.
    """
    if name not in PIECES:
        raise ToolError(
            f"Composition '{name}' is unknown; compositions are {one_of(PIECES)} (composition)."
        )
    path = cache_dir / code_version() / f"{name}.flac"
    if not path.is_file():
        samples = PIECES[name].compose()
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_name(f".{name}-{os.getpid()}.part")
        soundfile.write(part, samples, RATE_HZ, format="FLAC", subtype="PCM_16")
        part.replace(path)  # whole or not at all, also when two shows start at once
    return path
