"""`downbeat bench`: one table of what things cost on this machine."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from downbeat.runtime.errors import one_of
from downbeat.tools.errors import ToolError

Row = tuple[str, float, str]


def _percentiles(name: str, durations_s: Sequence[float], unit: str, scale: float) -> list[Row]:
    p50, p99 = np.percentile(np.asarray(durations_s) * scale, (50, 99))
    return [(f"{name} p50", float(p50), unit), (f"{name} p99", float(p99), unit)]


def bench_tick() -> list[Row]:
    """Time the control core: one skill alone, and two during a cross-fade."""
    from downbeat.catalog.robot import load_g1
    from downbeat.control.core import ControlCore, TickInput
    from downbeat.control.policy import SkillLibrary
    from downbeat.lcm_types import g1_low_state_t, skill_request_t

    core = ControlCore(SkillLibrary.load(only=frozenset({"stand", "kpop", "thriller"})))
    state = g1_low_state_t()
    state.imu_pelvis.quat = [1.0, 0.0, 0.0, 0.0]
    state.joint_pos = load_g1().default_joint_pos
    alone: list[float] = []
    blending: list[float] = []
    for tick in range(1500):
        requests = ()
        if tick % 100 == 50:
            msg = skill_request_t()
            msg.request_id, msg.phase_rate = tick, 1.0
            msg.skill = "kpop" if tick % 200 == 50 else "thriller"
            requests = (msg,)
        utime = 1_000_000 + tick * 20_000
        before = time.perf_counter()
        output = core.tick(TickInput(utime, tick, state, 0, requests))
        spent = time.perf_counter() - before
        (blending if output.status.previous_skill else alone).append(spent)
    return [
        *_percentiles("tick, one skill", alone[20:], "us", 1e6),
        *_percentiles("tick, cross-fade", blending, "us", 1e6),
    ]


def bench_codec() -> list[Row]:
    """Time the codec against lcm-gen's own code."""
    from downbeat.runtime.bench_codec import bench_codec as measure

    rows: list[Row] = []
    for row in measure(2000, 3):
        rows.append((row.name, row.ours_us, "us"))
        rows.append((f"{row.name}, times faster than lcm-gen", row.ratio, "x"))
    return rows


def bench_fingerprint() -> list[Row]:
    """Time queries over the bundled tracks."""
    from downbeat.perception.matcher import AlignmentMatcher
    from downbeat.tools.composer.store import COMPOSITIONS, composed_recording
    from downbeat.tools.rundir import CACHE_DIR

    matcher = AlignmentMatcher()
    recordings = [composed_recording(name, CACHE_DIR / "tracks") for name in COMPOSITIONS]
    before = time.perf_counter()
    for recording in recordings:
        matcher.add(recording.name, recording.samples, recording.sample_rate_hz)
    matcher.finish()
    index_s = time.perf_counter() - before
    minutes = sum(r.duration_s for r in recordings) / 60.0
    rows: list[Row] = [("index, per minute of music", index_s / minutes, "s")]
    rng = np.random.default_rng(0)
    for seconds in (1.25, 5.0):
        spent: list[float] = []
        for _ in range(60):
            recording = recordings[int(rng.integers(len(recordings)))]
            rate = recording.sample_rate_hz
            start = int(rng.uniform(0, len(recording.samples) - seconds * rate))
            window = recording.samples[start : start + round(seconds * rate)]
            before = time.perf_counter()
            matcher.query(window, rate)
            spent.append(time.perf_counter() - before)
        rows += _percentiles(f"fingerprint query, {seconds:g} s window", spent, "ms", 1e3)
    return rows


def bench_generator() -> list[Row]:
    """Time the generator on a planted and a stepping dance."""
    from downbeat.policies.generator.build import generate

    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for name in ("sway", "discostep"):
            before = time.perf_counter()
            generate(name, 128.0, Path(folder))
            rows.append((f"generate {name} at 128 BPM", time.perf_counter() - before, "s"))
    return rows


def bench_lockstep() -> list[Row]:
    """Time the demo in lockstep."""
    from downbeat.catalog.tracks import BUNDLED_TRACKS, load_tracks
    from downbeat.tools.demo import bundled_library, demo_set_list
    from downbeat.tools.eval_mashup import write_show
    from downbeat.tools.mashup import build_mashup
    from downbeat.tools.run_lockstep import run_lockstep

    tracks = load_tracks(BUNDLED_TRACKS)
    with tempfile.TemporaryDirectory() as folder:
        run_dir = Path(folder)
        library = bundled_library(tracks, run_dir / "catalog")
        mashup = build_mashup(demo_set_list(tracks, 20.0), tracks, library.recordings, True)
        show = write_show(run_dir, mashup, library, 0)
        speed = run_lockstep(show, run_dir, float(mashup.truth["duration_s"]))
    return [("lockstep, whole demo", speed, "x real time")]


BENCHMARKS: dict[str, Callable[[], list[Row]]] = {
    "tick": bench_tick,
    "codec": bench_codec,
    "fingerprint": bench_fingerprint,
    "generator": bench_generator,
    "lockstep": bench_lockstep,
}


def run_bench(only: Sequence[str], as_json: bool) -> int:
    """Measure and print the table."""
    for name in only:
        if name not in BENCHMARKS:
            raise ToolError(f"Benchmark '{name}' is unknown; there are {one_of(BENCHMARKS)}.")
    rows = [
        row for name, bench in BENCHMARKS.items() if not only or name in only for row in bench()
    ]
    if as_json:
        print(json.dumps([{"name": n, "value": v, "unit": u} for n, v, u in rows]))
        return 0
    table = Table("what", "value", "unit")
    for name, value, unit in rows:
        table.add_row(name, f"{value:.2f}", unit)
    Console().print(table)
    return 0
