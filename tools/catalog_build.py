"""Catalogues kept up to date: only what is new or changed is analysed, what is gone is dropped."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from rich.console import Console
from rich.progress import track as progress

from downbeat.catalog.beatgrid import BeatGrid
from downbeat.catalog.tracks import Track, load_track
from downbeat.perception.errors import PerceptionError
from downbeat.perception.index import Index
from downbeat.perception.index_file import REMEDY
from downbeat.perception.passages import shared_among
from downbeat.perception.source import audio_files, load_recording
from downbeat.tools.errors import ToolError
from downbeat.tools.passages import update_passages
from downbeat.tools.recordings import INDEX_NAME, Say, cached_grid, choose_skills, write_track

REMOVED_SUFFIX = ".removed"
"""A track file whose recording is gone is kept under this name: its rules are a person's work."""


@dataclass
class Changes:
    """What an update did; names, sorted.

    Attributes:
        kept: Unchanged.
        made: New or changed.
        dropped: Gone.
        left_out: Why a file is no track, one sentence each.
    """

    kept: list[str] = field(default_factory=list)
    made: list[str] = field(default_factory=list)
    dropped: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)

    @property
    def is_empty(self) -> bool:
        """Nothing changed."""
        return not self.made and not self.dropped


@dataclass
class Analysed:
    """Recordings just analysed."""

    index: Index = field(default_factory=Index)
    grids: dict[str, BeatGrid] = field(default_factory=dict)
    durations: dict[str, float] = field(default_factory=dict)

    def add(self, path: Path, digest: str, say: Say) -> None:
        """Analyse one file.

        Raises:
            PerceptionError: It is no recording, or silent, or too short.
        """
        recording = load_recording(path)
        self.index.add(recording.name, recording.samples, recording.sample_rate_hz, digest)
        self.grids[recording.name] = cached_grid(recording, say)
        self.durations[recording.name] = recording.duration_s


