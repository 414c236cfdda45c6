"""`downbeat eval follow`: how well unknown music's beat is followed while it plays."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import soxr

from downbeat.catalog.beatgrid import BeatGrid
from downbeat.perception.beat_follower import BeatFollower
from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32
from downbeat.perception.onset_stream import F64, SAMPLE_RATE_HZ
from downbeat.perception.source import Recording, audio_files, load_recording
from downbeat.tools.composer.store import COMPOSITIONS, composed_recording, form
from downbeat.tools.conditions import degradations
from downbeat.tools.errors import ToolError
from downbeat.tools.follow_reference import Reference, f_measure, find_reference, octaves
from downbeat.tools.matcher_sounds import load_folder, make_babble
from downbeat.tools.rundir import CACHE_DIR

BLOCK = 800
"""50 ms, as the listener hears."""
LATENCY_S = 0.05
"""The clock is read this long after the last sample that was heard sounded."""
EVERY_BLOCKS = 2
JUDGED_FROM_S = 8.0
P50_MS, P95_MS = 40.0, 90.0
SAME_TEMPO = 0.04
OFFBEAT_SHARE = 0.35
"""An error beyond this share of a beat is an offbeat."""
BABBLE_S = 60.0
SEED = 5
Hears = Callable[[F32, np.random.Generator], F32]


@dataclass(frozen=True)
class Followed:
    """The clock of one recording, read every 0.1 s.

    Attributes:
        time_s: (n,) when it was read, in the recording.
        beat_s: (n,) the beat nearest to it; NaN while searching.
        period_s: (n,).
        confidence: (n,), 0 while searching.
        is_steady: (n,) bool.
        cpu_s: Time it took to hear.
    """

    time_s: F64
    beat_s: F64
    period_s: F64
    confidence: F64
    is_steady: np.ndarray
    cpu_s: float

    @property
    def beats_s(self) -> F64:
        """The beats as the clock passed them while it was steady, (n,)."""
        found: list[float] = []
        for now, beat, period in zip(
            self.time_s[self.is_steady],
            self.beat_s[self.is_steady],
            self.period_s[self.is_steady],
            strict=True,
        ):
            passed = beat - period if beat > now else beat
            if not found or passed > found[-1] + 0.5 * period:
                found.append(passed)
        return np.array(found)


def follow(sound: F32, start_s: float = 0.0) -> Followed:
    """Hear a recording in blocks of 50 ms and read the clock.

    Args:
        sound: (n,) mono, 16 kHz.
        start_s: Where to begin.
    """
    follower = BeatFollower()
    rows = []
    first = round(start_s * SAMPLE_RATE_HZ)
    zero_utime = 1_700_000_000_000_000
    begin = time.process_time()
    for number, at in enumerate(range(first, len(sound) - BLOCK + 1, BLOCK)):
        follower.hear(sound[at : at + BLOCK], zero_utime + at * 1_000_000 // SAMPLE_RATE_HZ)
        if number % EVERY_BLOCKS == EVERY_BLOCKS - 1:
            now_s = (at + BLOCK) / SAMPLE_RATE_HZ + LATENCY_S
            beat = follower.beat(zero_utime + round(now_s * 1e6))
            if beat is None:
                rows.append((now_s, np.nan, np.nan, 0.0, False))
            else:
                beat_s = (beat.beat_utime - zero_utime) * 1e-6
                rows.append((now_s, beat_s, beat.period_s, beat.confidence, beat.is_steady))
    cpu_s = time.process_time() - begin
    if not rows:
        rows = [(start_s, np.nan, np.nan, 0.0, False)]
    columns = np.array(rows, np.float64).T
    time_s, beat_s, period_s, confidence, steady = columns
    return Followed(time_s, beat_s, period_s, confidence, steady > 0.0, cpu_s)


def beat_errors(followed: Followed, reference: Reference) -> tuple[F64, F64, np.ndarray]:
    """Compare the clock with the reference, each time it was read.

    At the same tempo or an octave of it the error counts modulo the shorter of both beats, as a
    dance at half the tempo is in time on every other beat. At any other tempo it counts modulo
    the reference's beat.

    Returns:
        Errors (n,) [s], NaN while searching; what they are modulo (n,) [s]; whether the tempo is
        the reference's or an octave of it (n,).
    """
    grid = reference.grid
    beats = np.array([grid.beats_at(b) if np.isfinite(b) else np.nan for b in followed.beat_s])
    true_s = np.array([60.0 / grid.bpm_at(t) for t in followed.time_s])
    ratio = np.log2(followed.period_s / true_s)
    same = np.abs(ratio - np.round(ratio)) * np.log(2.0) < SAME_TEMPO
    modulo_s = np.where(same, np.minimum(followed.period_s, true_s), true_s)
    off_s = (beats - np.floor(beats)) * true_s
    error_s = np.abs((off_s + 0.5 * modulo_s) % modulo_s - 0.5 * modulo_s)
    return error_s, modulo_s, same


def score(followed: Followed, reference: Reference, start_s: float = 0.0) -> dict[str, Any]:
    """Return the figures of one recording; errors as arrays of milliseconds."""
    error_s, modulo_s, same = beat_errors(followed, reference)
    steady = followed.is_steady
    late = followed.time_s - start_s >= JUDGED_FROM_S
    judged_s = (start_s + JUDGED_FROM_S, followed.time_s[-1])
    beats = _within(followed.beats_s, *judged_s)
    true = [_within(t, *judged_s) for t in _same_octave(followed, reference)]
    return {
        "bpm": reference.grid.tempo_bpm,
        "followed_bpm": _or_none(60.0 / np.nanmedian(followed.period_s)) if steady.any() else None,
        "error_ms": 1e3 * error_s[steady],
        "offbeat": (same & (error_s > OFFBEAT_SHARE * modulo_s))[steady],
        "wrong_tempo": ~same[steady],
        "late_steady": steady[late],
        "first_s": float(followed.time_s[steady][0] - start_s) if steady.any() else None,
        "f_measure": max(f_measure(beats, t) for t in true),
        "cpu_share": followed.cpu_s / max(followed.time_s[-1] - start_s, 1e-9),
    }


def _same_octave(followed: Followed, reference: Reference) -> list[F64]:
    """Return the reference's beats at the octave of the clock; at half tempo, both choices."""
    same, doubled, first, second = octaves(reference.beats_s)
    if not np.isfinite(followed.period_s).any():
        return [same]
    bpm = 60.0 / float(np.nanmedian(followed.period_s))
    ratio = np.log2(bpm / reference.grid.tempo_bpm)
    return {1: [doubled], -1: [first, second]}.get(round(ratio), [same])


