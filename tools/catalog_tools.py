"""`downbeat catalog`: build, match, show."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from downbeat.catalog.tracks import BUNDLED_TRACKS, load_tracks
from downbeat.perception.matcher import AlignmentMatcher
from downbeat.perception.source import load_recording
from downbeat.tools.errors import ToolError
from downbeat.tools.eval_mashup import dance_names, say
from downbeat.tools.recordings import INDEX_NAME, build_library, duplicates


def build(audio: Path, out: Path, seed: int) -> int:
    """Make a catalogue of a folder of recordings."""
    library = build_library(audio, out, dance_names(), seed, say=say)
    for one, other in duplicates(library.recordings):
        print(
            f"'{one}' and '{other}' hold the same recording: a listener cannot tell them apart; "
            "take one of them out."
        )
    print(f"{out}: {len(library.tracks)} tracks; give them sections in their TOML files")
    return show(out)


def match(index: Path, audio: Path, at_s: float, seconds: float, as_json: bool = False) -> int:
    """Ask what a recording is; 0 if accepted.

    Raises:
        ToolError: The window does not fit the recording.
        PerceptionError: No index there, or no recording.
    """
    recording = load_recording(audio)
    rate, length_s = recording.sample_rate_hz, recording.duration_s
    seconds = min(seconds, length_s) if at_s == 0.0 else seconds
    if not 1.0 <= seconds <= 10.0 or not 0.0 <= at_s <= length_s - seconds + 1e-6:
        raise ToolError(
            f"A window of {seconds:g} s at {at_s:g} s does not fit {audio} ({length_s:.1f} s); "
            "valid lengths are 1 to 10 s, within the recording."
        )
    window = recording.samples[round(at_s * rate) : round((at_s + seconds) * rate)]
    path = index / INDEX_NAME if index.is_dir() else index
    result = AlignmentMatcher.load(path).query(window, rate)
    if as_json:
        print(json.dumps({name: _plain(value) for name, value in asdict(result).items()}))
        return 0 if result.accepted else 1
    verdict = "accepted" if result.accepted else "not accepted"
    print(
        f"{result.track or 'nothing'} at {result.tau_s:.3f} s, rate {result.rate:.2f}, "
        f"score {result.confidence:.2f} ({verdict}), similarity {result.similarity:.2f}, "
        f"runner-up {result.runner_up or '-'} {result.runner_up_confidence:.2f}"
    )
    return 0 if result.accepted else 1


def _plain(value: object) -> object:
    return round(float(value), 4) if isinstance(value, float) else value


def show(catalog: Path | None) -> int:
    """Print tracks and their sections."""
    table = Table("track", "tempo", "from", "to", "section", "skill")
    for track in load_tracks(catalog or BUNDLED_TRACKS).values():
        tempo = f"{track.grid.tempo_bpm:.1f}"
        table.add_row(track.name, tempo, "", "", "elsewhere", track.default_skill)
        for rule in track.rules:
            table.add_row("", "", f"{rule.start_s:.2f}", f"{rule.end_s:.2f}", rule.name, rule.skill)
    Console().print(table)
    return 0
