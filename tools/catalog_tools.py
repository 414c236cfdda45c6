"""`downbeat catalog`: build, match, show."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.table import Table

from downbeat.catalog.tracks import BUNDLED_TRACKS, load_tracks
from downbeat.perception.matcher import AlignmentMatcher
from downbeat.perception.source import load_recording
from downbeat.tools.errors import ToolError
from downbeat.tools.eval_mashup import dance_names, say
from downbeat.tools.recordings import INDEX_NAME, build_library


def build(audio: Path, out: Path, seed: int) -> int:
    """Make a catalogue of a folder of recordings."""
    library = build_library(audio, out, dance_names(), seed, say=say)
    print(f"{out}: {len(library.tracks)} tracks; give them sections in their TOML files")
    return show(out)


def match(audio: Path, catalog: Path, at_s: float, seconds: float) -> int:
    """Ask what a recording is; 0 if accepted."""
    recording = load_recording(audio)
    rate = recording.sample_rate_hz
    if not 1.2 <= seconds <= 10.0 or not 0.0 <= at_s <= recording.duration_s - seconds:
        raise ToolError(
            f"A window of {seconds} s at {at_s} s does not fit {audio} "
            f"({recording.duration_s:.1f} s); valid lengths are 1.2 to 10 s."
        )
    window = recording.samples[round(at_s * rate) : round((at_s + seconds) * rate)]
    result = AlignmentMatcher.load(catalog / INDEX_NAME).query(window, rate)
    verdict = "accepted" if result.accepted else "not accepted"
    print(
        f"{result.track or 'nothing'} at {result.tau_s:.3f} s, rate {result.rate:.2f}, "
        f"score {result.confidence:.2f} ({verdict}), similarity {result.similarity:.2f}, "
        f"runner-up {result.runner_up or '-'} {result.runner_up_confidence:.2f}"
    )
    return 0 if result.accepted else 1


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
