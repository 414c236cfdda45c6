"""The bundled pieces as sound: composed at first use, the same bytes every time, then cached."""

from __future__ import annotations

import hashlib
import os
from functools import lru_cache
from pathlib import Path

import soundfile

from downbeat.perception.features import F32
from downbeat.perception.source import Recording, load_recording
from downbeat.runtime.errors import one_of
from downbeat.tools.composer.form import Form
from downbeat.tools.composer.pieces import PIECES, Piece
from downbeat.tools.composer.waves import RATE_HZ
from downbeat.tools.errors import ToolError

COMPOSITIONS = tuple(PIECES)


def _piece(name: str) -> Piece:
    if name not in PIECES:
        raise ToolError(
            f"Composition '{name}' is unknown; compositions are {one_of(PIECES)} (composition)."
        )
    return PIECES[name]


def form(name: str) -> Form:
    """Return a piece's tempo and sections.

    Raises:
        ToolError: There is no such piece.
    """
    return _piece(name).form


def compose(name: str, max_beats: float | None = None) -> F32:
    """Compose a piece, or its first `max_beats`: (n,) mono at 44.1 kHz, full scale 1.

    Raises:
        ToolError: There is no such piece.
    """
    return _piece(name).compose(max_beats)


@lru_cache(maxsize=1)
def code_version() -> str:
    """Return a hash of the composer's code: a changed piece is composed again."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def composed_file(name: str, cache_dir: Path) -> Path:
    """Return the sound file of a piece, composed if the cache has none.

    The file is `cache_dir`/VERSION/NAME.flac: the folder holds nothing but pieces and can be used
    like any folder of recordings.

    Raises:
        ToolError: There is no such piece.
    """
    path = cache_dir / code_version() / f"{name}.flac"
    if not path.is_file():
        samples = compose(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_name(f".{name}-{os.getpid()}.part")
        soundfile.write(part, samples, RATE_HZ, format="FLAC", subtype="PCM_16")
        part.replace(path)  # whole or not at all, also when two shows start at once
    return path


def composed_recording(name: str, cache_dir: Path) -> Recording:
    """Return a piece as a recording (16 bit, as everybody hears it).

    Raises:
        ToolError: There is no such piece.
    """
    return load_recording(composed_file(name, cache_dir))
