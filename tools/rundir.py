"""Run folders: runs/<time>/ and runs/latest."""

from __future__ import annotations

import os
from datetime import datetime
from pathlib import Path

CACHE_DIR = Path.home() / ".cache" / "downbeat"
"""Composed tracks, catalogue indexes and the Java types jar; safe to delete at any time."""


def new_run_dir(runs: Path) -> Path:
    """Make runs/<local time>/ and point runs/latest to it."""
    runs.mkdir(parents=True, exist_ok=True)
    stamp = datetime.now().strftime("%Y-%m-%dT%H-%M-%S")
    run_dir = runs / stamp
    serial = 1
    while run_dir.exists():
        serial += 1
        run_dir = runs / f"{stamp}-{serial}"
    run_dir.mkdir()
    link = runs / "latest"
    temporary = runs / f".latest-{os.getpid()}"
    temporary.unlink(missing_ok=True)
    temporary.symlink_to(run_dir.name)
    temporary.replace(link)
    return run_dir
