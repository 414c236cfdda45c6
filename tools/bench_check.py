"""`downbeat bench check`: print what an online check costs."""

from __future__ import annotations

import json
from dataclasses import asdict

from downbeat.sim.batch.bench_check import bench_check as measure

LARGEST_RATIO = 1.5


def bench_check(as_json: bool) -> int:
    """Measure and print; 0 if a check costs at most 1.5 times its bare physics."""
    bench = measure()
    if as_json:
        print(json.dumps({**asdict(bench), "ratio": bench.ratio}))
    else:
        print("\n".join(bench.lines()))
    return 0 if bench.ratio <= LARGEST_RATIO else 1
