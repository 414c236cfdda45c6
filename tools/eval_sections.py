"""`downbeat eval sections`: are the cuts of a mashup heard without knowing its tracks?"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import soxr
from rich.console import Console
from rich.progress import track as progress
from rich.table import Table

from downbeat.perception import section_features as sf
from downbeat.perception.features import F32
from downbeat.perception.section_finder import SectionFinder, Weights
from downbeat.perception.source import Recording
from downbeat.tools.errors import ToolError
from downbeat.tools.matcher_sounds import load_folder

BLOCK = 800
"""Samples handed over at once: 50 ms, as the listener does."""
NEAR_S, CLOSE_S, ROUGH_S = 0.5, 0.1, 1.0
LEVEL_DB = 6.0
"""Pieces are cut together at levels that differ by at most this much."""
MIN_RMS = 0.003
LEAD_S = 5.0
"""What happens in the first seconds of a mashup is not judged: nobody knows the first piece yet."""


@dataclass
class SectionScore:
    """Cuts found, and what was found besides.

    Attributes:
        cuts: In the sound.
        found: Of them, within 0.5 s.
        close, rough: Of the cuts, those found within 0.1 s, and within 1 s.
        told: Changes told.
        error_s, latency_s: Of the cuts found [s].
        seconds: Of sound.
    """

    cuts: int = 0
    found: int = 0
    close: int = 0
    rough: int = 0
    told: int = 0
    error_s: list[float] = field(default_factory=list)
    latency_s: list[float] = field(default_factory=list)
    seconds: float = 0.0

    @property
    def recall(self) -> float:
        """Share of the cuts that were found."""
        return self.found / max(self.cuts, 1)

    @property
    def precision(self) -> float:
        """Share of what was told that is a cut."""
        return self.found / max(self.told, 1)

    def add(self, told: Sequence[tuple[float, float]], cuts_s: Sequence[float]) -> None:
        """Count one mashup; `told`: (where, when it was told) [s]."""
        counted = [t for t in told if t[0] > LEAD_S]
        self.told += len(counted)
        self.cuts += len(cuts_s)
        for cut, (where, when) in _matched(counted, cuts_s, NEAR_S):
            self.found += 1
            self.close += abs(where - cut) <= CLOSE_S
            self.error_s.append(abs(where - cut))
            self.latency_s.append(when - cut)
        self.rough += len(_matched(counted, cuts_s, ROUGH_S))

    def text(self) -> str:
        """Return the score in a line."""
        return (
            f"recall {self.recall:.1%} of {self.cuts}, precision {self.precision:.1%} of "
            f"{self.told}, within 0.1 s {self.close / max(self.cuts, 1):.1%}"
        )

    def as_json(self) -> dict[str, Any]:
        """Return the score as plain values."""
        p50, p95 = np.percentile(self.latency_s or [np.nan], (50, 95))
        return {
            "cuts": self.cuts,
            "told": self.told,
            "recall": round(self.recall, 4),
            "recall_95": interval(self.found, self.cuts),
            "precision": round(self.precision, 4),
            "precision_95": interval(self.found, self.told),
            "within_0.1_s": round(self.close / max(self.cuts, 1), 4),
            "within_1_s": round(self.rough / max(self.cuts, 1), 4),
            "latency_s": {"p50": round(float(p50), 2), "p95": round(float(p95), 2)},
        }


def _matched(
    told: Sequence[tuple[float, float]], cuts_s: Sequence[float], near_s: float
) -> list[tuple[float, tuple[float, float]]]:
    """Return (cut, what was told of it): the nearest, each only once."""
    left, pairs = list(told), []
    for cut in cuts_s:
        near = [t for t in left if abs(t[0] - cut) <= near_s]
        if near:
            best = min(near, key=lambda t: abs(t[0] - cut))
            left.remove(best)
            pairs.append((cut, best))
    return pairs


def interval(count: int, total: int) -> tuple[float, float]:
    """Return the 95 % interval of a share (Wilson)."""
    if not total:
        return 0.0, 1.0
    z, share = 1.96, count / total
    middle = (share + z * z / (2 * total)) / (1.0 + z * z / total)
    half = z * np.sqrt(share * (1.0 - share) / total + (z / (2.0 * total)) ** 2)
    half /= 1.0 + z * z / total
    return round(float(max(0.0, middle - half)), 4), round(float(min(1.0, middle + half)), 4)


def sound_of(folder: Path) -> list[Recording]:
    """Return the recordings of a folder at 16 kHz, those too short to cut from left out.

    Raises:
        ToolError: Fewer than two of them.
    """
    found = []
    for recording in load_folder(folder).values():
        samples = soxr.resample(recording.samples, recording.sample_rate_hz, sf.RATE_HZ)
        found.append(Recording(recording.name, np.asarray(samples, np.float32), sf.RATE_HZ))
    found = [one for one in found if one.duration_s >= 31.0]
    if len(found) < 2:
        raise ToolError(f"{folder} holds fewer than two recordings of 31 s or more to cut from.")
    return found


def mashup_of(
    tracks: Sequence[Recording],
    seconds: float,
    section_s: tuple[float, float],
    rng: np.random.Generator,
    fade_s: float = 0.0,
) -> tuple[F32, list[float]]:
    """Return (samples at 16 kHz, cuts [s]): passages of tracks, no two alike in a row.

    Args:
        tracks: At 16 kHz.
        seconds: Length, at least.
        section_s: Shortest and longest section [s].
        rng: Chooses tracks, passages and levels.
        fade_s: Over which one section fades into the next [s]; the cut is in its middle.
    """
    parts: list[F32] = []
    cuts: list[float] = []
    length, last = 0, -1
    while length < seconds * sf.RATE_HZ:
        number = int(rng.integers(len(tracks)))
        track = tracks[number]
        count = round(float(rng.uniform(*section_s)) * sf.RATE_HZ)
        count = min(count, len(track.samples))
        first = int(rng.integers(len(track.samples) - count + 1))
        part = track.samples[first : first + count]
        quarters = part[: len(part) // 8 * 8].reshape(8, -1).astype(np.float64)
        loud = float(np.sqrt((quarters**2).mean(1)).min())
        if number == last or loud < MIN_RMS:
            continue
        if parts:
            cuts.append(length / sf.RATE_HZ - 0.5 * fade_s)
        gain = 10.0 ** (float(rng.uniform(-LEVEL_DB, LEVEL_DB)) / 20.0)
        part = part * np.float32(gain)
        if parts and fade_s:
            part = _fade(parts[-1], part, round(fade_s * sf.RATE_HZ))
        parts.append(part)
        length += len(part)
        last = number
    return np.concatenate(parts), cuts


def _fade(before: F32, after: F32, count: int) -> F32:
    """Fade the end of a section into the next, at equal power; returns what is left of that."""
    rise = np.sqrt(np.linspace(0.0, 1.0, count, dtype=np.float32))
    before[-count:] = before[-count:] * rise[::-1] + after[:count] * rise
    return after[count:]


def find_changes(sound: F32, weights: Weights | None = None) -> list[tuple[float, float]]:
    """Return (where, when it was told) [s] of every change that is found in a sound."""
    finder = SectionFinder(weights)
    told = []
    for first in range(0, len(sound), BLOCK):
        block = sound[first : first + BLOCK]
        change = finder.hear(block, round(first * 1e6 / sf.RATE_HZ))
        if change is not None:
            told.append((change.utime * 1e-6, (first + len(block)) / sf.RATE_HZ))
    return told


def eval_sections(
    folder: Path,
    section_s: tuple[float, ...],
    mashups: int,
    seed: int,
    as_json: bool,
    fade_s: float = 0.0,
) -> int:
    """Score mashups of a folder with sections of each length; 0."""
    tracks = sound_of(folder)
    rows: dict[str, Any] = {}
    spent_s = heard_s = 0.0
    for length_s in section_s:
        score = SectionScore()
        numbers = range(mashups)
        for number in progress(numbers, f"{length_s:g} s", disable=as_json, transient=True):
            rng = np.random.default_rng([seed, number, round(length_s * 1000)])
            sound, cuts = mashup_of(tracks, 6.0 * length_s, (length_s, length_s), rng, fade_s)
            begin = time.process_time()
            told = find_changes(sound)
            spent_s += time.process_time() - begin
            heard_s += len(sound) / sf.RATE_HZ
            score.add(told, cuts)
        rows[f"{length_s:g}"] = score.as_json()
    result = {"sections": rows, "share_of_core": round(spent_s / heard_s, 4), "seed": seed}
    if as_json:
        print(json.dumps(result))
        return 0
    table = Table("sections", "cuts", "told", "recall", "precision", "within 0.1 s", "latency p95")
    for name, row in rows.items():
        table.add_row(
            f"{name} s", str(row["cuts"]), str(row["told"]), f"{row['recall']:.1%}",
            f"{row['precision']:.1%}", f"{row['within_0.1_s']:.1%}", f"{row['latency_s']['p95']} s",
        )  # fmt: skip
    console = Console()
    console.print(table)
    console.print(f"{spent_s / heard_s:.2%} of one core", highlight=False)
    return 0
