"""The base of the control folder's errors; raised at load time only, never from the tick."""

from __future__ import annotations

from downbeat.runtime.errors import DownbeatError


class ControlError(DownbeatError):
    """A skill, policy or setting that control cannot work with."""