def _within(beats_s: F64, first_s: float, last_s: float) -> F64:
    return beats_s[(beats_s >= first_s) & (beats_s <= last_s)]


def total(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the figures of many recordings together."""
    if not rows:
        return {"tracks": 0}
    errors = np.concatenate([r["error_ms"] for r in rows])
    offbeat = np.concatenate([r["offbeat"] for r in rows])
    wrong = np.concatenate([r["wrong_tempo"] for r in rows])
    first = np.array([np.inf if r["first_s"] is None else r["first_s"] for r in rows])
    f_measures = np.array([r["f_measure"] for r in rows])
    bad = [r for r in rows if len(r["error_ms"]) and np.median(r["error_ms"]) > P95_MS]
    return {
        "tracks": len(rows),
        "readings": len(errors),
        "error_ms": {p: _percentile(errors, p) for p in ("p50", "p90", "p95")},
        "over_90_ms": float(np.mean(errors > P95_MS)) if len(errors) else None,
        "offbeat": float(offbeat.mean()) if len(errors) else None,
        "wrong_tempo": float(wrong.mean()) if len(errors) else None,
        "following": float(np.concatenate([r["late_steady"] for r in rows]).mean()),
        "first_s": {"p50": _percentile(first, "p50"), "p95": _percentile(first, "p95")},
        "never": int(np.isinf(first).sum()),
        "f_measure": {"mean": float(f_measures.mean()), "p50": float(np.median(f_measures))},
        "tracks_wrong": len(bad),
        "cpu_share": float(np.mean([r["cpu_share"] for r in rows])),
    }


def _percentile(values: F64, name: str) -> float | None:
    if len(values) == 0:
        return None
    return _or_none(np.percentile(values, float(name[1:]), method="lower"))


def _or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def robot_hears(speech: Path) -> Hears:
    """Return the robot's microphone among the voices of a folder."""
    voices = [
        soxr.resample(r.samples, r.sample_rate_hz, SAMPLE_RATE_HZ)
        for r in load_folder(speech).values()
    ]
    babble = make_babble(voices, BABBLE_S, SAMPLE_RATE_HZ)
    robot = next(d for d in degradations(babble) if d.name == "robot")
    return lambda sound, rng: robot.apply(sound, SAMPLE_RATE_HZ, rng)


def sounds(tracks: Path | None) -> list[tuple[Recording, Reference]]:
    """Return recordings with their references: a folder's, or the bundled pieces' true beats."""
    if tracks is None:
        pieces = [composed_recording(name, CACHE_DIR / "tracks") for name in COMPOSITIONS]
        grids = [BeatGrid(form(name).bpm) for name in COMPOSITIONS]
        none = np.zeros(0)
        return [(p, Reference(g, none, p.duration_s)) for p, g in zip(pieces, grids, strict=True)]
    found = []
    for path in audio_files(tracks):
        try:
            recording = load_recording(path)
        except PerceptionError as error:
            print(f"left out: {error}", file=sys.stderr)
            continue
        found.append((recording, find_reference(recording)))
    return found


def run_eval_follow(tracks: Path | None, speech: Path | None, start_s: float, as_json: bool) -> int:
    """Follow every recording and print the figures.

    Args:
        tracks: Folder of recordings; None: the bundled pieces.
        speech: Folder of voices: hear through the robot's microphone among them.
        start_s: Begin in the middle.
        as_json: Print one JSON object.

    Returns:
        0 if the phase errors of recordings with a steady beat are within the targets.
    """
    if start_s < 0.0:
        raise ToolError(f"--start-s {start_s:g} must be at least 0 seconds.")
    hears = robot_hears(speech) if speech is not None else None
    rng = np.random.default_rng(SEED)
    steady: dict[str, dict[str, Any]] = {}
    free: dict[str, dict[str, Any]] = {}
    for recording, reference in sounds(tracks):
        sound = soxr.resample(recording.samples, recording.sample_rate_hz, SAMPLE_RATE_HZ)
        sound = np.asarray(sound, np.float32)
        if hears is not None:
            sound = hears(sound, rng)
        row = score(follow(sound, start_s), reference, start_s)
        row["agreement"] = reference.agreement
        (steady if reference.is_steady else free)[recording.name] = row
    report = {"steady": total(list(steady.values())), "other": total(list(free.values()))}
    if as_json:
        report["per_track"] = {n: _plain(r) for n, r in (steady | free).items()}
        print(json.dumps(report))
    else:
        _print(report, steady, free)
    error = report["steady"].get("error_ms", {})
    reached = (error.get("p50") or 0.0) <= P50_MS and (error.get("p95") or 0.0) <= P95_MS
    return 0 if reached else 1


def _plain(row: dict[str, Any]) -> dict[str, Any]:
    plain = {k: v for k, v in row.items() if not isinstance(v, np.ndarray)}
    plain["error_ms"] = {p: _percentile(row["error_ms"], p) for p in ("p50", "p95")}
    plain["offbeat"] = float(row["offbeat"].mean()) if len(row["offbeat"]) else None
    plain["wrong_tempo"] = float(row["wrong_tempo"].mean()) if len(row["wrong_tempo"]) else None
    plain["following"] = float(row["late_steady"].mean()) if len(row["late_steady"]) else None
    return plain


def _print(report: dict[str, Any], steady: dict[str, Any], free: dict[str, Any]) -> None:
    print(
        f"{'recording':36} {'BPM':>6} {'as':>6} {'from s':>6} {'held':>5} {'p50':>6} {'p95':>6} F"
    )
    for title, rows in (("steady beat", steady), ("no steady beat by the offline analyses", free)):
        print(f"-- {title}")
        for name, row in rows.items():
            plain = _plain(row)
            cells = [row["bpm"], row["followed_bpm"], row["first_s"], plain["following"]]
            cells += [plain["error_ms"]["p50"], plain["error_ms"]["p95"]]
            texts = ["-" if c is None else f"{c:.2f}" if c < 2.0 else f"{c:.1f}" for c in cells]
            a, b, c, d, e, f = texts
            print(f"{name:36} {a:>6} {b:>6} {c:>6} {d:>5} {e:>6} {f:>6} {row['f_measure']:.2f}")
    for title in ("steady", "other"):
        print(title, json.dumps(report[title]))
