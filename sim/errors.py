"""The base of the simulator's errors; raised at load time only."""

from __future__ import annotations

from downbeat.runtime.errors import DownbeatError


class SimError(DownbeatError):
    """A setting that the simulator cannot work with."""
