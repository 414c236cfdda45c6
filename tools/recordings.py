"""Catalogues made of a folder of recordings: tempo, sections with skills, fingerprint index."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from downbeat.catalog.beatgrid import BeatGrid
from downbeat.catalog.tracks import Track, load_tracks
from downbeat.perception.beats import GRID_FORMAT, estimate_grid
from downbeat.perception.errors import PerceptionError
from downbeat.perception.index import Index
from downbeat.perception.index_file import VERSION, features_fingerprint
from downbeat.perception.likeness_build import LIKENESS_NAME, build_likeness
from downbeat.perception.likeness_embedded import EmbeddedDescriptor
from downbeat.perception.source import Recording, audio_files, load_recording
from downbeat.perception.timeline import tempo_octave
from downbeat.policies.manifest import load_skills
from downbeat.tools.rundir import CACHE_DIR

INDEX_NAME = "index.bin"

Say = Callable[[str], None]


@dataclass(frozen=True)
class Library:
    """A folder of recordings, analysed.

    Attributes:
        tracks: By name; rules assign skills.
        recordings: By name.
        folder: Holds NAME.toml and index.bin.
    """

    tracks: dict[str, Track]
    recordings: dict[str, Recording]
    folder: Path


def build_library(
    audio_folder: Path,
    out: Path,
    skills: Sequence[str],
    seed: int,
    rules: Path | None = None,
    say: Say = print,
) -> Library:
    """Analyse every recording of a folder.

    Args:
        audio_folder: wav, flac, ogg, mp3.
        out: Receives the track files and the index.
        skills: Dances to assign, if there is no rules folder.
        seed: Of the assignment.
        rules: Folder of track files to use instead; each names its audio.
        say: Progress.

    Raises:
        DownbeatError: No recording, or a wrong rules file.
    """
    out.mkdir(parents=True, exist_ok=True)
    recordings: dict[str, Recording] = {}
    for path in audio_files(audio_folder):
        try:
            recordings[path.stem] = load_recording(path)
        except PerceptionError as error:
            say(f"left out: {error}")
    if not recordings:
        raise PerceptionError(f"{audio_folder} holds no recording that can be read.")
    grids = {name: cached_grid(r, say) for name, r in recordings.items()}
    if rules is not None:
        tracks = load_tracks(rules, skills)
        recordings = {n: _own_audio(t, recordings) for n, t in tracks.items()}
        for path in rules.glob("*.toml"):
            shutil.copy(path, out / path.name)
    else:
        tracks = assign_skills(recordings, grids, skills, seed)
        for track in tracks.values():
            write_track(out / f"{track.name}.toml", track)
    build_index(recordings, out / INDEX_NAME)
    return Library(tracks, recordings, out)


def _own_audio(track: Track, recordings: Mapping[str, Recording]) -> Recording:
    if track.audio is not None:
        return load_recording(track.audio)
    if track.name not in recordings:
        raise PerceptionError(f"Track '{track.name}' has no recording ({track.where}:audio).")
    return recordings[track.name]


def cached_grid(recording: Recording, say: Say) -> BeatGrid:
    """Return the beat grid; analysing takes seconds, so it is cached by content."""
    digest = hashlib.sha256(recording.samples.tobytes() + bytes([GRID_FORMAT]))
    cached = CACHE_DIR / "grids" / f"{digest.hexdigest()[:24]}.npz"
    if cached.is_file():
        with np.load(cached) as data:
            bpm, first = (float(v) for v in data["tempo"])
            return BeatGrid(bpm, first, beat_times_s=tuple(float(t) for t in data["times"]))
    say(f"finding the beats of {recording.name}")
    grid = estimate_grid(recording.samples, recording.sample_rate_hz)
    cached.parent.mkdir(parents=True, exist_ok=True)
    tempo = np.array([grid.tempo_bpm, grid.first_beat_s])
    np.savez(cached, tempo=tempo, times=np.array(grid.beat_times_s))
    return grid


def assign_skills(
    recordings: Mapping[str, Recording],
    grids: Mapping[str, BeatGrid],
    skills: Sequence[str],
    seed: int,
) -> dict[str, Track]:
    """Give every track the next skill of a shuffled list that fits its tempo, one skill a track.

    A skill fits when it is certified for the tempo, halved or doubled if need be. Timed
    rules inside a track are a person's to write: they need an ear for its sections, and many
    recordings repeat passages bit for bit, which no listener can tell apart.
    """
    durations = {name: recording.duration_s for name, recording in recordings.items()}
    return choose_skills(durations, grids, skills, seed)


def choose_skills(
    durations: Mapping[str, float],
    grids: Mapping[str, BeatGrid],
    skills: Sequence[str],
    seed: int,
    taken: Sequence[str] = (),
) -> dict[str, Track]:
    """Do as `assign_skills`, knowing only how long the tracks are.

    Args:
        durations: By name [s].
        grids: By name.
        skills: To choose from.
        seed: Of the order.
        taken: Skills that other tracks have already; they come last.
    """
    rng = np.random.default_rng(seed)
    order = [str(s) for s in rng.permutation(list(skills))]
    ranges = {name: manifest.tempo_range_bpm for name, manifest in load_skills().items()}
    tracks, bag = {}, [skill for skill in order if skill not in taken] or list(order)
    for name, duration_s in durations.items():
        bpm = grids[name].tempo_bpm
        fitting = [s for s in (*bag, *order) if fits_tempo(bpm, ranges.get(s, (0.0, 0.0)))]
        skill = fitting[0] if fitting else (*bag, *order)[0]
        if skill in bag:
            bag.remove(skill)
        tracks[name] = Track(name, skill, grids[name], title=name, duration_s=duration_s)
        bag = bag or list(order)
    return tracks


def fits_tempo(bpm: float, wanted: tuple[float, float]) -> bool:
    """Whether a tempo, halved or doubled if need be, lies in a range; (0, 0): any does."""
    low, high = wanted
    return high <= 0.0 or low <= bpm * tempo_octave(bpm, wanted) <= high


def write_track(path: Path, track: Track) -> None:
    """Write a track file that `load_tracks` reads."""
    rows = [
        f"name = {_text(track.name)}",
        f"title = {_text(track.title)}",
        f"composition = {_text(track.composition or track.name)}",
        f"duration_s = {track.duration_s!r}",
        f"tempo_bpm = {track.grid.tempo_bpm!r}",
        f"first_beat_s = {track.grid.first_beat_s!r}",
        f"beats_per_bar = {track.grid.beats_per_bar}",
        f"default_skill = {_text(track.default_skill)}",
    ]
    if track.grid.beat_times_s:
        rows.append(f"beat_times_s = {list(track.grid.beat_times_s)!r}")
    for rule in track.rules:
        rows += ["", "[[section]]", f"start_s = {rule.start_s!r}", f"end_s = {rule.end_s!r}"]
        rows += [f"name = {_text(rule.name)}", f"skill = {_text(rule.skill)}"]
    temporary = path.with_name(f".{path.name}.part")  # not *.toml: a reader sees whole files
    temporary.write_text("\n".join(rows) + "\n", encoding="utf-8")
    temporary.replace(path)


def _text(value: str) -> str:
    """Return a TOML string; JSON escapes are a subset of TOML's."""
    return json.dumps(value, ensure_ascii=False)


def build_index(recordings: Mapping[str, Recording], path: Path) -> None:
    """Index single tracks, and what each sounds like, beside it.

    Both are cached by content, because a show indexes the same tracks again.
    """
    digest = hashlib.sha256(f"{VERSION} {features_fingerprint()}".encode())
    for name, recording in recordings.items():
        digest.update(name.encode() + recording.samples.tobytes())
    cached = CACHE_DIR / "indexes" / f"{digest.hexdigest()[:24]}.bin"
    if not cached.is_file():
        index = Index()
        for name, recording in recordings.items():
            index.add(name, recording.samples, recording.sample_rate_hz)
        cached.parent.mkdir(parents=True, exist_ok=True)
        index.save(cached)
    shutil.copy(cached, path)
    # Made by another embedder, the table is made anew; else it is there already.
    likeness = cached.with_suffix(f".{EmbeddedDescriptor().digest}.npz")
    if not likeness.is_file():
        build_likeness(recordings, likeness)
    shutil.copy(likeness, path.with_name(LIKENESS_NAME))


def with_duration(track: Track, recording: Recording) -> Track:
    """Return the track with the length of its recording."""
    return replace(track, duration_s=recording.duration_s)
