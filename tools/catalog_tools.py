"""`downbeat catalog`: build, add, remove, match, show."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from downbeat.catalog.tracks import BUNDLED_TRACKS, load_tracks, unknown_skills
from downbeat.perception.constellation import ConstellationMatcher
from downbeat.perception.index import Index
from downbeat.perception.matcher import AlignmentMatcher, MusicMatcher
from downbeat.perception.source import audio_files, load_recording
from downbeat.policies.manifest import load_skills
from downbeat.runtime.errors import one_of
from downbeat.tools.catalog_build import (
    Changes,
    add_track,
    index_path,
    remove_track,
    update_catalog,
)
from downbeat.tools.catalog_likeness import choose_embedder, update_likeness
from downbeat.tools.console import some
from downbeat.tools.duplicates import find_duplicates
from downbeat.tools.errors import ToolError
from downbeat.tools.eval_mashup import dance_names, say
from downbeat.tools.recordings import INDEX_NAME

MOST_NAMED = 20
WINDOW_S = (1.0, 10.0)
"""Shortest and longest window that a catalogue is asked with [s]."""
MATCHERS: dict[str, type[AlignmentMatcher] | type[ConstellationMatcher]] = {
    "alignment": AlignmentMatcher,
    "constellation": ConstellationMatcher,
}


def build(audio: Path, out: Path, seed: int, clap: Path | None = None) -> int:
    """Make or update the catalogue of a folder of recordings."""
    embedder = choose_embedder(clap)
    is_quiet = not sys.stderr.isatty()
    index, changes = update_catalog(audio, out, dance_names(), seed, say, is_quiet)
    files = {path.stem: path for path in audio_files(audio)}
    update_likeness(out / INDEX_NAME, index.names, changes.made, files, embedder, say)
    for reason in changes.left_out:
        say(f"left out: {reason}")
    duplicates = find_duplicates(index)
    for one, other in duplicates:
        print(
            f"'{one}' and '{other}' hold the same recording: a listener cannot tell them apart; "
            "take one of them out."
        )
    print(f"{out}: {_summary(index, changes)}; give them sections in their TOML files")
    if changes.dropped:
        names = some(changes.dropped, MOST_NAMED, ", ")
        print(f"dropped, as {audio} holds no such recording; their rules are put aside: {names}")
    return show(out, duplicates)


def add(where: Path, audio: Path, seed: int) -> int:
    """Add one recording to a catalogue."""
    index, changes = add_track(where, audio, dance_names(), seed, say)
    files = {audio.stem: audio}
    update_likeness(index_path(where), index.names, changes.made, files, choose_embedder(None), say)
    duplicates = find_duplicates(index) if changes.made else []
    for one, other in duplicates:
        if audio.stem in (one, other):
            print(f"'{one}' and '{other}' hold the same recording; take one of them out.")
    if changes.made:
        _say_shared(index, duplicates, audio.stem)
    print(f"{where}: {_summary(index, changes)}")
    return 0


def remove(where: Path, name: str) -> int:
    """Take one track out of a catalogue."""
    index, changes = remove_track(where, name)
    update_likeness(index_path(where), index.names, (), {}, choose_embedder(None), say)
    print(f"{where}: {_summary(index, changes)}")
    return 0


def _say_shared(index: Index, duplicates: Sequence[tuple[str, str]] = (), about: str = "") -> None:
    """Name passages that two tracks share; copies are named as such."""
    named = [
        passage
        for passage in index.shared or ()
        if (passage.one, passage.other) not in duplicates
        and about in ("", passage.one, passage.other)
    ]
    for passage in named[:MOST_NAMED]:
        print(f"{passage.text()}: a listener waits there for what tells them apart.")
    if len(named) > MOST_NAMED:
        print(f"... and {len(named) - MOST_NAMED} more passages that two tracks share.")


def _summary(index: Index, changes: Changes) -> str:
    count = len(index.names)
    return (
        f"{count} track{'' if count == 1 else 's'} ({len(changes.made)} new or changed, "
        f"{len(changes.kept)} as they were, {len(changes.dropped)} dropped)"
    )


def match(
    index: Path, audio: Path, at_s: float, seconds: float, as_json: bool, matcher: str
) -> int:
    """Ask what a recording is; 0 if accepted. What is left after `at_s` is taken whole if shorter.

    Raises:
        ToolError: The window does not fit the recording.
        PerceptionError: No index there, or no recording.
    """
    recording = load_recording(audio)
    rate, length_s = recording.sample_rate_hz, recording.duration_s
    _check_window(audio, length_s, at_s, seconds)
    window = recording.samples[round(at_s * rate) : round((at_s + seconds) * rate)]
    if len(window) < round(seconds * rate):
        say(f"{audio} ends after {len(window) / rate:.1f} s of the window: it is asked with these.")
    asked: MusicMatcher = MATCHERS[matcher].load(index_path(index))
    result = asked.query(window, rate)
    if as_json:
        print(json.dumps({name: _plain(value) for name, value in asdict(result).items()}))
        return 0 if result.accepted else 1
    verdict = "accepted" if result.accepted else "not accepted"
    for twin, tau_s in result.twins:
        verdict += f": '{twin}' holds the same passage at {tau_s:.2f} s"
    if result.repeats:
        places = some([f"{tau_s:.2f}" for tau_s in result.repeats], MOST_NAMED, ", ")
        verdict += f"; the track repeats it at {places} s"
    print(
        f"{result.track or 'nothing'} at {result.tau_s:.3f} s, rate {result.rate:.2f}, "
        f"score {result.confidence:.2f} ({verdict}), {result.votes} votes, "
        f"similarity {result.similarity:.2f}, "
        f"runner-up {result.runner_up or '-'} {result.runner_up_confidence:.2f}"
    )
    return 0 if result.accepted else 1


def _check_window(audio: Path, length_s: float, at_s: float, seconds: float) -> None:
    """Refuse a window that a recording of this length does not have.

    Raises:
        ToolError: Its length is not possible, or hardly anything is left after its start.
    """
    shortest_s, longest_s = WINDOW_S
    if not shortest_s <= seconds <= longest_s:
        raise ToolError(
            f"--seconds {seconds:g} is no length of a window; valid are {shortest_s:g} to "
            f"{longest_s:g} s."
        )
    last_s = int((length_s - shortest_s) * 10.0) / 10.0  # never rounded up to what is refused
    if length_s < shortest_s:
        raise ToolError(
            f"{audio} lasts {length_s:.2f} s; valid are recordings of {shortest_s:g} s or more."
        )
    if not 0.0 <= at_s <= length_s - shortest_s:
        where = "beyond the end of" if at_s > length_s else "no start of a window in"
        raise ToolError(
            f"--at {at_s:g} s is {where} {audio}, which lasts {length_s:.1f} s; valid are 0 to "
            f"{last_s:.1f} s."
        )


def _plain(value: object) -> object:
    return round(float(value), 4) if isinstance(value, float) else value


def show(
    catalog: Path | None,
    duplicates: Sequence[tuple[str, str]] = (),
    imported: Path | None = None,
) -> int:
    """Print tracks, their sections, and the passages that two share, without pairs of copies.

    Skills that no skill's folder has are named; those of `imported` count as well.
    """
    if catalog is not None and catalog.is_file():
        catalog = catalog.parent  # its index was named
    tracks = load_tracks(catalog or BUNDLED_TRACKS)
    table = Table("track", "tempo", "from", "to", "section", "skill")
    for track in tracks.values():
        tempo = f"{track.grid.tempo_bpm:.1f}"
        table.add_row(track.name, tempo, "", "", "elsewhere", track.default_skill)
        for rule in track.rules:
            table.add_row("", "", f"{rule.start_s:.2f}", f"{rule.end_s:.2f}", rule.name, rule.skill)
    Console().print(table)
    known = {*load_skills(), *(load_skills(imported) if imported else ())}
    unknown = [found for track in tracks.values() for found in unknown_skills(track, known)]
    for skill, where in unknown:
        print(f"Skill '{skill}' does not exist, so no show can play it ({where}).")
    if unknown:
        print(f"Skills are {one_of(known)}; more of your own: --imported FOLDER.")
    if catalog is not None and (catalog / INDEX_NAME).is_file():
        _say_shared(Index.load(catalog / INDEX_NAME), duplicates)
    return 0
