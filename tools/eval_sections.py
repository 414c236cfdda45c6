"""`downbeat eval sections`: are the cuts of a mashup heard without knowing its tracks?"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
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
from downbeat.tools.console import say
from downbeat.tools.errors import ToolError
from downbeat.tools.matcher_sounds import load_folder
from downbeat.tools.section_score import SectionScore

BLOCK = 800
"""Samples handed over at once: 50 ms, as the listener does."""
LEVEL_DB = 6.0
"""Pieces are cut together at levels that differ by at most this much."""
MIN_RMS = 0.003
MIN_RECORDING_S = 31.0
MIN_SECTION_S = 6.0
"""So that the first cut is judged: it comes after `section_score.LEAD_S`."""
MOST_DRAWS = 1000
"""Passages drawn in a row that do not do, until there seem to be none."""


def sound_of(folder: Path, say: Callable[[str], None] = say) -> list[Recording]:
    """Return the recordings of a folder at 16 kHz; what cannot be cut from is left out, named.

    Args:
        folder: Of audio files.
        say: Told of each file that cannot be read, and of all that are too short.

    Raises:
        ToolError: Fewer than two are left.
        PerceptionError: No folder of audio files.
    """
    found = load_folder(folder, say).values()
    long_enough = _at_least(MIN_RECORDING_S, list(found), str(folder), say)
    return [
        Recording(
            one.name,
            np.asarray(soxr.resample(one.samples, one.sample_rate_hz, sf.RATE_HZ), np.float32),
            sf.RATE_HZ,
        )
        for one in long_enough
    ]


def _at_least(
    seconds: float, tracks: Sequence[Recording], whose: str, say: Callable[[str], None]
) -> list[Recording]:
    """Return the recordings that are long enough, two or more; says which are not.

    Raises:
        ToolError: Fewer than two are.
    """
    kept = [one for one in tracks if one.duration_s >= seconds]
    short = [f"{one.name} ({one.duration_s:.1f} s)" for one in tracks if one.duration_s < seconds]
    if len(kept) < 2:
        longest = sorted((one.duration_s for one in tracks), reverse=True)
        possible = f"; the second longest has {longest[1]:.1f} s" if len(longest) > 1 else ""
        raise ToolError(
            f"{whose} holds {len(kept)} recording{'' if len(kept) == 1 else 's'} of {seconds:g} s "
            f"or more, two are needed to cut from{possible}."
        )
    if short:
        say(f"left out (shorter than {seconds:g} s): {', '.join(short)}")
    return kept


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

    Raises:
        ToolError: There are no two with a passage that is loud enough.
    """
    parts: list[F32] = []
    cuts: list[float] = []
    length, last, refused = 0, -1, 0
    while length < seconds * sf.RATE_HZ:
        number = int(rng.integers(len(tracks)))
        track = tracks[number]
        count = round(float(rng.uniform(*section_s)) * sf.RATE_HZ)
        count = min(count, len(track.samples))
        first = int(rng.integers(len(track.samples) - count + 1))
        part = track.samples[first : first + count]
        quarters = part[: len(part) // 8 * 8].reshape(8, -1).astype(np.float64)
        loud = float(np.sqrt((quarters**2).mean(1)).min())
        refused = refused + 1 if number == last or loud < MIN_RMS else 0
        if refused > MOST_DRAWS:
            raise ToolError(
                f"Of {len(tracks)} recordings no two have a passage of {section_s[0]:g} s that "
                f"sounds throughout (each eighth of it at {MIN_RMS:g} rms or more)."
            )
        if refused:
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
    """Score mashups of a folder with sections of each length; 0.

    Raises:
        ToolError: A length that cannot be judged, or fewer than two recordings that long.
        PerceptionError: No folder of audio files.
    """
    _check(section_s, mashups, fade_s)
    tracks = sound_of(folder)
    pools = {
        f"{length_s:g}": (length_s, _at_least(length_s, tracks, str(folder), say))
        for length_s in section_s
    }
    rows: dict[str, Any] = {}
    spent_s = heard_s = 0.0
    for name, (length_s, pool) in pools.items():
        score = SectionScore()
        numbers = range(mashups)
        for number in progress(numbers, f"{name} s", disable=as_json, transient=True):
            rng = np.random.default_rng([seed, number, round(length_s * 1000)])
            sound, cuts = mashup_of(pool, 6.0 * length_s, (length_s, length_s), rng, fade_s)
            begin = time.process_time()
            told = find_changes(sound)
            spent_s += time.process_time() - begin
            heard_s += len(sound) / sf.RATE_HZ
            score.add(told, cuts)
        rows[name] = score.as_json() | {"recordings": len(pool)}
    result = {"sections": rows, "share_of_core": round(spent_s / heard_s, 4), "seed": seed}
    if as_json:
        print(json.dumps(result))
    else:
        _print(result)
    return 0


def _check(section_s: Sequence[float], mashups: int, fade_s: float) -> None:
    """Refuse what cannot be judged.

    Raises:
        ToolError: It cannot.
    """
    if not section_s:
        raise ToolError("--section-seconds needs at least one length, e.g. 20.")
    for length_s in section_s:
        if not MIN_SECTION_S <= length_s < float("inf"):
            raise ToolError(
                f"--section-seconds {length_s:g} cannot be judged; valid are {MIN_SECTION_S:g} s "
                "and more, up to the length of the recordings."
            )
    longest_s = 0.5 * min(section_s)
    if not 0.0 <= fade_s <= longest_s:
        raise ToolError(
            f"--fade-seconds {fade_s:g} does not fit the sections; valid are 0 to half the "
            f"shortest of --section-seconds ({longest_s:g})."
        )
    if mashups < 1:
        raise ToolError(f"--mashups {mashups} must be at least 1.")


def _print(result: dict[str, Any]) -> None:
    table = Table("sections", "cuts", "told", "recall", "precision", "within 0.1 s", "latency p95")
    for name, row in result["sections"].items():
        table.add_row(
            f"{name} s", str(row["cuts"]), str(row["told"]), f"{row['recall']:.1%}",
            f"{row['precision']:.1%}", f"{row['within_0.1_s']:.1%}", f"{row['latency_s']['p95']} s",
        )  # fmt: skip
    console = Console()
    console.print(table)
    console.print(f"{result['share_of_core']:.2%} of one core", highlight=False)
