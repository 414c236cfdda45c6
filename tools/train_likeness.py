"""`python -m downbeat.tools.train_likeness`: learn the map of the embedded descriptor.

Linear discriminant analysis with recordings as classes: windows of one recording, clean and
degraded, should fall together. Nothing about style or origin of a recording is told; the groups
only choose what is held apart when the script reports on recordings it was not trained on.
"""

from __future__ import annotations

import argparse
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from downbeat.perception.features import F32
from downbeat.perception.likeness import is_sounding, unit
from downbeat.perception.likeness_embedded import FORMAT, WEIGHTS, project
from downbeat.perception.likeness_features import SAMPLE_RATE_HZ, describe, to_descriptor_rate
from downbeat.perception.likeness_store import LikenessTable
from downbeat.perception.source import audio_files, load_recording
from downbeat.tools.conditions import Degradation, degradations
from downbeat.tools.errors import ToolError
from downbeat.tools.eval_likeness import babble_of, read_groups

DIM = 64
SHRINK = 0.5
"""Of the scatter within recordings, towards a multiple of the identity: 312 numbers, few pieces."""
WINDOW_S, HOP_S = 5.0, 2.5
DEGRADED = ("robot", "pink0", "reverb0.5", "tempo-4%")
EVERY = {"robot": 2, "pink0": 4, "reverb0.5": 4, "tempo-4%": 4}
"""Every so many windows are heard in that condition, too."""
STRETCH = 1.1
"""More sound than a window, for conditions that make it shorter."""
DECIMALS = np.float16
MIN_GROUP = 4
"""Smaller ones are never held apart."""

