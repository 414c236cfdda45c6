"""Numbers and names out of metadata, checked."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

from downbeat.policies.errors import PolicyError


def short(value: Any, length: int = 40) -> str:
    """Return a value as text that fits into an error sentence."""
    text = " ".join(repr(value).split())
    return text if len(text) <= length else f"{text[: length - 3]}..."


def csv_texts(text: str) -> tuple[str, ...]:
    """Split a comma-separated list."""
    return tuple(part.strip() for part in text.split(","))


def csv_numbers(text: str, where: str) -> tuple[float, ...]:
    """Parse a comma-separated list of numbers.

    Raises:
        PolicyError: One of them is not a finite number.
    """
    return finite([_number(part, where) for part in csv_texts(text)], where)


def name_list(value: Any, where: str) -> tuple[str, ...]:
    """Return a list of names; text is split at commas.

    Raises:
        PolicyError: It is neither.
    """
    if isinstance(value, str):
        return csv_texts(value)
    if not isinstance(value, list | tuple) or not all(isinstance(item, str) for item in value):
        raise PolicyError(f"{short(value)} is not a list of names ({where}).")
    return tuple(value)


def positive(value: Any, where: str) -> float:
    """Return a finite number above zero.

    Raises:
        PolicyError: It is none.
    """
    found = finite([value], where)[0]
    if not found > 0.0:
        raise PolicyError(f"{found:g} must be above 0 ({where}).")
    return found


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool):
        raise PolicyError(f"{value} is not a number ({where}).")
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        raise PolicyError(f"{short(value)} is not a number ({where}).") from None


def json_value(text: str, where: str) -> Any:
    """Parse JSON.

    Raises:
        PolicyError: It is not JSON.
    """
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise PolicyError(f"{short(text)} is not JSON: {error} ({where}).") from None


def finite(values: Any, where: str) -> tuple[float, ...]:
    """Return finite floats.

    Raises:
        PolicyError: Not a list, or an element is not a finite number.
    """
    if isinstance(values, str) or not isinstance(values, Sequence):
        raise PolicyError(f"{short(values)} is not a list of numbers ({where}).")
    found = tuple(_number(value, where) for value in values)
    bad = [value for value in found if not math.isfinite(value)]
    if bad:
        raise PolicyError(f"{bad[0]} is not a finite number ({where}).")
    return found


def spread(value: Any, count: int, where: str) -> tuple[float, ...]:
    """Return `count` numbers; a single number stands for all.

    Raises:
        PolicyError: The count is wrong.
    """
    if isinstance(value, int | float) and not isinstance(value, bool):
        return finite([value] * count, where)
    found = finite(value, where)
    if len(found) != count:
        raise PolicyError(f"{len(found)} values for {count} joints ({where}).")
    return found
