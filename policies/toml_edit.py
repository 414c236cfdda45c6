"""Change a few keys of a manifest that was written by us, and nothing else."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from downbeat.policies.toml_text import write_toml

ORDER_LAST = ("limits", "command", "policy", "certificate")
"""Tables; TOML wants plain keys before them."""


def set_keys(path: Path, changes: Mapping[str, Any]) -> None:
    """Set top-level keys; a value of None removes the key."""
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    table.update(changes)
    plain = {k: v for k, v in table.items() if k not in ORDER_LAST and v is not None}
    tables = {k: table[k] for k in ORDER_LAST if table.get(k) is not None}
    write_toml(path, {**plain, **tables})


def set_files(path: Path, names: Sequence[str], digests: Sequence[str]) -> None:
    """Replace the list of extra files."""
    set_keys(path, {"extra_files": list(names), "extra_sha256": list(digests)})
