"""`downbeat catalog`: build an index of tracks, add, remove, match a recording, show rules."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class Build:
    """Make or update the catalogue of a folder: tempo, beats, sections, fingerprint index.

    Only new and changed files are analysed; tracks whose file is gone are dropped.
    """

    audio: tyro.conf.Positional[Path]
    """Folder of audio files (wav, flac, ogg, mp3)."""
    out: Path = Path("my_catalog")
    """Folder that receives NAME.toml per track and index.bin."""
    seed: int = 0
    """Assigns skills to tracks; edit the TOML files to your taste afterwards."""
    clap: Path | None = None
    """Folder of `downbeat models export clap`, which then says what tracks sound like."""

    def run(self) -> int:
        """Build it."""
        from downbeat.tools.catalog_tools import build

        return build(self.audio, self.out, self.seed, self.clap)


@dataclass(frozen=True)
class Add:
    """Add one recording to a catalogue, or take its new content."""

    index: tyro.conf.Positional[Path]
    """Folder made by `downbeat catalog build`, or its index.bin."""
    audio: tyro.conf.Positional[Path]
    """Recording; the track has its file's name."""
    seed: int = 0
    """Assigns a skill."""

    def run(self) -> int:
        """Add it."""
        from downbeat.tools.catalog_tools import add

        return add(self.index, self.audio, self.seed)


@dataclass(frozen=True)
class Remove:
    """Take one track out of a catalogue; its TOML file is put aside as NAME.toml.removed."""

    index: tyro.conf.Positional[Path]
    """Folder made by `downbeat catalog build`, or its index.bin."""
    name: tyro.conf.Positional[str]
    """Track."""

    def run(self) -> int:
        """Remove it."""
        from downbeat.tools.catalog_tools import remove

        return remove(self.index, self.name)


@dataclass(frozen=True)
class Match:
    """Ask a catalogue what a recording is and where in the track it stands."""

    index: tyro.conf.Positional[Path]
    """Folder made by `downbeat catalog build`, or its index.bin."""
    audio: tyro.conf.Positional[Path]
    """Recording."""
    at: float = 0.0
    """Start of the window in the recording [s], 1 s or more before its end."""
    seconds: float = 5.0
    """Length of the window [s], 1 to 10; a shorter rest of the recording is taken whole."""
    matcher: Literal["alignment", "constellation"] = "alignment"
    """Alignment of whitened spectra, or Wang's landmarks (confidence from 0 to 1)."""
    json: bool = False
    """Print track, tau_s, confidence, votes, rate, accepted and more as one JSON object."""

    def run(self) -> int:
        """Match; 0 if accepted."""
        from downbeat.tools.catalog_tools import match

        return match(self.index, self.audio, self.at, self.seconds, self.json, self.matcher)


@dataclass(frozen=True)
class Show:
    """Print the tracks of a catalogue with their sections and skills, and skills that are none."""

    catalog: tyro.conf.Positional[Path | None] = None
    """Folder of track files; omitted: the bundled tracks."""
    imported: Path | None = None
    """Folder of further skills (downbeat policy import) that rules may name."""

    def run(self) -> int:
        """Print."""
        from downbeat.tools.catalog_tools import show

        return show(self.catalog, imported=self.imported)


@dataclass(frozen=True)
class CatalogCommand:
    """Tracks: `build`, `add`, `remove`, `match`, `show`."""

    what: (
        Annotated[Build, tyro.conf.subcommand("build")]
        | Annotated[Add, tyro.conf.subcommand("add")]
        | Annotated[Remove, tyro.conf.subcommand("remove")]
        | Annotated[Match, tyro.conf.subcommand("match")]
        | Annotated[Show, tyro.conf.subcommand("show")]
    )

    def run(self) -> int:
        """Run the chosen command."""
        return self.what.run()
