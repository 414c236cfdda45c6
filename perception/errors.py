"""The base of the perception folder's errors."""

from __future__ import annotations

from downbeat.runtime.errors import DownbeatError


class PerceptionError(DownbeatError):
    """A recording, index or setting that perception cannot work with."""
