"""Mashups heard by the listener itself: how fast a cut is noticed, and how true the position is.

Every figure comes from what the listener publishes, at the time at which it publishes it; truth is
only known here.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.signal import fftconvolve

from downbeat.catalog.beatgrid import BeatGrid
from downbeat.catalog.tracks import Track
from downbeat.lcm_types import music_match_t
from downbeat.perception import features as ft
from downbeat.perception.features import F32
from downbeat.perception.listener import ListenerNode
from downbeat.perception.matcher import AlignmentMatcher
from downbeat.perception.source import FileSource, Recording
from downbeat.runtime.clock import SimClock
from downbeat.runtime.memq import MemqHub
from downbeat.tools.mashup import SAMPLE_RATE_HZ, build_mashup, seeded_set_list
from downbeat.tools.matcher_sounds import Condition

Row = tuple[str, float, str]

SECTION_S = 19.93
"""No multiple of the hop: a cut may fall anywhere in it."""
SECTIONS = 22
SETTLED_S = 1.0
"""So long after a lock the position counts as settled."""
SAME_PLACE_S = 0.06
SAME_SOUND = 0.8
"""Normalised cross-correlation above which two places are the same recording."""
COMPARE_S = 3.0


@dataclass(frozen=True, slots=True)
class Heard:
    """One MUSIC_MATCH: when (since the sound began), and when it says that the track was at 0 s."""

    time_s: float
    lock: int
    track: str
    track_zero_s: float


@dataclass
class CutReport:
    """What became of the cuts of one condition.

    Attributes:
        lock_s: From each cut to LOCKED on the right track [s]; NaN: never.
        release_s: From each cut to the first hop without a lock on the old track [s].
        wrong_locks: Locks taken on a track that was not playing.
        error_s: Position error at settled hops, any repeat of the passage counted as wrong [s].
        same_sound_error_s: The same at a place of identical sound, taken for right [s].
        elsewhere: Settled hops at a place whose sound differs.
        held: Hops locked on the right track, after the first lock of each section.
        hops: All hops there.
        cpu_s: Processor time of the listener [s].
        sound_s: Sound heard [s].
    """

    lock_s: list[float] = field(default_factory=list)
    release_s: list[float] = field(default_factory=list)
    wrong_locks: int = 0
    error_s: list[float] = field(default_factory=list)
    same_sound_error_s: list[float] = field(default_factory=list)
    elsewhere: int = 0
    held: int = 0
    hops: int = 0
    cpu_s: float = 0.0
    sound_s: float = 0.0

    def rows(self, name: str) -> list[Row]:
        """Return the table rows."""
        late = [s for s in self.lock_s if np.isnan(s)]
        locked = [s for s in self.lock_s if not np.isnan(s)]
        hops = max(len(self.error_s), 1)
        return [
            (f"{name}: cuts", float(len(self.lock_s)), ""),
            *_quantiles(f"{name}: cut to lock", locked, 1.0, "s"),
            (f"{name}: never locked", float(len(late)), "cuts"),
            *_quantiles(f"{name}: cut to release", self.release_s, 1.0, "s"),
            (f"{name}: wrong locks", float(self.wrong_locks), ""),
            (f"{name}: lock held", 100.0 * self.held / max(self.hops, 1), "% of hops"),
            *_quantiles(f"{name}: position error", self.same_sound_error_s, 1e3, "ms"),
            (f"{name}: at another repeat", 100.0 * self._off_share(), "% of hops"),
            (f"{name}: at other sound", 100.0 * self.elsewhere / hops, "% of hops"),
            (f"{name}: listener", 1e3 * self.cpu_s / max(self.sound_s, 1e-9), "CPU ms per s"),
        ]

    def _off_share(self) -> float:
        return float(np.mean(np.abs(self.error_s) > SAME_PLACE_S)) if self.error_s else 0.0


def _quantiles(name: str, values: Sequence[float], scale: float, unit: str) -> list[Row]:
    if not values:
        return [(f"{name} p50", float("nan"), unit)]
    p50, p95, top = np.percentile(np.abs(values) * scale, (50, 95, 100))
    return [
        (f"{name} p50", float(p50), unit),
        (f"{name} p95", float(p95), unit),
        (f"{name} max", float(top), unit),
    ]


def listen(matcher: AlignmentMatcher, sound: Recording) -> tuple[list[Heard], float]:
    """Let the listener hear a recording on simulated time.

    Returns:
        Its MUSIC_MATCH messages, and its processor time [s].
    """
    clock = SimClock()
    begin = clock.utime()
    hub = MemqHub()
    node = ListenerNode(hub.endpoint("listener", clock), FileSource(sound, begin), matcher)
    watcher = hub.endpoint("watcher", clock)
    watcher.subscribe("MUSIC_MATCH")
    heard: list[Heard] = []
    spent_s = 0.0
    end = begin + round(sound.duration_s * 1e6)
    for utime in range(begin, end, node.period_us):
        clock.advance_to(utime)
        before = time.process_time()
        node.step(utime)
        spent_s += time.process_time() - before
        watcher.pump()
        for received in watcher.take("MUSIC_MATCH"):
            msg = received.msg
            time_s = (utime - begin) * 1e-6
            tau_s = (utime - int(msg.track_zero_utime)) * 1e-6 * msg.rate
            zero_s = time_s - tau_s
            heard.append(Heard(time_s, int(msg.lock), msg.track, zero_s))
    return heard, spent_s


def measure_cuts(
    matcher: AlignmentMatcher,
    recordings: Mapping[str, Recording],
    seeds: Sequence[int],
    condition: Condition | None = None,
    sections: int = SECTIONS,
) -> CutReport:
    """Play a mashup per seed and judge every cut."""
    report = CutReport()
    # The skills are of no concern here, but neighbours must differ in them.
    tracks = {
        n: Track(n, n, BeatGrid(120.0), duration_s=r.duration_s) for n, r in recordings.items()
    }
    references = {n: ft.to_matcher_rate(r.samples, r.sample_rate_hz) for n, r in recordings.items()}
    for seed in seeds:
        set_list, _ = seeded_set_list(tracks, recordings, SECTION_S, sections, seed)
        mashup = build_mashup(set_list, tracks, recordings, False)
        samples = mashup.samples
        if condition is not None:
            samples = condition(samples, SAMPLE_RATE_HZ, np.random.default_rng(seed))
        heard, spent_s = listen(matcher, Recording("mashup", samples, SAMPLE_RATE_HZ))
        clean = ft.to_matcher_rate(mashup.samples, SAMPLE_RATE_HZ)
        report.cpu_s += spent_s
        report.sound_s += len(samples) / SAMPLE_RATE_HZ
        previous = ""
        for row in mashup.truth["segments"]:
            inside = [h for h in heard if row["start_s"] <= h.time_s < row["end_s"]]
            _judge(report, row, previous, inside, clean, references)
            previous = row["track"]
    return report


def _judge(
    report: CutReport,
    row: Mapping[str, float | str],
    previous: str,
    heard: Sequence[Heard],
    clean: F32,
    references: Mapping[str, F32],
) -> None:
    """Add one section to the report."""
    track, start_s = str(row["track"]), float(row["start_s"])
    zero_s = start_s - float(row["track_from_s"])
    right = [h for h in heard if h.lock == music_match_t.LOCKED and h.track == track]
    first_s = right[0].time_s if right else float("nan")
    report.lock_s.append(first_s - start_s)
    released = [h for h in heard if h.lock != music_match_t.LOCKED or h.track != previous]
    if previous and released:
        report.release_s.append(released[0].time_s - start_s)
    before = (music_match_t.LOCKED, previous)
    for hop in heard:
        taken = hop.lock == music_match_t.LOCKED and (hop.lock, hop.track) != before
        report.wrong_locks += taken and hop.track != track
        before = (hop.lock, hop.track)
    report.held += len(right)
    report.hops += sum(h.time_s >= first_s for h in heard)
    for hop in right:
        if hop.time_s < first_s + SETTLED_S:
            continue
        error_s = hop.track_zero_s - zero_s
        report.error_s.append(error_s)
        if abs(error_s) > SAME_PLACE_S:
            window_s = (max(start_s, hop.time_s - COMPARE_S), hop.time_s)
            lag_s = _lag_of_same_sound(clean, references[track], window_s, hop.track_zero_s)
            report.elsewhere += lag_s is None
            if lag_s is None:
                continue
            error_s = lag_s
        report.same_sound_error_s.append(error_s)


def _lag_of_same_sound(
    heard: F32, reference: F32, window_s: tuple[float, float], zero_s: float
) -> float | None:
    """Return how far the reference at the believed place lags the sound, None if it is another."""
    rate = ft.SAMPLE_RATE_HZ
    begin, end = (round(t * rate) for t in window_s)
    reach = round(SAME_PLACE_S * rate)
    first = begin - round(zero_s * rate) - reach
    part = np.zeros(end - begin + 2 * reach, np.float32)
    low, high = max(first, 0), min(first + len(part), len(reference))
    if high <= low:
        return None
    part[low - first : high - first] = reference[low:high]
    window = heard[begin:end]
    products = fftconvolve(part, window[::-1], "valid")  # (2 reach + 1,)
    power = np.concatenate([[0.0], np.cumsum(part.astype(np.float64) ** 2)])
    energy = power[len(window) :] - power[: -len(window)]
    likeness = products / np.sqrt(energy * float((window.astype(np.float64) ** 2).sum()) + 1e-12)
    best = int(likeness.argmax())
    return (best - reach) / rate if likeness[best] >= SAME_SOUND else None
