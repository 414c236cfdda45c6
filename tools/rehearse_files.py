"""What a show names and is not there, or does not fit: found before anything is simulated."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from downbeat.catalog.setlist import load_setlist
from downbeat.catalog.tracks import Track
from downbeat.perception.features import HOP_S
from downbeat.perception.index import PAD_FRAMES, Index
from downbeat.perception.source import load_recording
from downbeat.perception.source_spec import CHUNKS, MICROPHONE, ROBOT, VALID
from downbeat.runtime.errors import DownbeatError, one_of
from downbeat.tools.console import some
from downbeat.tools.hearing_parts import build_likeness, build_router
from downbeat.tools.show import (
    Show,
    show_atlas,
    show_hearing,
    show_proof,
    show_skills,
    show_speech,
    show_tracks,
)

MOST_NAMED = 5
ROUNDED_S = 0.2
"""A passage may end so much after its track: lengths are rounded, an index counts frames."""


class ShowFiles:
    """Everything that a show.toml names, looked at once."""

    def __init__(self, show: Show, path: Path) -> None:
        """Take the show, and its file for the sentences."""
        self._show, self._path = show, path
        self._tracks: dict[str, Track] = {}
        self._index = Index()

    def faults(self) -> list[str]:
        """Return one sentence, with file and key, for everything that is wrong."""
        checks = (
            self._missing, self._audio, self._catalogue, self._fingerprints, self._set_list,
            self._hearing, self._fallback, self._others,
        )  # fmt: skip
        return list(dict.fromkeys(sentence for check in checks for sentence in check()))

    def _at(self, said: object, key: str) -> str:
        """Return a sentence with the key of show.toml that it is about."""
        return _with_key(said, self._path, key)

    def _is_there(self, key: str) -> bool:
        """Return whether the show names something there, and that exists."""
        name = getattr(self._show.config, key)
        return bool(name) and self._show.path(name).exists()

    def _missing(self) -> Iterator[str]:
        for key in ("tracks", "set_list", "hearing", "speech"):
            name = getattr(self._show.config, key)
            if name and not self._is_there(key):
                path = self._show.path(name)
                yield self._at(f'{key} = "{name}" does not exist: there is no {path}', key)

    def _audio(self) -> Iterator[str]:
        """Hear a file once; whether a device is there shows on the evening, not now."""
        audio = self._show.config.audio
        if audio == CHUNKS or audio.startswith((MICROPHONE, ROBOT)):
            return
        file = self._show.path(audio)
        if not audio or not file.is_file():
            what = f"there is no file {file}" if audio else "it is empty"
            yield self._at(f'audio = "{audio}" cannot be heard: {what}; valid are {VALID}', "audio")
            return
        for sentence in _raised(load_recording, file):
            yield self._at(sentence, "audio")

    def _catalogue(self) -> Iterator[str]:
        if not self._is_there("tracks"):
            return
        try:
            self._tracks = show_tracks(self._show)
        except DownbeatError as error:
            yield str(error)

    def _fingerprints(self) -> Iterator[str]:
        """Map the index; does it have what the rules are for?"""
        config = self._show.config
        try:
            self._index = Index.load(self._show.path(config.index))
        except DownbeatError as error:
            yield self._at(error, "index")
            return
        if lacking := [repr(name) for name in self._tracks if name not in self._index.names]:
            yield self._at(
                f"{config.index} lacks {some(lacking, MOST_NAMED, ', ')} of {config.tracks}, so "
                "they would never be recognised; `downbeat catalog build` makes one of all",
                "index",
            )

    def _set_list(self) -> Iterator[str]:
        """Name every entry whose track, or whose passage in it, does not exist."""
        if not self._is_there("set_list") or not self._tracks:
            return
        file = self._show.path(self._show.config.set_list)
        try:
            entries = load_setlist(file).entries
        except DownbeatError as error:
            yield str(error)
            return
        for number, entry in enumerate(entries):
            where = f"{file}:set[{number}]"
            if entry.track not in self._tracks:
                yield (
                    f"Track '{entry.track}' is not in the catalogue; tracks are "
                    f"{one_of(self._tracks)} ({where}.track)."
                )
                continue
            length_s, end_s = self._length_s(entry.track), entry.from_s + entry.seconds
            if entry.from_s >= length_s:
                yield (
                    f"The passage from {entry.from_s:g} s on does not exist in '{entry.track}'; "
                    f"valid are positions below {length_s:.1f} s, its length ({where}.from_s)."
                )
            elif end_s > length_s + ROUNDED_S:
                yield (
                    f"The passage of '{entry.track}' ends at {end_s:g} s and the track at "
                    f"{length_s:.1f} s; valid are {length_s - entry.from_s:.1f} seconds or less "
                    f"({where}.seconds)."
                )

    def _length_s(self, track: str) -> float:
        """Return the length of a track as its file or else the index has it [s]."""
        length_s = self._tracks[track].duration_s
        if length_s == float("inf") and track in self._index.names:
            frames = len(self._index.fine[self._index.names.index(track)]) - 2 * PAD_FRAMES
            return frames * HOP_S / 2.0
        return length_s

    def _hearing(self) -> Iterator[str]:
        """Load the models that hearing.toml names."""
        if self._show.config.hearing and not self._is_there("hearing"):
            return
        try:
            hearing = show_hearing(self._show)
        except DownbeatError as error:
            yield str(error)
            return
        folder, index = self._show.folder, self._show.path(self._show.config.index)
        file = self._show.path(self._show.config.hearing)
        for sentence in _raised(build_router, hearing, folder):
            yield _with_key(sentence, file, "router")
        for sentence in (
            _raised(build_likeness, hearing, folder, index) if self._index.names else ()
        ):
            yield _with_key(sentence, file, "likeness")

    def _fallback(self) -> Iterator[str]:
        try:
            name, skills = self._show.config.fallback, show_skills(self._show)
        except DownbeatError as error:
            yield str(error)
            return
        if name and name not in skills:
            yield self._at(
                f"The fallback skill '{name}' is unknown; skills are {one_of(skills)}", "fallback"
            )

    def _others(self) -> Iterator[str]:
        if self._is_there("speech"):
            yield from _raised(show_speech, self._show)
        for load in (show_proof, show_atlas):
            yield from _raised(load, self._show)


def _raised(load: Callable[..., object], *arguments: object) -> list[str]:
    """Return why something cannot be loaded; nothing if it can."""
    try:
        load(*arguments)
    except DownbeatError as error:
        return [str(error)]
    return []


def _with_key(said: object, file: Path, key: str) -> str:
    """Return a sentence with the key that it is about."""
    return f"{str(said).removesuffix('.')} ({file}:{key})."
