"""What a catalogue of 100, 1,000 and 10,000 tracks costs, and what is still recognised in it.

python -m downbeat.tools.bench_scale --tracks DIR [--speech DIR] [--sizes 100 1000 10000]

Queries are windows of 5 s of real recordings, alone, in the conditions of `downbeat eval chunks`. A
quarter of the recordings is left out of the catalogue: windows of those must be refused. Of two
recordings of the same music one is taken out first, and named.
"""

from __future__ import annotations

import json
import multiprocessing
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import tyro
from rich.console import Console
from rich.progress import track as progress
from rich.table import Table

from downbeat.perception import features as ft
from downbeat.perception.constellation import ConstellationMatcher
from downbeat.perception.index import Index
from downbeat.perception.matcher import AlignmentMatcher, MusicMatcher
from downbeat.perception.source import Recording
from downbeat.tools.bench_scale_tracks import make_index
from downbeat.tools.chunks_make import Query, clean_queries, degraded_queries
from downbeat.tools.chunks_score import ConditionScore, FalseAccepts, Places
from downbeat.tools.conditions import degradations
from downbeat.tools.duplicates import find_duplicates
from downbeat.tools.matcher_sounds import load_folder, make_babble

ALL_SCANNED = 10**9
LEFT_OUT_EVERY = 4
"""Each so-manieth recording is left out of the catalogue."""
ALIGNMENT, PROPOSED, CONSTELLATION = "every place", "proposed", "constellation"


@dataclass(frozen=True)
class Args:
    """Measure large catalogues."""

    tracks: Path
    """Folder of music."""
    speech: Path | None = None
    """Folder of voices, for the robot's microphone."""
    sizes: tuple[int, ...] = (100, 1_000, 10_000)
    """Tracks in the catalogue; what the folder lacks is made of pieces of it."""
    seconds: float = 120.0
    """Length of a track that is made [s]."""
    only: tuple[str, ...] = ("clean", "robot", "tempo-4%", "tempo+4%", "pitch-4%", "pitch+4%",
                             "speed-4%", "speed+4%")  # fmt: skip
    """Conditions."""
    per_condition: int = 1
    """Windows per recording and condition."""
    scan_up_to: int = 1_000
    """Also compare every place, and ask the constellation matcher, up to this size."""
    json: bool = False
    """Print one JSON object on standard output."""


@dataclass
class Row:
    """One catalogue, asked in one way.

    Attributes:
        tracks: In the catalogue.
        hours: Of music.
        search: How places are found.
        file_mb: The index on disk.
        build_speed: Seconds of music indexed per second of one core, decoding apart.
        load_ms: Until the first query can be asked, file cached, CPU time [ms].
        memory_mb: Of a fresh process, beyond what is mapped.
        mapped_mb: Of the file, what is in memory after a query.
        p50_ms: Of a query, CPU time.
        p99_ms: The same.
        conditions: Shares of `ConditionScore`, by name.
        false_accepts: Windows of recordings that the catalogue lacks.
    """

    tracks: int
    hours: float
    search: str
    file_mb: float
    build_speed: float
    load_ms: float = 0.0
    memory_mb: float = 0.0
    mapped_mb: float = 0.0
    p50_ms: float = 0.0
    p99_ms: float = 0.0
    conditions: dict[str, dict[str, float]] = field(default_factory=dict)
    false_accepts: dict[str, float | list[str]] = field(default_factory=dict)


Load = Callable[[Path], MusicMatcher]


def load_proposing(path: Path) -> MusicMatcher:
    """Load a matcher to which an inverted index proposes places."""
    return AlignmentMatcher(Index.load(path), 0)


def load_scanning(path: Path) -> MusicMatcher:
    """Load a matcher that compares every place."""
    return AlignmentMatcher(Index.load(path), ALL_SCANNED)


def memory_mb() -> tuple[float, float]:
    """Return the memory of this process that is its own, and that of files it has mapped [MB]."""
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    sizes = {line.split(":")[0]: line.split()[1] for line in lines if line.startswith("Rss")}
    return float(sizes["RssAnon"]) / 1024.0, float(sizes["RssFile"]) / 1024.0


def load_cost(load: Load, path: Path) -> tuple[float, float, float]:
    """Return what loading costs a fresh process: CPU time [ms], own and mapped memory [MB]."""
    own, mapped = memory_mb()
    begin = time.process_time()
    matcher = load(path)
    spent_ms = (time.process_time() - begin) * 1e3
    noise = np.random.default_rng(0).standard_normal(5 * ft.SAMPLE_RATE_HZ).astype(np.float32)
    matcher.query(noise, ft.SAMPLE_RATE_HZ)
    own_after, mapped_after = memory_mb()
    return spent_ms, own_after - own, mapped_after - mapped


