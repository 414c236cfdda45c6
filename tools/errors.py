"""The base of the tools' errors."""

from __future__ import annotations

from downbeat.runtime.errors import DownbeatError


class ToolError(DownbeatError):
    """Something that a command was given and cannot work with."""
