"""Typed fields of a TOML table; errors name file:key.

Every function takes `where`, the file:key for the error, and raises PolicyError.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

from downbeat.policies.errors import PolicyError
from downbeat.runtime.errors import one_of


def check_keys(table: Any, known: set[str], needed: set[str], where: str) -> None:
    """Refuse unknown and missing keys of a table."""
    if not isinstance(table, Mapping):
        raise PolicyError(f"A table is expected, not {table!r} ({where}).")
    unknown = sorted(set(table) - known)
    if unknown:
        raise PolicyError(f"Key '{unknown[0]}' is unknown; keys are {one_of(known)} ({where}).")
    missing = sorted(needed - set(table))
    if missing:
        raise PolicyError(f"Key '{missing[0]}' is missing ({where}).")


def number(value: Any, where: str) -> float:
    """Return a number as float."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise PolicyError(f"{value!r} is not a number ({where}).")
    return float(value)


def integer(value: Any, where: str) -> int:
    """Return a whole number."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise PolicyError(f"{value!r} is not a whole number ({where}).")
    return value


def numbers(value: Any, length: int | None, where: str) -> Any:
    """Return a list of numbers, of a given length if one is given."""
    if not isinstance(value, list) or (length is not None and len(value) != length):
        wanted = "a list of numbers" if length is None else f"a list of {length} numbers"
        raise PolicyError(f"{value!r} is not {wanted} ({where}).")
    return tuple(number(item, where) for item in value)


def texts(value: Any, where: str) -> tuple[str, ...]:
    """Return a list of texts."""
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        raise PolicyError(f"{value!r} is not a list of texts ({where}).")
    return cast(tuple[str, ...], tuple(value))
