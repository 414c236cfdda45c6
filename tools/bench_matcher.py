"""What the matcher costs, how fast and how surely it hears a cut, and what it must refuse.

python -m downbeat.tools.bench_matcher --tracks DIR [--speech DIR] [--other DIR] [--seeds 5]
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from downbeat.lcm_types import music_match_t
from downbeat.perception import features as ft
from downbeat.perception.index import Index
from downbeat.perception.matcher import AlignmentMatcher
from downbeat.perception.source import Recording
from downbeat.tools.matcher_cuts import Row, listen, measure_cuts
from downbeat.tools.matcher_sounds import conditions, load_folder, synthetic_sounds


def measure_rejects(
    recordings: Mapping[str, Recording], others: Sequence[Recording], catalogue: int | None = None
) -> list[Row]:
    """Stream what is not in the catalogue: each track to a catalogue without it, and other sounds.

    Args:
        recordings: Each is left out in turn.
        others: Speech, animals, noise; heard with the whole catalogue.
        catalogue: Keep only this many other tracks; None: all.
    """
    everything = Index()
    for recording in recordings.values():
        everything.add(recording.name, recording.samples, recording.sample_rate_hz)
    rng = np.random.default_rng(0)
    music = _count_locks(
        (AlignmentMatcher(_without(everything, number, catalogue, rng)), recording)
        for number, recording in enumerate(recordings.values())
    )
    size = catalogue or len(recordings) - 1
    rows = _lock_rows(f"unknown music, {size} tracks", *music)
    if others:
        whole = AlignmentMatcher(everything)
        rows += _lock_rows("speech, animals, noise", *_count_locks((whole, o) for o in others))
    return rows


def _without(index: Index, number: int, keep: int | None, rng: np.random.Generator) -> Index:
    rest = [i for i in range(len(index.names)) if i != number]
    if keep is not None:
        rest = [int(i) for i in rng.choice(rest, keep, replace=False)]
    return index.subset(rest)


def _count_locks(pairs: Iterator[tuple[AlignmentMatcher, Recording]]) -> tuple[int, int, float]:
    """Return (locks taken, hops locked, minutes heard)."""
    locks = hops = 0
    minutes = 0.0
    for matcher, sound in pairs:
        heard, _ = listen(matcher, sound)
        before = ""
        for hop in heard:
            now = hop.track if hop.lock == music_match_t.LOCKED else ""
            locks += now not in ("", before)
            hops += now != ""
            before = now
        minutes += sound.duration_s / 60.0
    return locks, hops, minutes


def _lock_rows(name: str, locks: int, hops: int, minutes: float) -> list[Row]:
    return [
        (f"{name}: heard", minutes, "min"),
        (f"{name}: false locks", float(locks), ""),
        (f"{name}: falsely locked", float(hops), "hops"),
    ]


def measure_queries(recordings: Mapping[str, Recording], count: int = 80) -> list[Row]:
    """Time index and queries; larger catalogues are bench_scale's."""
    matcher = AlignmentMatcher()
    before = time.process_time()
    for recording in recordings.values():
        matcher.add(recording.name, recording.samples, recording.sample_rate_hz)
    matcher.finish()
    spent_s = time.process_time() - before
    minutes = sum(r.duration_s for r in recordings.values()) / 60.0
    size = sum(fine.nbytes for fine in matcher.index.fine) / 1024.0
    return [
        ("music", minutes, "min"),
        ("index", 60.0 * minutes / spent_s, "x real time"),
        ("index, per minute of music", size / minutes, "KiB"),
        *_query_rows(matcher, recordings, count),
    ]


def _query_rows(
    matcher: AlignmentMatcher, recordings: Mapping[str, Recording], count: int
) -> list[Row]:
    """Time windows of known music at 16 kHz, as the listener asks them."""
    rng = np.random.default_rng(0)
    rows: list[Row] = []
    for seconds in (1.0, 2.0, 5.0):
        long_enough = [r for r in recordings.values() if r.duration_s > seconds]
        spent_ms: list[float] = []
        for _ in range(count):
            recording = long_enough[int(rng.integers(len(long_enough)))]
            rate = recording.sample_rate_hz
            start = int(rng.uniform(0, len(recording.samples) - seconds * rate))
            window = recording.samples[start : start + round(seconds * rate)]
            window = ft.to_matcher_rate(window, rate)
            before = time.process_time()
            matcher.query(window, ft.SAMPLE_RATE_HZ)
            spent_ms.append(1e3 * (time.process_time() - before))
        p50, p99 = np.percentile(spent_ms, (50, 99))
        name = f"query, {len(matcher.names)} tracks, {seconds:g} s window"
        rows += [(f"{name} p50", float(p50), "CPU ms"), (f"{name} p99", float(p99), "CPU ms")]
    return rows


@dataclass(frozen=True)
class Args:
    """Measure the matcher and the tracker on recordings."""

    tracks: Path
    """Folder of music: the catalogue."""
    speech: Path | None = None
    """Folder of voices: for the robot's microphone, and to be refused."""
    other: Path | None = None
    """Folder of other sounds, to be refused."""
    seeds: int = 5
    """Mashups per condition, each of 22 passages."""
    only: tuple[str, ...] = ("queries", "cuts", "rejects")
    """What to measure."""
    json: bool = False
    """Print one JSON object on standard output."""


def run(args: Args) -> list[Row]:
    """Measure what is asked for."""
    recordings = load_folder(args.tracks)
    rows: list[Row] = []
    if "queries" in args.only:
        rows += measure_queries(recordings)
    if "cuts" in args.only:
        matcher = AlignmentMatcher()
        for recording in recordings.values():
            matcher.add(recording.name, recording.samples, recording.sample_rate_hz)
        for name, condition in conditions(args.speech).items():
            rows += measure_cuts(matcher, recordings, range(args.seeds), condition).rows(name)
    if "rejects" in args.only:
        folders = [folder for folder in (args.speech, args.other) if folder is not None]
        others = [r for folder in folders for r in load_folder(folder).values()]
        rows += measure_rejects(recordings, others + synthetic_sounds())
        for size in (8, 4, 1):
            rows += measure_rejects(recordings, [], min(size, len(recordings) - 1))
    return rows


def main() -> None:
    """Measure and print."""
    args = tyro.cli(Args)
    rows = run(args)
    if args.json:
        print(json.dumps([{"name": n, "value": v, "unit": u} for n, v, u in rows]))
        return
    table = Table("what", "value", "unit")
    for name, value, unit in rows:
        table.add_row(name, f"{value:.2f}", unit)
    Console().print(table)


if __name__ == "__main__":
    main()
