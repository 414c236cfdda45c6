"""`downbeat catalog`: build an index of tracks, match a recording, show rules."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True)
class Build:
    """Make a catalogue of a folder of recordings: tempo, beats, sections, fingerprint index."""

    audio: tyro.conf.Positional[Path]
    """Folder of audio files (wav, flac, ogg, mp3)."""
    out: Path = Path("my_catalog")
    """Folder that receives NAME.toml per track and index.bin."""
    seed: int = 0
    """Assigns skills to tracks; edit the TOML files to your taste afterwards."""

    def run(self) -> int:
        """Build it."""
        from downbeat.tools.catalog_tools import build

        return build(self.audio, self.out, self.seed)


@dataclass(frozen=True)
class Match:
    """Ask a catalogue what a recording is and where in the track it stands."""

    index: tyro.conf.Positional[Path]
    """Folder made by `downbeat catalog build`, or its index.bin."""
    audio: tyro.conf.Positional[Path]
    """Recording."""
    at: float = 0.0
    """Start of the window in the recording [s]."""
    seconds: float = 5.0
    """Length of the window [s]; a shorter recording is taken whole."""
    json: bool = False
    """Print track, tau_s, confidence, votes, rate, accepted and more as one JSON object."""

    def run(self) -> int:
        """Match; 0 if accepted."""
        from downbeat.tools.catalog_tools import match

        return match(self.index, self.audio, self.at, self.seconds, self.json)


@dataclass(frozen=True)
class Show:
    """Print the tracks of a catalogue with their sections and skills."""

    catalog: tyro.conf.Positional[Path | None] = None
    """Folder of track files; omitted: the bundled tracks."""

    def run(self) -> int:
        """Print."""
        from downbeat.tools.catalog_tools import show

        return show(self.catalog)


@dataclass(frozen=True)
class CatalogCommand:
    """Tracks: `build`, `match`, `show`."""

    what: (
        Annotated[Build, tyro.conf.subcommand("build")]
        | Annotated[Match, tyro.conf.subcommand("match")]
        | Annotated[Show, tyro.conf.subcommand("show")]
    )

    def run(self) -> int:
        """Run the chosen command."""
        return self.what.run()