def measure(
    row: Row,
    load: Load,
    path: Path,
    known: Sequence[Query],
    unknown: Sequence[Query],
    places: Places,
) -> None:
    """Load a catalogue, ask all queries, fill in the row."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        row.load_ms, row.memory_mb, row.mapped_mb = pool.apply(load_cost, (load, path))
    matcher = load(path)
    scores: dict[str, ConditionScore] = {}
    spent: list[float] = []
    for query in known:
        begin = time.process_time()
        result = matcher.query(query.samples, ft.SAMPLE_RATE_HZ)
        spent.append((time.process_time() - begin) * 1e3)
        places.judge(query, result, scores.setdefault(query.condition, ConditionScore()))
    refused = FalseAccepts()
    for query in unknown:
        refused.add(query, matcher.query(query.samples, ft.SAMPLE_RATE_HZ))
    row.p50_ms, row.p99_ms = (float(v) for v in np.percentile(spent, (50, 99)))
    row.conditions = {name: score.shares() for name, score in scores.items()}
    row.false_accepts = refused.shares()


def make_queries(
    recordings: Sequence[Recording], args: Args, is_quiet: bool
) -> dict[str, list[Query]]:
    """Return the queries of each recording, at the matcher's rate."""
    voices = [] if args.speech is None else load_folder(args.speech).values()
    rate = recordings[0].sample_rate_hz
    babble = make_babble([v.samples for v in voices], 30.0, rate) if voices else None
    wanted = [d for d in degradations(babble) if d.name in args.only]
    queries: dict[str, list[Query]] = {}
    for recording in progress(recordings, "queries", disable=is_quiet, transient=True):
        own = queries.setdefault(recording.name, [])
        for degradation in wanted:
            if degradation.name == "clean":
                made = list(clean_queries(recording, args.per_condition))[::5][: args.per_condition]
            else:
                made = list(degraded_queries(recording, degradation, args.per_condition, 7))
            own += [_at_matcher_rate(q, rate) for q in made if not q.is_silent]
    return queries


def _at_matcher_rate(query: Query, rate: int) -> Query:
    samples = ft.to_matcher_rate(query.samples, rate)
    return Query(
        query.condition, query.track, query.start_s, query.shift_s, samples, query.is_silent
    )


def run(args: Args) -> list[Row]:
    """Measure catalogues of every size."""
    is_quiet = args.json or not sys.stderr.isatty()
    recordings = list(load_folder(args.tracks).values())
    references = {r.name: ft.to_matcher_rate(r.samples, r.sample_rate_hz) for r in recordings}
    everything, begin = Index(), time.process_time()
    for name, samples in references.items():
        everything.add(name, samples, ft.SAMPLE_RATE_HZ)
    everything.all_landmarks()
    music_s = sum(map(len, references.values())) / ft.SAMPLE_RATE_HZ
    build_speed = music_s / (time.process_time() - begin)
    twins = {other: one for one, other in find_duplicates(everything)}
    for other, one in twins.items():
        print(f"'{other}' is taken out: it holds the same as '{one}'", file=sys.stderr)
    recordings = [r for r in recordings if r.name not in twins]
    queries = make_queries(recordings, args, is_quiet)
    left_out = list(queries)[LEFT_OUT_EVERY - 1 :: LEFT_OUT_EVERY]
    unknown = [query for name in left_out for query in queries.pop(name)]
    known = [query for own in queries.values() for query in own]
    real = everything.subset([everything.names.index(name) for name in queries])
    del recordings
    places = Places(references)
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for size in args.sizes:
            is_small = size <= args.scan_up_to
            index = make_index(real, size, args.seconds, is_small)
            path = Path(folder) / "index.bin"
            index.save(path)
            ways: dict[str, Load] = {PROPOSED: load_proposing}
            if is_small:
                ways.update({ALIGNMENT: load_scanning, CONSTELLATION: ConstellationMatcher.load})
            hours = sum(len(power) for power in index.power) * ft.HOP_S / 2.0 / 3600.0
            file_mb = path.stat().st_size / 2**20
            del index
            for name, load in ways.items():
                rows.append(Row(size, hours, name, file_mb, build_speed))
                measure(rows[-1], load, path, known, unknown, places)
                if not args.json:
                    print_row(rows[-1])
    return rows


def print_row(row: Row) -> None:
    """Print one row as soon as it is measured."""
    table = Table(
        "tracks",
        "hours",
        "search",
        "file MB",
        "load ms",
        "memory MB",
        "mapped MB",
        "p50 ms",
        "p99 ms",
    )
    table.add_row(
        f"{row.tracks}", f"{row.hours:.1f}", row.search, f"{row.file_mb:.0f}", f"{row.load_ms:.0f}",
        f"{row.memory_mb:.0f}", f"{row.mapped_mb:.0f}", f"{row.p50_ms:.1f}", f"{row.p99_ms:.1f}",
    )  # fmt: skip
    Console(width=100).print(table)
    for name, shares in row.conditions.items():
        print(
            f"  {name:10s} n {shares['n']:4.0f}  right track {shares['top1']:.1%}, "
            f"right place {shares['right']:.1%}, accepted {shares['accepted']:.1%}"
        )
    print(f"  indexed at {row.build_speed:.0f} times real time on one core, decoding apart")
    false = row.false_accepts
    print(f"  false accepts {false['rate']:.2%} of {false['n']} (below {false['upper95']:.2%})")
    sys.stdout.flush()


def main() -> None:
    """Measure and print."""
    args = tyro.cli(Args)
    rows = run(args)
    if args.json:
        print(json.dumps([asdict(row) for row in rows]))


if __name__ == "__main__":
    main()