def file_digest(path: Path) -> str:
    """Return a hash of a file's content."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest()


def index_path(where: Path) -> Path:
    """Return the index file of a catalogue folder, or the file itself."""
    return where / INDEX_NAME if where.is_dir() else where


def update_catalog(
    audio: Path, out: Path, skills: Sequence[str], seed: int, say: Say, is_quiet: bool = False
) -> tuple[Index, Changes]:
    """Make the catalogue in a folder that of the recordings in another.

    The index is the same, bit for bit, as one built from nothing. Track files of recordings that
    did not change stay as they are; of changed ones skill and rules stay, and the beats are new.

    Args:
        audio: wav, flac, ogg, mp3.
        out: Receives NAME.toml per track and the index.
        skills: Dances to assign to new tracks.
        seed: Of the assignment.
        say: Progress, and what is left out.
        is_quiet: Show no progress bar.

    Raises:
        DownbeatError: No recording; a track file is wrong.
    """
    out.mkdir(parents=True, exist_ok=True)
    old = _old_index(out / INDEX_NAME, say)
    known = dict(zip(old.names, old.sources))
    # Of an index that cannot be read the track files tell what was in it.
    is_lost = not old.names and (out / INDEX_NAME).is_file()
    before = {path.stem for path in out.glob("*.toml")} if is_lost else set(known)
    changes, analysed, seen = Changes(), Analysed(), set()
    console = Console(stderr=True)
    files = audio_files(audio)
    for path in progress(files, "catalogue", console=console, transient=True, disable=is_quiet):
        name = path.stem
        try:
            if name in seen:
                raise PerceptionError(
                    f"{path} has the name of another recording; tracks are named after their files."
                )
            digest = file_digest(path)
            if known.get(name) == digest and (out / f"{name}.toml").is_file():
                changes.kept.append(name)
            else:
                analysed.add(path, digest, say)
                changes.made.append(name)
            seen.add(name)
        except PerceptionError as error:
            changes.left_out.append(str(error))
    if not seen:
        raise PerceptionError(f"{audio} holds no recording that can be used: {changes.left_out[0]}")
    changes.dropped = sorted(before - seen)
    index = join_tracks({**_tracks(old, changes.kept), **_tracks(analysed.index, changes.made)})
    index.shared = old.shared
    if not changes.is_empty or old.shared is None or not (out / INDEX_NAME).is_file():
        index.shared = update_passages(index, changes.made)
        _write_tracks(out, analysed, skills, seed)
        index.save(out / INDEX_NAME)
        for name in changes.dropped:
            _put_aside(out, name)
    return index, changes


def add_track(
    where: Path, audio: Path, skills: Sequence[str], seed: int, say: Say
) -> tuple[Index, Changes]:
    """Add one recording to a catalogue, or take its new content.

    Args:
        where: Folder of the catalogue, or its index alone.
        audio: Recording.
        skills: Dances to assign.
        seed: Of the assignment.
        say: Progress.

    Raises:
        PerceptionError: No index, or no recording.
    """
    path = index_path(where)
    old = Index.load(path)
    analysed, digest = Analysed(), file_digest(audio) if audio.is_file() else ""
    if dict(zip(old.names, old.sources)).get(audio.stem) == digest:
        return old, Changes(kept=list(old.names))
    analysed.add(audio, digest, say)
    kept = [name for name in old.names if name != audio.stem]
    index = join_tracks({**_tracks(old, kept), **_tracks(analysed.index, [audio.stem])})
    index.shared = old.shared
    index.shared = update_passages(index, [audio.stem])
    if where.is_dir():
        _write_tracks(where, analysed, skills, seed)
    index.save(path)
    return index, Changes(kept=kept, made=[audio.stem])


def remove_track(where: Path, name: str) -> tuple[Index, Changes]:
    """Take one track out of a catalogue.

    Raises:
        ToolError: There is no such track, or no other.
        PerceptionError: No index.
    """
    path = index_path(where)
    old = Index.load(path)
    if name not in old.names:
        some = ", ".join(old.names[:10]) + (" ..." if len(old.names) > 10 else "")
        if (stem := Path(name).stem) in old.names:
            some = f"'{stem}', named without the ending of its file"
        raise ToolError(f"{path} holds no track '{name}'; it holds {some}.")
    kept = [other for other in old.names if other != name]
    if not kept:
        raise ToolError(f"'{name}' is the only track of {path}; delete the catalogue instead.")
    index = join_tracks(_tracks(old, kept))
    index.shared = None if old.shared is None else shared_among(old.shared, kept)
    index.save(path)
    if where.is_dir():
        _put_aside(where, name)
    return index, Changes(kept=kept, dropped=[name])


def join_tracks(tracks: Mapping[str, tuple[Index, int]]) -> Index:
    """Return an index of tracks of other indexes, in the order of their names."""
    out = Index()
    chosen = [(name, *tracks[name]) for name in sorted(tracks)]
    out.names = [name for name, _, _ in chosen]
    out.sources = [index.sources[number] for _, index, number in chosen]
    out.fine = [index.fine[number] for _, index, number in chosen]
    out.coarse = [index.coarse[number] for _, index, number in chosen]
    out.power = [index.power[number] for _, index, number in chosen]
    out.landmarks = [index.all_landmarks()[number] for _, index, number in chosen]
    return out


def _tracks(index: Index, names: Sequence[str]) -> dict[str, tuple[Index, int]]:
    numbers = {name: number for number, name in enumerate(index.names)}
    return {name: (index, numbers[name]) for name in names}


def _old_index(path: Path, say: Say) -> Index:
    """Return the index that is there; an empty one if it cannot be used."""
    if not path.exists():
        return Index()
    try:
        return Index.load(path)
    except PerceptionError as error:
        why = str(error).removesuffix(f"; {REMEDY}.")
        say(f"{why}; everything is analysed again.")
        return Index()


def _write_tracks(out: Path, analysed: Analysed, skills: Sequence[str], seed: int) -> None:
    """Write the track files of recordings just analysed; skill and rules of old ones stay."""
    old: dict[str, Track] = {}
    for name in analysed.grids:
        path, aside = out / f"{name}.toml", out / f"{name}.toml{REMOVED_SUFFIX}"
        if not path.is_file() and aside.is_file():
            aside.replace(path)
    for path in sorted(out.glob("*.toml")):
        old[path.stem] = load_track(path)
    fresh = {n: s for n, s in analysed.durations.items() if n not in old}
    taken = [track.default_skill for track in old.values()]
    tracks = choose_skills(fresh, analysed.grids, skills, seed, taken)
    for name, duration_s in analysed.durations.items():
        if name in old:
            grid = analysed.grids[name]
            tracks[name] = replace(old[name], grid=grid, duration_s=duration_s)
        write_track(out / f"{name}.toml", tracks[name])


def _put_aside(out: Path, name: str) -> None:
    path = out / f"{name}.toml"
    if path.is_file():
        path.replace(path.with_name(path.name + REMOVED_SUFFIX))
