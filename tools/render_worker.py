"""Renders a run in a process of its own; started by `render`, which settles MUJOCO_GL first.

Prints one JSON object per line on standard output: {"quality": ..}, {"done": n, "total": n}.
"""

from __future__ import annotations

import json
import queue
import sys
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from downbeat.tools import palette
from downbeat.tools.metrics import first_sample_utime
from downbeat.tools.metrics_sections import is_fallen
from downbeat.tools.runlog import LOG_NAME, RunLog, read_run
from downbeat.tools.truth import TRUTH_NAME, Truth, read_truth
from downbeat.tools.video_encode import VideoWriter, band_levels, load_audio
from downbeat.tools.video_overlay import Moment, Overlay

PULSE_BEATS = 0.45
LEAD_S = 1.0
"""Shown before the music and after it."""
QUEUED_FRAMES = 4


@dataclass(frozen=True)
class Job:
    """What to render.

    Attributes:
        run_dir: Holds the log and the truth file.
        out: MP4 to write, or a PNG of the one moment `start_s`, as fine as it gets.
        audio: Sound of the show, empty: none.
        size_px: Width and height of the video.
        fps: Frames per second.
        budget_ms: What rendering one frame may cost, for the choice of the quality.
        start_s, end_s: Part of the show; NaN: all of it.
    """

    run_dir: str
    out: str
    audio: str
    size_px: tuple[int, int]
    fps: int
    budget_ms: float
    start_s: float
    end_s: float


class Show:
    """What the video says about every moment."""

    def __init__(self, log: RunLog, truth: Truth) -> None:
        self.log, self.truth = log, truth
        self.zero_utime = first_sample_utime(log)
        asked = [section.skill for section in truth.sections]
        danced = dict.fromkeys(log.control.executed.tolist())
        self.colours = palette.skill_colours([*asked, *danced])
        self._fallen = is_fallen(log.truth)

    def moment(self, time_s: float) -> Moment:
        """Return the caption's content at a time of the show."""
        control, utime = self.log.control, self.zero_utime + round(time_s * 1e6)
        tick = int(np.clip(np.searchsorted(control.utime, utime) - 1, 0, control.utime.size - 1))
        state = int(np.searchsorted(self.log.truth.utime, utime)) - 1
        segment = self.truth.segment_at(time_s)
        asked = [s.skill for s in self.truth.sections if s.start_s <= time_s < s.end_s]
        blending = control.previous_skill[tick] != ""
        return Moment(
            time_s=time_s,
            track="" if segment is None else segment.track,
            asked=asked[0] if asked else "",
            danced=str(control.executed[tick]),
            incoming=str(control.skill[tick]) if blending else "",
            weight=float(control.blend_weight[tick]),
            pulse=self._pulse(time_s),
            is_fallen=bool(self._fallen[np.clip(state, 0, self._fallen.size - 1)]),
        )

    def _pulse(self, time_s: float) -> float:
        segment = self.truth.segment_at(time_s)
        if segment is None or segment.track not in self.truth.beats:
            return 0.0
        track_s = np.array([time_s - segment.start_s + segment.track_from_s])
        beat = float(self.truth.beats[segment.track].at(track_s)[0])
        return max(0.0, 1.0 - (beat % 1.0) / PULSE_BEATS)


def main(argument: str) -> None:
    """Render the job given as JSON."""
    raw = json.loads(argument)
    job = Job(**{**raw, "size_px": tuple(raw["size_px"])})
    show = Show(read_run(Path(job.run_dir) / LOG_NAME), read_truth(Path(job.run_dir) / TRUTH_NAME))
    if job.out.endswith(".png"):
        _render_still(job, show)
    else:
        _render_video(job, show)


