"""Learn to hear where one piece of music ends and another begins, from mashups of recordings.

`python -m downbeat.tools.train_sections --tracks DIR` cuts random mashups of a folder, learns on
seven eighths of its recordings, sets the threshold on the rest, and writes
perception/data/section_finder.npz. The figures of the report come from other recordings
(`downbeat eval sections`).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import soxr
from rich.progress import track as progress

from downbeat.perception import section_features as sf
from downbeat.perception.features import F32
from downbeat.perception.section_finder import (
    AFTER,
    MIN_PAST,
    NUM_INPUTS,
    PAST,
    WEIGHTS,
    Weights,
    describe,
    window_stats,
)
from downbeat.perception.source import Recording
from downbeat.tools.eval_sections import SectionScore, find_changes, mashup_of, sound_of

SECTIONS_S = (8.0, 30.0)
NEAR_FRAMES, CLEAR_FRAMES = 1, 14
"""A moment this near to a cut is one; up to the second it is neither."""
NEGATIVE_STRIDE = 4
LONG_SHARE = 0.8
"""Of the moments: with as much past as there may be; the others with less, as after a start."""
DIRECTIONS = 16
HIDDEN = (64, 16)
NETS, HELD = 4, 8
SPEEDS = (0.89, 1.0, 1.12)
"""Every recording is heard at these speeds, so that there seem to be more of them."""
MIN_PRECISION = 0.8
"""The threshold is the lowest that reaches it on recordings that were not learned."""


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tracks", type=Path, required=True, help="folder of recordings")
    parser.add_argument("--minutes", type=float, default=600.0, help="of mashups to learn from")
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--out", type=Path, default=WEIGHTS)
    args = parser.parse_args()
    tracks = sound_of(args.tracks)
    rng = np.random.default_rng(args.seed)
    order = rng.permutation(len(tracks))
    held = [tracks[i] for i in order[: len(tracks) // HELD]]
    rest = [tracks[i] for i in order[len(tracks) // HELD :]]
    save(set_threshold(learn(rest, args.minutes, rng), held, 50.0, rng), args.out)


def learn(tracks: Sequence[Recording], minutes: float, rng: np.random.Generator) -> Weights:
    """Return weights without a threshold."""
    from sklearn.neural_network import MLPClassifier  # comes with librosa

    heard = []
    tracks = [at_speed(track, speed) for track in tracks for speed in SPEEDS]
    for _ in progress(range(round(minutes / 5.0)), "frames"):
        sound, cuts = mashup_of(tracks, 300.0, SECTIONS_S, rng)
        heard.append((np.array(sf.FrameStream().push(sound)), frames_of(cuts)))
    everything = np.concatenate([frames for frames, _ in heard])
    centre, spread = everything.mean(0), everything.std(0) + 1e-6
    blank = Weights(
        centre, spread, np.zeros((2 * sf.NUM_VALUES, 1)), np.zeros(NUM_INPUTS), np.ones(NUM_INPUTS),
        (), 0.0,
    )  # fmt: skip
    blank = replace(blank, directions=directions_of(heard, blank))
    inputs, labels = [], []
    for frames, cuts in progress(heard, "moments"):
        for at, is_cut, past in moments(len(frames), cuts, rng):
            inputs.append(describe(frames[at - past : at + AFTER], blank))
            labels.append(is_cut)
    x, y = np.array(inputs), np.array(labels)
    centre, spread = x.mean(0), x.std(0) + 1e-6
    scaled = np.clip((x - centre) / spread, -6.0, 6.0)
    nets = []
    for number in range(NETS):
        net = MLPClassifier(
            HIDDEN,
            activation="tanh",
            alpha=1e-2,
            early_stopping=True,
            random_state=number,
            max_iter=60,
        )
        net.fit(scaled, y)
        pairs = zip(net.coefs_, net.intercepts_)
        nets.append(tuple((w.astype(np.float32), b.astype(np.float32)) for w, b in pairs))
    print(f"{len(y)} moments, {int(y.sum())} of them cuts")
    return replace(blank, input_centre=centre, input_spread=spread, nets=tuple(nets))


def at_speed(track: Recording, speed: float) -> Recording:
    """Return a recording played faster or slower."""
    if speed == 1.0:
        return track
    samples = soxr.resample(track.samples, speed * sf.RATE_HZ, float(sf.RATE_HZ), quality="LQ")
    return Recording(track.name, np.asarray(samples, np.float32), sf.RATE_HZ)


def frames_of(cuts_s: Sequence[float]) -> np.ndarray:
    """Return the first frame that is more after a cut than before it, for each."""
    middle_s = 0.5 * sf.WINDOW / sf.RATE_HZ
    return np.ceil((np.asarray(cuts_s) - middle_s) * sf.RATE_HZ / sf.HOP).astype(int)


def moments(count: int, cuts: np.ndarray, rng: np.random.Generator) -> list[tuple[int, bool, int]]:
    """Return (frame, whether it is a cut, frames of past that count) of what is learned from."""
    found = []
    for at in range(MIN_PAST, count - AFTER):
        nearest = int(np.abs(cuts - at).min()) if len(cuts) else count
        is_cut = nearest <= NEAR_FRAMES
        if not is_cut and (nearest < CLEAR_FRAMES or at % NEGATIVE_STRIDE):
            continue
        longest = PAST if rng.random() < LONG_SHARE else int(rng.integers(MIN_PAST, PAST))
        found.append((at, is_cut, min(at, longest)))
    return found


def directions_of(heard: Sequence[tuple[F32, np.ndarray]], weights: Weights) -> F32:
    """Return directions in which windows of one section are alike and others are not."""
    rows, labels = [], []
    number = 0
    for frames, cuts in heard:
        scaled = (frames - weights.centre) / weights.spread
        edges = [0, *cuts.tolist(), len(frames)]
        for first, last in zip(edges, edges[1:]):
            starts = np.arange(first + 3, last - AFTER - 3, AFTER // 2)
            if len(starts) > 3:
                rows.append(window_stats(scaled, starts, AFTER))
                labels += [number] * len(starts)
                number += 1
    stats, label = np.concatenate(rows), np.array(labels)
    means = np.array([stats[label == k].mean(0) for k in range(number)])
    within = np.cov((stats - means[label]).T) + 0.02 * np.eye(stats.shape[1])
    between = np.cov(means.T)
    values, vectors = np.linalg.eigh(within)
    white = vectors / np.sqrt(values)
    _, turned = np.linalg.eigh(white.T @ between @ white)
    return (white @ turned[:, ::-1][:, :DIRECTIONS]).astype(np.float32)


def set_threshold(
    weights: Weights, tracks: Sequence[Recording], minutes: float, rng: np.random.Generator
) -> Weights:
    """Return weights with the lowest threshold that is precise on recordings not learned."""
    sounds = [mashup_of(tracks, 300.0, (20.0, 30.0), rng) for _ in range(round(minutes / 5.0))]
    for threshold in (-0.5, 0.5, 1.5, 2.5):
        tried = replace(weights, threshold=threshold)
        score = SectionScore()
        for sound, cuts in sounds:
            score.add(find_changes(sound, tried), cuts)
        print(f"threshold {threshold:4.1f}: {score.text()}")
        if score.precision >= MIN_PRECISION:  # the lowest that is precise enough finds most
            break
    return tried


def save(weights: Weights, path: Path) -> None:
    """Write the weights."""
    arrays: dict[str, np.ndarray] = {
        "centre": weights.centre,
        "spread": weights.spread,
        "directions": weights.directions,
        "input_centre": weights.input_centre,
        "input_spread": weights.input_spread,
    }
    for n, layers in enumerate(weights.nets):
        for i, (matrix, bias) in enumerate(layers):
            arrays[f"w{n}_{i}"], arrays[f"b{n}_{i}"] = matrix, bias
    small = {name: values.astype(np.float32) for name, values in arrays.items()}
    with path.open("wb") as file:
        np.savez(file, num_nets=len(weights.nets), threshold=weights.threshold, **small)
    print(f"{path}: {path.stat().st_size // 1024} KiB")


if __name__ == "__main__":
    main()
