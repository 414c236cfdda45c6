"""Recordings of the chunk study: folders at one rate, their index, and who composed them."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import soxr

from downbeat.perception.index import Index
from downbeat.perception.source import Recording
from downbeat.tools.chunks_make import CHUNK_S, is_silent
from downbeat.tools.console import say
from downbeat.tools.errors import ToolError
from downbeat.tools.matcher_sounds import load_folder

RATE_HZ = 44_100
"""All sound is degraded at this rate."""


def make_index(recordings: Iterable[Recording]) -> Index:
    """Index recordings."""
    index = Index()
    for recording in recordings:
        index.add(recording.name, recording.samples, recording.sample_rate_hz)
    return index


def at_rate(recording: Recording) -> Recording:
    """Return a recording at the rate of the study."""
    if recording.sample_rate_hz == RATE_HZ:
        return recording
    samples = soxr.resample(recording.samples, recording.sample_rate_hz, RATE_HZ)
    return Recording(recording.name, samples.astype(np.float32), RATE_HZ)


def read_folder(folder: Path | None) -> Sequence[Recording]:
    """Return the recordings of a folder at the rate of the study; none of no folder.

    What cannot be read is named and left out.
    """
    return [] if folder is None else [at_rate(r) for r in load_folder(folder, say).values()]


def read_tracks(folder: Path) -> dict[str, Recording]:
    """Return the recordings of a folder that can be indexed, by name, at the rate of the study.

    What cannot be read, is silent or shorter than a window is named and left out.

    Raises:
        ToolError: Fewer than two are left.
        PerceptionError: No folder of audio files.
    """
    found = {name: at_rate(r) for name, r in load_folder(folder, say).items()}
    useless = {
        name: "silent" if is_silent(r.samples) else f"shorter than {CHUNK_S:g} s"
        for name, r in found.items()
        if is_silent(r.samples) or r.duration_s < CHUNK_S
    }
    for name, why in useless.items():
        say(f"left out: {name} is {why}")
    kept = {name: replace(r, name=name) for name, r in found.items() if name not in useless}
    if len(kept) < 2:
        raise ToolError(
            f"{folder} holds {len(kept) or 'no'} recording{'' if len(kept) == 1 else 's'} that can "
            f"be indexed; valid are two or more that sound and last {CHUNK_S:g} s."
        )
    return kept


def read_groups(path: Path | None) -> Mapping[str, str]:
    """Return track -> group of a tab-separated file.

    Raises:
        ToolError: It cannot be read, or a row has not two columns.
    """
    if path is None:
        return {}
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.reader(file, delimiter="\t"))
    except (OSError, UnicodeDecodeError) as error:
        raise ToolError(f"Groups {path} cannot be read: {error}.") from error
    for number, row in enumerate(rows, 1):
        if len(row) != 2:
            raise ToolError(
                f"{path}:{number} has {len(row)} columns; valid are two: track, tab, group."
            )
    return dict(rows)
