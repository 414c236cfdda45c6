"""Music of our own: four pieces, synthesised at first use, the same bytes every time."""

from __future__ import annotations

import hashlib
from pathlib import Path

import soundfile
from downbeat.runtime.errors import one_of
from downbeat.tools.errors import ToolError
from downbeat.tools.tunes.pieces import PIECES, Piece
from downbeat.tools.tunes.synth import RATE

__all__ = ["PIECES", "Piece", "render"]


def _digest() -> str:
    """Return a hash of the composer's sources: a changed piece is rendered again."""
    state = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        state.update(path.read_bytes())
    return state.hexdigest()[:12]


def render(name: str, cache_dir: Path) -> Path:
    """Return the sound file of a piece, synthesised if the cache has none.

    Raises:
        ToolError: There is no such piece.
    """
    if name not in PIECES:
        raise ToolError(f"Composition '{name}' is unknown; compositions are {one_of(PIECES)}.")
    path = cache_dir / f"{name}-{_digest()}.flac"
    if not path.is_file():
        cache_dir.mkdir(parents=True, exist_ok=True)
        piece = PIECES[name]
        temporary = path.with_suffix(".part")
        soundfile.write(temporary, piece.compose(piece), RATE, format="FLAC", subtype="PCM_16")
        temporary.replace(path)
    return path