def _render_video(job: Job, show: Show) -> None:
    start_s = -LEAD_S if np.isnan(job.start_s) else job.start_s
    end_s = show.truth.duration_s + LEAD_S if np.isnan(job.end_s) else job.end_s
    times_s = start_s + np.arange(round((end_s - start_s) * job.fps)) / job.fps
    audio = load_audio(Path(job.audio), start_s, end_s) if job.audio else None
    frames: queue.Queue[NDArray[np.uint8] | None] = queue.Queue(QUEUED_FRAMES)
    failure: list[BaseException] = []
    writer = threading.Thread(target=_encode, args=(job, audio, frames, failure))
    writer.start()
    try:
        _render(job, show, times_s, frames, failure)
    finally:
        frames.put(None)
        writer.join()
    if failure:
        raise failure[0]


class Frames:
    """Makes the pictures of a show, one moment after the other."""

    def __init__(self, job: Job, show: Show, times_s: NDArray[np.float64], scene: Any) -> None:
        from downbeat.catalog.stage import NUM_COLUMNS
        from downbeat.tools.video_scene import smooth_places

        self._job, self._show, self._scene = job, show, scene
        self._states = true_states(show, times_s)
        self._places = smooth_places(self._states, job.fps)
        self._levels = np.zeros((times_s.size, NUM_COLUMNS))
        self._overlay = Overlay(job.size_px, show.truth, show.colours)
        if job.audio:
            sound = load_audio(Path(job.audio), float(times_s[0]), float(times_s[-1]) + 1 / job.fps)
            found = band_levels(sound, job.fps, NUM_COLUMNS)
            self._levels[: len(found)] = found[: times_s.size]

    def picture(self, k: int, time_s: float) -> Image.Image:
        """Return frame `k`, at a time of the show."""
        moment = self._show.moment(time_s)
        red, green, blue = palette.rgb(self._show.colours[moment.danced])
        pixels = self._scene.render(
            self._states[k],
            self._places[k],
            time_s,
            (red / 255, green / 255, blue / 255),
            moment.pulse,
            self._levels[k],
        )
        picture = Image.fromarray(pixels)
        if picture.size != self._job.size_px:
            picture = picture.resize(self._job.size_px, Image.Resampling.BILINEAR, reducing_gap=1.0)
        self._overlay.draw(picture, moment)
        return picture


def true_states(show: Show, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the plant's true qpos at times of the show, (n, 36)."""
    from downbeat.tools.video_scene import states_at

    truth = show.log.truth
    wanted = show.zero_utime + np.round(times_s * 1e6).astype(np.int64)
    return states_at(truth.utime, truth.qpos, wanted)


def _render(
    job: Job,
    show: Show,
    times_s: NDArray[np.float64],
    frames: queue.Queue[NDArray[np.uint8] | None],
    failure: list[BaseException],
) -> None:
    from downbeat.tools.video_scene import best_scene

    scene = best_scene(true_states(show, times_s[:1])[0], job.budget_ms)
    _say({"quality": scene.quality.name})
    source = Frames(job, show, times_s, scene)
    for k, time_s in enumerate(times_s.tolist()):
        frames.put(np.asarray(source.picture(k, time_s)))
        if failure:
            return
        if k % job.fps == 0 or k == times_s.size - 1:
            _say({"done": k + 1, "total": int(times_s.size)})


def _render_still(job: Job, show: Show) -> None:
    """Render the second that ends at the moment, for the columns' sake, and keep its last frame."""
    from downbeat.tools.video_scene import QUALITIES, Scene

    times_s = job.start_s + np.arange(1 - job.fps, 1) / job.fps
    source = Frames(job, show, times_s, Scene(QUALITIES[0]))
    source.picture(job.fps - 1, job.start_s).save(job.out)


def _encode(
    job: Job,
    audio: NDArray[np.float32] | None,
    frames: queue.Queue[NDArray[np.uint8] | None],
    failure: list[BaseException],
) -> None:
    """Encode what comes until None; after a failure only empty the queue."""
    try:
        with VideoWriter(Path(job.out), job.size_px, job.fps, audio) as writer:
            while (picture := frames.get()) is not None:
                writer.add(picture)
    except BaseException as error:
        failure.append(error)
        while frames.get() is not None:
            pass


def _say(event: dict[str, Any]) -> None:
    print(json.dumps(event), flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
