"""The base of every error that a person reads."""

from __future__ import annotations

from collections.abc import Iterable


class DownbeatError(Exception):
    """A wrong input. One sentence: what was asked, why not, what would be valid, from where.

    Commands print it and exit with 2; it never leaves the control tick.
    """


def one_of(names: Iterable[object], limit: int = 30) -> str:
    """List what would have been valid, for the end of an error sentence."""
    listed = sorted(str(name) for name in names)
    if not listed:
        return "there are none"
    shown = ", ".join(listed[:limit])
    return shown if len(listed) <= limit else f"{shown} and {len(listed) - limit} more"
