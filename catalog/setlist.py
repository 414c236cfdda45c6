"""Set lists: which passages of which tracks follow each other; what makes cuts announced."""

from __future__ import annotations

import tomllib
from collections.abc import Container
from dataclasses import dataclass
from pathlib import Path

from downbeat.catalog.errors import CatalogError


@dataclass(frozen=True, slots=True)
class SetEntry:
    """One passage: `seconds` of `track` from position `from_s` on."""

    track: str
    from_s: float
    seconds: float


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
            f'[[set]]\ntrack = "{e.track}"\nfrom_s = {e.from_s!r}\nseconds = {e.seconds!r}\n'
            for e in self.entries
        ]
        return "\n".join(rows)


def load_setlist(path: Path, tracks: Container[str] | None = None) -> SetList:
    """Read a set list.

    Raises:
        CatalogError: Missing, wrong keys or values, or a track that is not in the catalogue.
    """
    if not path.is_file():
        raise CatalogError(f"Set list {path} does not exist.")
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise CatalogError(f"{path} is not valid TOML: {error}.") from error
    entries = []
    for number, row in enumerate(data.get("set", ())):
        where = f"{path}:set[{number}]"
        if set(row) != {"track", "from_s", "seconds"}:
            raise CatalogError(f"A set entry needs exactly track, from_s, seconds ({where}).")
        entry = SetEntry(str(row["track"]), float(row["from_s"]), float(row["seconds"]))
        if entry.seconds <= 0.0 or entry.from_s < 0.0:
            raise CatalogError(f"from_s must be >= 0 and seconds > 0 ({where}).")
        if tracks is not None and entry.track not in tracks:
            raise CatalogError(f"Track '{entry.track}' is not in the catalogue ({where}.track).")
        entries.append(entry)
    if not entries:
        raise CatalogError(f"{path} has no [[set]] entry.")
    return SetList(tuple(entries))
