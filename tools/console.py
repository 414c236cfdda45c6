"""What a tool says besides its result, and how it cuts a long list."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from typing import TypeVar

Item = TypeVar("Item")


def say(text: str) -> None:
    """Print progress to standard error; standard output is for results."""
    print(text, file=sys.stderr, flush=True)


def tenths(items: Sequence[Item], what: str) -> Iterator[Item]:
    """Yield items, and say after every tenth of them how many are done, and after how long."""
    began = time.monotonic()
    for number, item in enumerate(items, 1):
        yield item
        if number * 10 // len(items) > (number - 1) * 10 // len(items):
            say(f"{what}: {number} of {len(items)}, {time.monotonic() - began:.0f} s")


def some(texts: Sequence[str], most: int, between: str = "; ") -> str:
    """Return the first few texts, and how many there are more."""
    rest = len(texts) - most
    return between.join([*texts[:most], *([f"and {rest} more"] if rest > 0 else [])])
