"""Likeness tables are built from recordings and loaded for a listener."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32
from downbeat.perception.likeness import CatalogLikeness, Embedder, is_sounding
from downbeat.perception.likeness_embedded import EmbeddedDescriptor
from downbeat.perception.likeness_store import LikenessTable
from downbeat.perception.source import Recording
from downbeat.policies.manifest import SkillManifest

LIKENESS_NAME = "likeness.npz"
"""Beside the index of the catalogue."""
OVERLAP = 2
"""Windows begin every half window."""
MAX_TRACK_WINDOWS = 64
"""Longer tracks are heard at this many places, evenly spread."""

Say = Callable[[str], None]


def build_likeness(
    recordings: Mapping[str, Recording],
    path: Path,
    embedder: Embedder | None = None,
    say: Say = lambda _line: None,
) -> LikenessTable:
    """Embed the tracks of a catalogue and write the table; unchanged tracks are taken from it.

    Args:
        recordings: By track name.
        path: The .npz file, usually `LIKENESS_NAME` beside the index.
        embedder: None: the embedded descriptor.
        say: Told of tracks that are left out: silent, or shorter than one window.
    """
    embedder = embedder or EmbeddedDescriptor()
    known = _known(path, embedder.digest)
    table = LikenessTable(embedder.digest)
    for name, recording in recordings.items():
        sound = sound_digest(recording)
        vectors = known.get(sound)
        if vectors is None:
            vectors = embed_recording(embedder, recording)
        if vectors is None:
            say(
                f"'{name}' has no likeness: silent, or shorter than {embedder.window_s:g} s; "
                "unknown music is never compared with it"
            )
            continue
        table.names.append(name)
        table.sounds.append(sound)
        table.vectors.append(vectors)
    table.save(path)
    return table


def load_likeness(
    path: Path,
    embedder: Embedder | None = None,
    skills: Mapping[str, Sequence[str]] | None = None,
) -> CatalogLikeness:
    """Load a table for queries.

    Args:
        path: As `build_likeness` wrote it.
        embedder: What built it; None: the embedded descriptor.
        skills: Sentences that describe each skill; only an embedder with words takes them.

    Raises:
        PerceptionError: The file is missing, damaged or of another embedder, or there are no words.
    """
    return CatalogLikeness(LikenessTable.load(path), embedder or EmbeddedDescriptor(), skills)


def skill_sentences(skills: Mapping[str, SkillManifest]) -> dict[str, list[str]]:
    """Return what music for each dance is called, from the phrases and descriptions of manifests.

    Skills without a tempo are no dances, and skills without words cannot be described: left out.
    """
    texts = {n: (*m.phrases, *m.descriptions) for n, m in skills.items() if m.bpm > 0}
    return {n: [f"music to dance to: {t}" for t in ts] for n, ts in texts.items() if ts}


def embed_recording(embedder: Embedder, recording: Recording) -> F32 | None:
    """Return the vectors of a whole track, (windows, dim), or None if it has no sound."""
    rate = recording.sample_rate_hz
    window = round(embedder.window_s * rate)
    last = len(recording.samples) - window
    if last < 0:
        return None
    count = min(MAX_TRACK_WINDOWS, 1 + last * OVERLAP // window)
    starts = np.linspace(0, last, count).astype(int)
    pieces = (recording.samples[s : s + window] for s in starts)
    vectors = [embedder.embed(piece, rate) for piece in pieces if is_sounding(piece)]
    return np.array(vectors, np.float32) if vectors else None


def sound_digest(recording: Recording) -> str:
    """Return a hash of the samples."""
    state = hashlib.sha256(f"{recording.sample_rate_hz}\0".encode())
    state.update(np.ascontiguousarray(recording.samples).tobytes())
    return state.hexdigest()[:32]


def _known(path: Path, embedder: str) -> dict[str, F32]:
    """Return vectors by sound of an older table, if there is a usable one."""
    try:
        table = LikenessTable.load(path)
    except PerceptionError:
        return {}
    return dict(zip(table.sounds, table.vectors)) if table.embedder == embedder else {}
