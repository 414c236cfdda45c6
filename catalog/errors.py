"""The base of the catalogue's errors."""

from __future__ import annotations

from downbeat.runtime.errors import DownbeatError


class CatalogError(DownbeatError):
    """A wrong entry in a catalogue file, or one that does not exist."""
