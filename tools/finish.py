"""After a run: metrics.json, timeline.png, video.mp4, the result table."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from downbeat.tools.replay import replay_equal
from downbeat.tools.report import is_good, print_report, report


def finish_run(run_dir: Path, video: bool, quiet: bool = False) -> dict[str, Any]:
    """Compute everything a run leaves behind; returns the metrics with `good` added."""
    metrics = report(run_dir, replay_equal(run_dir))
    try:
        from downbeat.tools.timeline import draw_timeline

        draw_timeline(run_dir, metrics)
    except ImportError as error:
        print(f"no timeline.png: {error}", file=sys.stderr)
    if video:
        from downbeat.tools.render import render_video

        render_video(run_dir)
    if not quiet:
        print_report(metrics)
        print(f"run: {run_dir}")
    return {**metrics, "good": is_good(metrics)}


def report_command(run_dir: Path, video: bool, as_json: bool) -> int:
    """`downbeat report`."""
    metrics = finish_run(run_dir, video, quiet=as_json)
    if as_json:
        print(json.dumps(metrics))
    return 0 if metrics["good"] else 1
