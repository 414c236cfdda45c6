"""`downbeat eval likeness`: does unknown music get the skill of music like it?

Every track in turn is unknown: it is taken out of the catalogue and asked for, window by window.
Two tracks of one group (game, composer, sound bank) should get the same skill, so the measure is
the share of windows whose nearest other track is of the own group, against what drawing a track
blindly gives. Groups are the only judgement of likeness that comes with recordings; they are
coarse, and nobody asked an audience. Besides: how high the own group ranks altogether, whether two
halves of one track agree about all the others, and whether a half finds the other one.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from downbeat.perception.clap_model import ClapEmbedder
from downbeat.perception.features import F32
from downbeat.perception.likeness import Embedder, is_sounding, unit
from downbeat.perception.likeness_build import embed_recording
from downbeat.perception.likeness_embedded import EmbeddedDescriptor
from downbeat.perception.likeness_store import LikenessTable
from downbeat.perception.source import Recording, audio_files, load_recording
from downbeat.runtime.errors import one_of
from downbeat.tools.conditions import degradations
from downbeat.tools.errors import ToolError
from downbeat.tools.likeness_score import Heard, score

QUERIES = 8
"""Per track, evenly spread."""
DEGRADED_RATE_HZ = 16_000
"""What the robot hears; other sound is asked for at the rate of its file."""


@dataclass(frozen=True)
class LikenessOptions:
    """What `downbeat eval likeness` was asked."""

    tracks: Path
    groups: Path
    seconds: float = 5.0
    condition: str = "clean"
    speech: Path | None = None
    clap: Path | None = None
    seed: int = 0


def eval_likeness(options: LikenessOptions, as_json: bool) -> int:
    """`downbeat eval likeness`."""
    groups = read_groups(options.groups)
    recordings = _recordings(options.tracks, groups)
    embedder: Embedder = ClapEmbedder(options.clap) if options.clap else EmbeddedDescriptor()
    heard = hear(recordings, groups, embedder, options)
    report = {
        "backend": embedder.name, "condition": options.condition, "seconds": options.seconds,
        "left_out": left_out(options.tracks, heard),
        **score(heard, options.seed),
    }  # fmt: skip
    if as_json:
        print(json.dumps(report))
    else:
        _print(report)
    return 0


def read_groups(path: Path) -> dict[str, str]:
    """Return the group of each track of a tab-separated file (track, group).

    Raises:
        ToolError: The file is missing, or a line is something else.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ToolError(f"{path} cannot be read: {error}.") from error
    groups: dict[str, str] = {}
    for number, line in enumerate(lines, 1):
        cells = line.split("\t")
        if not line.strip():
            continue
        if len(cells) < 2 or not cells[0] or not cells[1].strip():
            raise ToolError(f"{path}:{number} is '{line}'; expected: track, tab, group.")
        groups[cells[0]] = cells[1].strip()
    return groups


def left_out(folder: Path, heard: Heard) -> list[str]:
    """Return recordings that are in no group, silent, or under 20 s: too short for halves."""
    return sorted({p.stem for p in audio_files(folder)} - set(heard.tables[0].names))


def _recordings(folder: Path, groups: Mapping[str, str]) -> list[Recording]:
    found = [load_recording(p) for p in audio_files(folder) if p.stem in groups]
    found = [r for r in found if r.duration_s >= 20.0 and is_sounding(r.samples)]
    if len(found) < 3:
        raise ToolError(
            f"{folder} holds {len(found)} recordings of 20 s or more that the groups name; "
            "at least 3 are needed."
        )
    return found


def hear(
    recordings: list[Recording],
    groups: Mapping[str, str],
    embedder: Embedder,
    options: LikenessOptions,
) -> Heard:
    """Embed whole tracks, their halves, and the queries."""
    degrade = _condition(options)
    tables = tuple(LikenessTable(embedder.digest) for _ in range(3))
    queries, owners, times = [], [], []
    for number, recording in enumerate(recordings):
        half, rate = len(recording.samples) // 2, recording.sample_rate_hz
        parts = (recording.samples[:half], recording.samples[half:])
        vectors = [embed_recording(embedder, Recording(recording.name, p, rate)) for p in parts]
        if any(v is None for v in vectors):
            continue
        for table, rows in zip(tables, (np.concatenate(vectors), *vectors), strict=True):
            table.names.append(recording.name)
            table.sounds.append("")
            table.vectors.append(rows)
        rng = np.random.default_rng([options.seed, number])
        for piece in _pieces(recording, options.seconds):
            sound, sound_rate = degrade(piece, rate, rng)
            began = time.process_time()
            vector = _query(embedder, sound, sound_rate)
            times.append(1e3 * (time.process_time() - began))
            queries.append(vector)
            owners.append(len(tables[0].names) - 1)
    own = [groups[name] for name in tables[0].names]
    return Heard(own, tables, np.array(queries, np.float32), np.array(owners), times)


