"""What a tool says besides its result."""

from __future__ import annotations

import sys


def say(text: str) -> None:
    """Print progress to standard error; standard output is for results."""
    print(text, file=sys.stderr, flush=True)
