"""What the tracks of a catalogue sound like, kept up to date beside its index."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from downbeat.perception.errors import PerceptionError
from downbeat.perception.likeness import Embedder
from downbeat.perception.likeness_build import LIKENESS_NAME, embed_recording, sound_digest
from downbeat.perception.likeness_embedded import EmbeddedDescriptor
from downbeat.perception.likeness_store import LikenessTable
from downbeat.perception.source import load_recording
from downbeat.tools.recordings import Say


def choose_embedder(clap: Path | None) -> Embedder:
    """Return an exported CLAP, or the embedded descriptor for None.

    Raises:
        PerceptionError: The folder holds no exported CLAP.
    """
    if clap is None:
        return EmbeddedDescriptor()
    from downbeat.perception.clap_model import ClapEmbedder

    return ClapEmbedder(clap)


def update_likeness(
    index: Path,
    names: Sequence[str],
    made: Collection[str],
    files: Mapping[str, Path],
    embedder: Embedder,
    say: Say,
) -> LikenessTable:
    """Write the table of a catalogue; only what is new, changed or unknown is heard.

    Args:
        index: The index file; the table lies beside it.
        names: All tracks.
        made: Those that are new or changed.
        files: Recordings that are at hand, by track.
        embedder: Tables of another one are made anew.
        say: Told which tracks have no likeness.
    """
    path = index.with_name(LIKENESS_NAME)
    old = _old_table(path, embedder)
    known = dict(zip(old.names, zip(old.sounds, old.vectors)))
    table = LikenessTable(embedder.digest)
    for name in names:
        sound, vectors = known.get(name, ("", None)) if name not in made else ("", None)
        if vectors is None and name in files:
            recording = load_recording(files[name])
            sound, vectors = sound_digest(recording), embed_recording(embedder, recording)
        if vectors is None:
            say(f"'{name}' has no likeness: unknown music is never compared with it")
            continue
        table.names.append(name)
        table.sounds.append(sound)
        table.vectors.append(vectors)
    table.save(path)
    return table


def _old_table(path: Path, embedder: Embedder) -> LikenessTable:
    try:
        table = LikenessTable.load(path)
    except PerceptionError:
        return LikenessTable(embedder.digest)
    return table if table.embedder == embedder.digest else LikenessTable(embedder.digest)