def _pieces(recording: Recording, seconds: float) -> list[F32]:
    length = round(seconds * recording.sample_rate_hz)
    last = max(0, len(recording.samples) - length)
    starts = np.linspace(0.02 * last, 0.98 * last, QUERIES).astype(int)
    pieces = [recording.samples[s : s + length] for s in starts]
    return [p for p in pieces if is_sounding(p)]


def _query(embedder: Embedder, sound: F32, rate: int) -> F32:
    """Return the unit vector of a query, as the listener makes it: the mean of its windows."""
    window = round(embedder.window_s * rate)
    count = max(1, len(sound) // window)
    rows = [embedder.embed(sound[i * window : (i + 1) * window], rate) for i in range(count)]
    return unit(np.mean(rows, axis=0))


def _condition(options: LikenessOptions) -> Callable[..., tuple[F32, int]]:
    if options.condition == "clean":
        return lambda sound, rate, _rng: (sound, rate)
    babble = None if options.speech is None else babble_of(options.speech)
    known = {d.name: d for d in degradations(babble)}
    if options.condition not in known:
        more = "" if options.speech else "; `robot` and babble need --speech"
        raise ToolError(f"No condition '{options.condition}'; there are {one_of(known)}{more}.")
    apply = known[options.condition].apply

    def degrade(sound: F32, rate: int, rng: np.random.Generator) -> tuple[F32, int]:
        at_robot = to_rate(sound, rate)
        return np.resize(apply(at_robot, DEGRADED_RATE_HZ, rng), len(at_robot)), DEGRADED_RATE_HZ

    return degrade


def babble_of(folder: Path) -> F32:
    """Return all voices of a folder at once, 30 s at 16 kHz, (n,)."""
    total = np.zeros(30 * DEGRADED_RATE_HZ, np.float32)
    for path in audio_files(folder)[:8]:
        voice = load_recording(path)
        sound = to_rate(voice.samples, voice.sample_rate_hz)
        total += np.resize(sound / (np.std(sound) + 1e-9), len(total))
    return total


def to_rate(samples: F32, sample_rate_hz: int) -> F32:
    """Resample to 16 kHz."""
    import soxr

    return np.asarray(soxr.resample(samples, sample_rate_hz, DEGRADED_RATE_HZ), np.float32)


def _print(report: Mapping[str, Any]) -> None:
    print(
        f"{report['backend']}, {report['condition']}, {report['seconds']:g} s: "
        f"{report['queries']} queries of {report['tracks']} tracks, each out of the catalogue; "
        f"{len(report['left_out'])} recordings left out (no group, silent, or under 20 s)"
    )
    rows = {
        "nearest track is of the own group": "group_top1",
        "  above chance": "group_top1_above_chance",
        "own group ranks above others (-1..1)": "group_rank",
        "two halves rank alike (Kendall)": "halves_kendall",
        "  above halves of two tracks": "halves_kendall_above_strangers",
        "two halves choose the same track": "halves_same_choice",
        "a half finds the other one": "other_half_top1",
    }
    for label, key in rows.items():
        row = report[key]
        low, high = row["ci95"]
        print(
            f"{label:38} {row['mean']:6.3f}  95 % {low:.3f}..{high:.3f}  chance {row['chance']:.3f}"
        )
    by_group = ", ".join(f"{g} {v:.2f}" for g, v in report["group_top1_by_group"].items())
    print(
        f"by group: {by_group}; groups dealt at random fit as well: p {report['permutation_p']:.4f}"
    )
    print(
        f"query: p50 {report['query_ms']['p50']} ms, p99 {report['query_ms']['p99']} ms of one core"
    )
