"""Set lists: which passages of which tracks follow each other; what makes cuts announced."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from downbeat.catalog.errors import CatalogError
from downbeat.runtime.config import load_config
from downbeat.runtime.errors import one_of


@dataclass(frozen=True, slots=True)
class SetEntry:
    """One passage: `seconds` of `track` from position `from_s` on."""

    track: str
    from_s: float
    seconds: float

    def __post_init__(self) -> None:
        if not (0.0 <= self.from_s < math.inf and 0.0 < self.seconds < math.inf):
            raise ValueError(
                f"from_s is {self.from_s} and seconds is {self.seconds}, "
                "valid are from_s >= 0 and seconds > 0"
            )


@dataclass(frozen=True, slots=True)
class SetList:
    """Passages that follow each other without a gap."""

    entries: tuple[SetEntry, ...]

    def starts_s(self) -> list[float]:
        """Return the show time at which each entry starts [s]."""
        starts, at = [], 0.0
        for entry in self.entries:
            starts.append(at)
            at += entry.seconds
        return starts

    def to_toml(self) -> str:
        """Return the set list as TOML."""
        rows = [
            f"[[set]]\ntrack = {json.dumps(e.track, ensure_ascii=False)}\n"
            f"from_s = {e.from_s!r}\nseconds = {e.seconds!r}\n"
            for e in self.entries
        ]
        return "\n".join(rows)


@dataclass(frozen=True, slots=True)
class _SetFile:
    """What the file holds."""

    set: tuple[SetEntry, ...]


def load_setlist(path: Path, tracks: Iterable[str] | None = None) -> SetList:
    """Read a set list.

    Args:
        path: The file, [[set]] tables of track, from_s, seconds.
        tracks: If given, every entry must name one of these.

    Raises:
        DownbeatError: Missing, wrong keys or values, or a track that is not in the catalogue.
    """
    entries = load_config(path, _SetFile).set
    if not entries:
        raise CatalogError(f"{path} has no [[set]] entry (set).")
    known = None if tracks is None else set(tracks)
    for number, entry in enumerate(entries):
        if known is not None and entry.track not in known:
            raise CatalogError(
                f"Track '{entry.track}' is not in the catalogue; tracks are {one_of(known)} "
                f"({path}:set[{number}].track)."
            )
    return SetList(entries)