Labels = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Examples:
    """Descriptors of windows.

    Attributes:
        names: Of the recordings.
        values: (n, d).
        owners: Per row the number of its recording, (n,).
        is_clean: Per row, (n,).
    """

    names: list[str]
    values: F32
    owners: Labels
    is_clean: npt.NDArray[np.bool_]


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, report on recordings held apart by group, write the weights."""
    parser = argparse.ArgumentParser(prog="python -m downbeat.tools.train_likeness")
    parser.add_argument("--tracks", type=Path, required=True, help="folder of recordings")
    parser.add_argument("--groups", type=Path, required=True, help="track, tab, group")
    parser.add_argument(
        "--speech", type=Path, help="folder of voices; without, no robot microphone"
    )
    parser.add_argument("--out", type=Path, default=WEIGHTS)
    parser.add_argument(
        "--features", type=Path, help="keep descriptors here (.npz) for another run"
    )
    args = parser.parse_args(arguments)
    groups = read_groups(args.groups)
    examples = _load(args.features) or gather(args.tracks, groups, args.speech)
    if args.features and not args.features.is_file():
        np.savez(
            args.features, names=np.array(examples.names), values=examples.values,
            owners=examples.owners, is_clean=examples.is_clean,
        )  # fmt: skip
    right, chance = held_apart(examples, groups)
    print(f"groups held apart in turn: the nearest track is of the own group {right:.3f}")
    print(f"chance: {chance:.3f}")
    mean, deviation, mapping = fit(examples.values, examples.owners)
    save(args.out, mean, deviation, mapping)
    print(f"written: {args.out} ({args.out.stat().st_size / 1e3:.0f} kB)")


def gather(folder: Path, groups: dict[str, str], speech: Path | None) -> Examples:
    """Describe windows of every recording that the groups name."""
    known = {d.name: d for d in degradations(babble_of(speech) if speech else None)}
    conditions = [known[name] for name in DEGRADED if name in known]
    paths = [p for p in audio_files(folder) if p.stem in groups]
    if len(paths) < 3:
        raise ToolError(
            f"{folder} holds {len(paths)} recordings that the groups name; 3 are needed."
        )
    values, owners, is_clean = [], [], []
    for number, path in enumerate(paths):
        recording = load_recording(path)
        sound = to_descriptor_rate(recording.samples, recording.sample_rate_hz)
        rng = np.random.default_rng(zlib.crc32(path.stem.encode()))
        for row, clean in _windows(sound, conditions, rng):
            values.append(row)
            owners.append(number)
            is_clean.append(clean)
        print(f"{number + 1}/{len(paths)} {path.stem}", flush=True)
    return Examples(
        [p.stem for p in paths], np.array(values, np.float32), np.array(owners), np.array(is_clean)
    )


def _windows(
    sound: F32, conditions: Sequence[Degradation], rng: np.random.Generator
) -> list[tuple[F32, bool]]:
    length, hop = round(WINDOW_S * SAMPLE_RATE_HZ), round(HOP_S * SAMPLE_RATE_HZ)
    rows = []
    for number, start in enumerate(range(0, len(sound) - length + 1, hop)):
        window = sound[start : start + length]
        if not is_sounding(window):
            continue
        rows.append((describe(window), True))
        longer = sound[start : start + round(STRETCH * length)]
        for condition in conditions:
            if number % EVERY[condition.name] == 0:
                heard = condition.apply(longer, SAMPLE_RATE_HZ, rng)[:length]
                if len(heard) == length:
                    rows.append((describe(np.asarray(heard, np.float32)), False))
    return rows


def fit(values: F32, owners: Labels) -> tuple[F32, F32, F32]:
    """Return mean (d,), deviation (d,) and map (d, DIM)."""
    mean, deviation = values.mean(axis=0), values.std(axis=0) + 1e-6
    standard = ((values - mean) / deviation).astype(np.float64)
    numbers = np.unique(owners)
    centres = np.array([standard[owners == n].mean(axis=0) for n in numbers])
    within = np.zeros((standard.shape[1],) * 2)
    for number, centre in zip(numbers, centres):
        rest = standard[owners == number] - centre
        within += rest.T @ rest / len(rest) / len(numbers)
    size = np.trace(within) / len(within)
    within = (1.0 - SHRINK) * within + SHRINK * size * np.eye(len(within))
    power, axes = np.linalg.eigh(within)
    whiten = axes / np.sqrt(power)
    between = whiten.T @ np.cov(centres.T) @ whiten
    _, turned = np.linalg.eigh(between)  # ascending
    mapping = whiten @ turned[:, ::-1][:, :DIM]
    return mean.astype(np.float32), deviation.astype(np.float32), mapping.astype(np.float32)


def held_apart(examples: Examples, groups: dict[str, str]) -> tuple[float, float]:
    """Train without each group in turn; return how well its tracks find each other, and chance."""
    group = np.array([groups[name] for name in examples.names])
    right, chance = [], []
    for name in np.unique(group):
        mine = np.flatnonzero(group == name)
        if len(mine) < MIN_GROUP:
            continue
        kept = ~np.isin(examples.owners, mine)
        parts = fit(examples.values[kept], examples.owners[kept])
        vectors = unit(project(examples.values, *parts))
        rows = [vectors[(examples.owners == i) & examples.is_clean] for i in range(len(group))]
        table = LikenessTable("", list(examples.names), [""] * len(group), rows)
        for track in mine:
            for query in rows[track][:: max(1, len(rows[track]) // 8)]:
                scores = table.scores(query)
                scores[track] = -np.inf
                right.append(group[np.argmax(scores)] == name)
                chance.append((len(mine) - 1) / (len(group) - 1))
    if not right:
        raise ToolError(f"No group has {MIN_GROUP} recordings: nothing can be held apart.")
    return float(np.mean(right)), float(np.mean(chance))


def save(path: Path, mean: F32, deviation: F32, mapping: F32) -> None:
    """Write the weights; the map needs no more than half precision."""
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        path, format=np.array(FORMAT), mean=mean, deviation=deviation,
        mapping=mapping.astype(DECIMALS),
    )  # fmt: skip


def _load(path: Path | None) -> Examples | None:
    if path is None or not path.is_file():
        return None
    with np.load(path, allow_pickle=False) as data:
        names = [str(n) for n in data["names"]]
        return Examples(names, data["values"], data["owners"], data["is_clean"])


if __name__ == "__main__":
    main()
