"""Learn to hear where one piece of music ends and another begins, from mashups of recordings.

`python -m downbeat.tools.train_sections --tracks DIR [DIR ...]` cuts random mashups of the folders'
recordings, learns, and writes perception/data/section_finder.npz. With `--held DIR`, the threshold
is the one at which mashups of those recordings are found well; the figures of the report come from
yet others (`downbeat eval sections`).
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from rich.progress import track as progress

from downbeat.perception import section_features as sf
from downbeat.perception.features import F32
from downbeat.perception.section_context import AFTER, SOON, Context, Maps, cosines
from downbeat.perception.section_finder import (
    CLIP,
    MIN_PAST,
    WEIGHTS,
    Picker,
    Weights,
)
from downbeat.perception.source import Recording
from downbeat.tools.eval_sections import mashup_of, sound_of
from downbeat.tools.section_mashups import MASHUP_S, Pool, pool_of, varied_mashup
from downbeat.tools.section_score import SectionScore

THRESHOLD = -0.1
"""Log odds from which a moment is a change, unless recordings are held apart to choose it."""
NEAR_FRAMES, CLEAR_FRAMES = 1, 5
"""A moment this near to a cut is one; up to the second it is neither."""
NEGATIVE_SHARE = 0.4
"""Of the other moments, those that are learned from."""
BLOCK = 200
PIECE, SOON_PIECE, FRAME, MIX = 20, 16, 16, 32
HIDDEN, PENALTY, EPOCHS, NETS = (48, 16), 0.3, 8, 3
MIN_RECALL = 0.92
"""The threshold is the highest that reaches it on recordings that were not learned."""


@dataclass(frozen=True)
class Heard:
    """A mashup to learn from.

    Attributes:
        frames: Of its sound; half precision, to have room for many.
        cuts: Frames whose middle is nearest to a cut.
    """

    frames: sf.Frames
    cuts: np.ndarray


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tracks", type=Path, nargs="+", required=True, help="recordings")
    parser.add_argument("--held", type=Path, nargs="*", default=[], help="that set the threshold")
    parser.add_argument("--minutes", type=float, default=1000.0, help="of mashups to learn from")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=WEIGHTS)
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    weights = learn(pool_of(all_of(args.tracks)), args.minutes, rng)
    if args.held:
        weights = set_threshold(weights, all_of(args.held), rng)
    save(weights, args.out)


def all_of(folders: Sequence[Path]) -> list[Recording]:
    """Return the recordings of folders at 16 kHz."""
    return [recording for folder in folders for recording in sound_of(folder)]


def learn(pool: Pool, minutes: float, rng: np.random.Generator) -> Weights:
    """Return weights with the usual threshold."""
    heard = []
    for _ in progress(range(round(minutes * 60.0 / MASHUP_S)), "frames"):
        sound, cuts = varied_mashup(pool, rng)
        heard.append(Heard(half(frames_of(sound)), nearest_frames(cuts)))
    maps = maps_of(heard, rng)
    inputs, labels = [], []
    for one in progress(heard, "moments"):
        rows = inputs_of(one.frames, maps)
        chosen, is_cut = moments(len(rows), one.cuts, rng)
        inputs.append(rows[chosen].astype(np.float32))
        labels.append(is_cut)
    x, y = np.concatenate(inputs), np.concatenate(labels)
    print(f"{len(y)} moments, {int(y.sum())} of them at cuts")
    centre, spread = x.mean(0), x.std(0) + 1e-6
    scaled = np.clip((x - centre) / spread, -CLIP, CLIP)
    nets = tuple(net_of(scaled, y, number) for number in progress(range(NETS), "networks"))
    return Weights(maps, centre, spread, nets, THRESHOLD)


def net_of(scaled: F32, labels: np.ndarray, seed: int) -> tuple[tuple[F32, F32], ...]:
    """Return a network's (matrix, bias) pairs."""
    from sklearn.exceptions import ConvergenceWarning  # comes with librosa
    from sklearn.neural_network import MLPClassifier

    net = MLPClassifier(
        HIDDEN,
        activation="tanh",
        alpha=PENALTY,
        learning_rate_init=2e-3,
        batch_size=512,
        max_iter=EPOCHS,
        random_state=seed,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # stopped early on purpose
        net.fit(scaled, labels)
    return tuple(
        (w.astype(np.float32), b.astype(np.float32)) for w, b in zip(net.coefs_, net.intercepts_)
    )


def frames_of(sound: F32) -> sf.Frames:
    """Return the frames of a whole sound."""
    return sf.FrameStream().push(sound, together=True)[0]


def half(frames: sf.Frames) -> sf.Frames:
    """Return frames in half precision."""
    return sf.Frames(*(part.astype(np.float16) for part in vars(frames).values()))


def nearest_frames(cuts: Sequence[int]) -> np.ndarray:
    """Return the frames whose middle is nearest to samples."""
    return np.round((np.asarray(cuts, float) - sf.WINDOW // 2) / sf.HOP).astype(int)


def inputs_of(frames: sf.Frames, maps: Maps) -> np.ndarray:
    """Return the inputs of all moments that can be judged, (n, NUM_INPUTS)."""
    context, rows = Context(maps), []
    for first in range(0, len(frames), BLOCK):
        parts = (part[first : first + BLOCK] for part in vars(frames).values())
        rows.append(context.push(sf.Frames(*(part.astype(np.float32) for part in parts))))
    return np.concatenate(rows)


def moments(count: int, cuts: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Return (moments that are learned from, whether they are cuts)."""
    at = np.arange(MIN_PAST, count)
    far = np.abs(at[:, None] - cuts).min(1, initial=count)
    is_cut = far <= NEAR_FRAMES
    chosen = is_cut | ((far >= CLEAR_FRAMES) & (rng.random(len(at)) < NEGATIVE_SHARE))
    return at[chosen], is_cut[chosen]


def maps_of(heard: Sequence[Heard], rng: np.random.Generator) -> Maps:
    """Return what turns frames into vectors in which recordings differ."""
    some = np.concatenate([one.frames.long[::5] for one in heard]).astype(np.float32)
    centre, spread = some.mean(0), some.std(0) + 1e-3
    shape = some[:, : sf.NUM_BANDS] @ cosines()
    bare = some - some.mean(1, keepdims=True)
    bare_centre, bare_spread = bare.mean(0), bare.std(0) + 1e-3
    piece: list[np.ndarray] = []
    soon: list[np.ndarray] = []
    frame: list[np.ndarray] = []
    for one in heard:
        long = one.frames.long.astype(np.float32)
        scaled = (long - centre) / spread
        line = (long - long.mean(1, keepdims=True) - bare_centre) / bare_spread
        edges = [0, *one.cuts.tolist(), len(long)]
        for first, last in zip(edges, edges[1:]):
            starts = np.arange(first + 2, last - AFTER - 2, 6)
            if len(starts) >= 4:
                piece.append(window_stats(scaled, starts, AFTER))
                soon.append(window_stats(scaled, starts, SOON))
                frame.append(line[np.arange(first + 2, last - 2, 7)])
    mix = rng.standard_normal((sf.NUM_FINE, MIX)) / 8.0
    maps = (
        centre, spread, shape.mean(0), shape.std(0) + 1e-3, bare_centre, bare_spread,
        directions(piece, PIECE), directions(soon, SOON_PIECE), directions(frame, FRAME), mix,
    )  # fmt: skip
    return Maps(*(np.asarray(part, np.float32) for part in maps))


def window_stats(rows: F32, starts: np.ndarray, length: int) -> np.ndarray:
    """Return mean and deviation of windows, (n, 2 d), of rows (m, d)."""
    windows = rows[starts[:, None] + np.arange(length)]
    return np.concatenate([windows.mean(1), windows.std(1)], 1)


def directions(groups: Sequence[np.ndarray], count: int) -> np.ndarray:
    """Return directions in which rows (n, d) of one group are alike, (d, count)."""
    rows = np.concatenate(groups).astype(np.float64)
    means = np.array([group.mean(0) for group in groups])
    label = np.repeat(np.arange(len(groups)), [len(group) for group in groups])
    within = np.cov((rows - means[label]).T) + 0.05 * np.eye(rows.shape[1])
    values, vectors = np.linalg.eigh(within)
    white = vectors / np.sqrt(values)
    _, turned = np.linalg.eigh(white.T @ np.cov(means.T) @ white)
    return white @ turned[:, ::-1][:, :count]


def set_threshold(
    weights: Weights, tracks: Sequence[Recording], rng: np.random.Generator
) -> Weights:
    """Return weights with the highest threshold that finds enough in recordings not learned."""
    heard = []
    for number in progress(range(60), "threshold"):
        length_s = (20.0, 30.0)[number % 2]
        sound, cuts_s = mashup_of(tracks, 6.0 * length_s, (length_s, length_s), rng)
        heard.append((weights.log_odds(inputs_of(frames_of(sound), weights.maps)), cuts_s))
    chosen = None
    for threshold in np.arange(3.0, -4.1, -0.25):
        score = SectionScore()
        for odds, cuts_s in heard:
            picker = Picker(threshold)
            picked = [picker.push(float(one)) for one in odds]
            told = [(second_of(one[0]), second_of(one[0])) for one in picked if one]
            score.add(told, cuts_s)
        print(f"threshold {threshold:5.2f}: {score.text()}")
        if chosen is None and score.recall >= MIN_RECALL:
            chosen = float(threshold)
    return weights if chosen is None else replace(weights, threshold=chosen)


def second_of(frame: float) -> float:
    """Return when a frame's middle sounds [s]."""
    return (frame * sf.HOP + sf.WINDOW // 2) / sf.RATE_HZ


def save(weights: Weights, path: Path) -> None:
    """Write the weights; directions in half precision, the score is the same."""
    arrays = {one.name: getattr(weights.maps, one.name) for one in fields(weights.maps)}
    arrays |= {"input_centre": weights.input_centre, "input_spread": weights.input_spread}
    small = {name: values.astype(np.float32) for name, values in arrays.items()}
    for name in ("piece", "piece_soon", "frame", "mix"):
        small[name] = small[name].astype(np.float16)
    for n, layers in enumerate(weights.nets):
        for i, (matrix, bias) in enumerate(layers):
            small[f"w{n}_{i}"], small[f"b{n}_{i}"] = matrix, bias
    counts = {"num_nets": len(weights.nets), "num_layers": len(weights.nets[0])}
    with path.open("wb") as file:
        np.savez(file, threshold=weights.threshold, **counts, **small)
    print(f"{path}: {path.stat().st_size // 1024} KiB")


if __name__ == "__main__":
    main()
