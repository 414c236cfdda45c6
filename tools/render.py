"""video.mp4 of a run, rendered after it from the plant's true states."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from downbeat.tools.render_worker import Job
from downbeat.tools.runlog import AUDIO_NAME

VIDEO_NAME = "video.mp4"
GL_BACKENDS = ("egl", "osmesa")
SIZE_PX = (960, 540)
FPS = 25
BUDGET_MS = 30.0
"""Per frame, of 40: with drawing and encoding, 80 s of show take less than 90 s on one core."""

Progress = Callable[[int, int], None]
"""Called with the frames done and all frames."""


def render_video(
    run_dir: Path,
    audio: Path | None = None,
    progress: Progress | None = None,
    start_s: float = math.nan,
    end_s: float = math.nan,
) -> Path | None:
    """Render video.mp4 into the run folder.

    MuJoCo chooses its GL when it is imported, so the work is done in a process of its own: with
    EGL (a GPU or a software renderer), else with OSMesa.

    Args:
        run_dir: Holds run.lcmlog and truth.json.
        audio: Sound of the show; None: mashup.wav of the run folder, silent without it.
        progress: Called about once per second of video.
        start_s: First second of the show; NaN: a second before it.
        end_s: Last second; NaN: a second after it.

    Returns:
        The video, or None when there is no GL; one line on standard error then says so.
    """
    job = _job(run_dir, run_dir / VIDEO_NAME, audio, SIZE_PX, start_s, end_s)
    return _run(job, progress)


def render_still(
    run_dir: Path, time_s: float, out: Path, size_px: tuple[int, int] = (1920, 1080)
) -> Path | None:
    """Render one moment of a run as PNG, with shadows and reflections.

    Args:
        run_dir: Holds run.lcmlog and truth.json.
        time_s: Of the show.
        out: PNG to write.
        size_px: Width and height.

    Returns:
        The picture, or None when there is no GL; one line on standard error then says so.
    """
    return _run(_job(run_dir, out.with_suffix(".png"), None, size_px, time_s, time_s), None)


def _job(
    run_dir: Path,
    out: Path,
    audio: Path | None,
    size_px: tuple[int, int],
    start_s: float,
    end_s: float,
) -> Job:
    sound = audio or run_dir / AUDIO_NAME
    return Job(
        run_dir=str(run_dir),
        out=str(out),
        audio=str(sound) if sound.is_file() else "",
        size_px=size_px,
        fps=FPS,
        budget_ms=BUDGET_MS,
        start_s=start_s,
        end_s=end_s,
    )


def _run(job: Job, progress: Progress | None) -> Path | None:
    out = Path(job.out)
    reasons = []
    for backend in GL_BACKENDS:
        reason = _run_worker(job, backend, progress)
        if reason is None:
            return out
        reasons.append(f"{backend}: {reason}")
    out.unlink(missing_ok=True)
    print(f"no {out.name}: nothing could render it ({'; '.join(reasons)})", file=sys.stderr)
    return None


def _run_worker(job: Job, backend: str, progress: Progress | None) -> str | None:
    """Render with one GL backend; return why it failed, None if it did not."""
    worker = subprocess.Popen(
        [sys.executable, "-m", "downbeat.tools.render_worker", json.dumps(asdict(job))],
        env={**os.environ, "MUJOCO_GL": backend},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        for line in worker.stdout or ():
            event = json.loads(line)
            if progress is not None and "done" in event:
                progress(event["done"], event["total"])
        errors = worker.stderr.read().strip().splitlines() if worker.stderr else []
        code = worker.wait()
    finally:
        worker.kill()
        worker.wait()
    if code == 0:
        return None
    return errors[-1] if errors else f"exit code {code}"
