"""`downbeat bench batch`: print how fast the batch engines are here."""

from __future__ import annotations

import json
from dataclasses import asdict

from downbeat.sim.batch.throughput import HEADER, machine, measure_all


def bench_batch(as_json: bool) -> int:
    """Measure and print, row by row."""
    rows = []
    if not as_json:
        print(f"closed loop, policies included, 5 ms steps; {machine()}")
        print(HEADER, flush=True)
    for row in measure_all():
        rows.append(asdict(row))
        if not as_json:
            print(row.line(), flush=True)
    if as_json:
        print(json.dumps(rows))
    return 0
