"""Where unknown music changes: the sound after a moment against the last quarter of a minute.

A new piece is unlike all of what came before; a verse, a break or a fill is like some of it. How
unlike, in timbre, harmony, rhythm and in directions that tell recordings apart, and whether more so
than anything before was when it was new, goes into a small network (tools/train_sections.py).
A change is told 1.8 s after it sounded.
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from downbeat.perception import section_features as sf
from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32

AFTER = 28
"""Frames that are judged: 1.4 s after a moment."""
PEAK = 6
"""A change is the most likely moment within +-0.3 s."""
PAST, MIN_PAST = 300, 64
"""Frames before it that count, at most and at least: 15 s, 3.2 s."""
STRIDE = 7
"""Windows of the past lie so many frames apart."""
EVERY = 2
"""Every second moment is judged: 10 a second."""
STEP = 6
"""Frames on both sides of a moment between which a step is measured: 0.3 s."""
WEIGHTS = Path(__file__).with_name("data") / "section_finder.npz"
APART = AFTER // STRIDE
"""Windows that do not overlap are so many places apart."""
REST = 60
"""Frames without another change after one: 3 s."""
NUM_INPUTS, NUM_LAYERS = 49, 3


@dataclass(frozen=True, slots=True)
class Change:
    """A section change.

    Attributes:
        utime: When it sounded [us].
        novelty: Log odds above the threshold.
    """

    utime: int
    novelty: float


@dataclass(frozen=True)
class Weights:
    """What was learned.

    Attributes:
        centre, spread: Of frames, (NUM_VALUES,).
        directions: Of window statistics that tell recordings apart, (2 NUM_VALUES, d).
        input_centre, input_spread: Of the network's inputs, (NUM_INPUTS,).
        nets: Networks whose log odds are averaged: (matrix, bias) pairs each, tanh between.
        threshold: Log odds from which a moment is a change.
    """

    centre: F32
    spread: F32
    directions: F32
    input_centre: F32
    input_spread: F32
    nets: tuple[tuple[tuple[F32, F32], ...], ...]
    threshold: float

    def log_odds(self, inputs: np.ndarray) -> np.ndarray:
        """Return the log odds of a change, (n,), of inputs (n, NUM_INPUTS)."""
        scaled = np.clip((inputs - self.input_centre) / self.input_spread, -6.0, 6.0)
        total = np.zeros(len(scaled))
        for layers in self.nets:
            values = scaled
            for matrix, bias in layers[:-1]:
                values = np.tanh(values @ matrix + bias)
            matrix, bias = layers[-1]
            total += (values @ matrix + bias)[:, 0]
        return total / len(self.nets)


@lru_cache(maxsize=1)
def load_weights(path: Path = WEIGHTS) -> Weights:
    """Read what was learned.

    Raises:
        PerceptionError: The file is missing or damaged.
    """
    try:
        with np.load(path, allow_pickle=False) as data:
            nets = [
                tuple((data[f"w{n}_{i}"], data[f"b{n}_{i}"]) for i in range(NUM_LAYERS))
                for n in range(int(data["num_nets"]))
            ]
            return Weights(
                data["centre"], data["spread"], data["directions"], data["input_centre"],
                data["input_spread"], tuple(nets), float(data["threshold"]),
            )  # fmt: skip
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise PerceptionError(
            f"{path} does not hold the section finder's weights; "
            "`python -m downbeat.tools.train_sections` makes them."
        ) from error


def window_stats(frames: F32, starts: np.ndarray, length: int) -> np.ndarray:
    """Return mean and deviation of windows, (n, 2 NUM_VALUES).

    Args:
        frames: (m, NUM_VALUES), centred and scaled.
        starts: First frames of the windows, (n,).
        length: Frames per window.
    """
    zero = np.zeros((1, frames.shape[1]))
    total = np.concatenate([zero, np.cumsum(frames, 0, dtype=np.float64)])
    square = np.concatenate([zero, np.cumsum(frames.astype(np.float64) ** 2, 0)])
    mean = (total[starts + length] - total[starts]) / length
    variance = (square[starts + length] - square[starts]) / length - mean**2
    return np.concatenate([mean, np.sqrt(np.maximum(variance, 0.0))], 1)


def describe(frames: F32, weights: Weights) -> np.ndarray:
    """Return the network's inputs for the moment AFTER frames before the end, (NUM_INPUTS,).

    Args:
        frames: (past + AFTER, NUM_VALUES) as FrameStream gives them, MIN_PAST or more of past.
        weights: What was learned.
    """
    scaled = (frames - weights.centre) / weights.spread
    past = len(scaled) - AFTER
    starts = np.append(np.arange(past - AFTER, -1, -STRIDE), past)
    stats = window_stats(scaled, starts, AFTER)  # nearest past first, the judged window last
    views = _views(stats, weights)
    inputs: list[float] = []
    for view in views:
        inputs += _novelty(distances(view))
    steps = _steps(scaled)
    here = steps[past - STEP]
    before = steps[: past - STEP]
    inputs += [*here, *(here - np.quantile(before, 0.95, axis=0))]
    sudden = scaled[:, sf.EXCHANGE]
    here = sudden[past - 1 : past + 2].max(0)
    before = sudden[: past - 2]
    inputs += [*here, *(here - np.quantile(before, 0.95, axis=0)), *(here - before.max(0))]
    halves = window_stats(scaled, np.array([past, past + AFTER // 2]), AFTER // 2)
    inputs.append(float(np.sqrt(((halves[0] - halves[1]) ** 2).mean())))
    inputs.append(min(past / PAST, 1.0))
    return np.array(inputs)


def distances(view: np.ndarray) -> np.ndarray:
    """Return the root mean square differences of rows, (n, n), of (n, d)."""
    square = (view**2).sum(1)
    gram = square[:, None] + square[None, :] - 2.0 * view @ view.T
    return np.sqrt(np.maximum(gram, 0.0) / view.shape[1])


def _novelty(apart: np.ndarray) -> list[float]:
    """Return how new the last row is, also against how new the others were in their time.

    Args:
        apart: Distances of windows, (n, n): nearest past first, oldest before the last.
    """
    after = apart[-1, :-1]
    past = apart[:-1, :-1]
    count = len(past) - APART
    if count < 1:  # so short a past has no two windows that do not overlap
        return [after[0], after.min(), after.mean(), 0.0, 0.0, 0.0, 0.0]
    adjacent = past[np.arange(count), np.arange(count) + APART]
    new = np.array([past[j, j + APART :].min() for j in range(count)])
    near, least = after[0], after.min()
    return [
        near,
        least,
        after.mean(),
        near - adjacent.mean(),
        near - adjacent.max(),
        least - new.mean(),
        least - new.max(),
    ]


def _views(stats: np.ndarray, weights: Weights) -> tuple[np.ndarray, ...]:
    """Return the aspects in which windows are compared, (n, ...) each."""
    n = sf.NUM_VALUES
    mean, deviation = stats[:, :n], stats[:, n:]
    rhythm = np.concatenate([mean[:, sf.FLUX], deviation[:, sf.FLUX], mean[:, sf.LEVEL]], 1)
    return (
        mean[:, sf.SHAPE],
        deviation[:, sf.SHAPE],
        mean[:, sf.CHROMA],
        rhythm,
        stats @ weights.directions,
    )


def _steps(scaled: np.ndarray) -> np.ndarray:
    """Return how much changes at each moment in shape, level and harmony, (m - 2 STEP + 1, 3)."""
    starts = np.arange(len(scaled) - STEP + 1)
    total = np.concatenate([np.zeros((1, scaled.shape[1])), np.cumsum(scaled, 0)])
    mean = (total[starts + STEP] - total[starts]) / STEP
    change = (mean[STEP:] - mean[:-STEP]) ** 2
    parts = [change[:, part].mean(1) for part in (sf.SHAPE, sf.LEVEL, sf.CHROMA)]
    return np.sqrt(np.stack(parts, 1))


class SectionFinder:
    """Finds the changes of a stream of sound."""

    def __init__(self, weights: Weights | None = None) -> None:
        """Begin; `weights`: None: those that come with Downbeat."""
        self._weights = weights or load_weights()
        self.reset()

    def reset(self) -> None:
        """Begin anew: after a gap, or where another piece is known to begin."""
        self._stream = sf.FrameStream()
        self._frames: list[F32] = []
        self._first_utime: int | None = None
        self._dropped = self._rests_until = 0
        self._odds: list[float] = []
        self.newest: Change | None = None

    def hear(self, samples: F32, first_utime: int) -> Change | None:
        """Take a block; returns a change that was found in it.

        Args:
            samples: (n,) at 16 kHz, following the last block without a gap.
            first_utime: When the first sample sounded [us].
        """
        if self._first_utime is None:
            self._first_utime = first_utime
        found = None
        for frame in self._stream.push(samples):
            self._frames.append(frame)
            found = self._judge() or found
        return found

    def _judge(self) -> Change | None:
        """Judge the moment AFTER frames ago; the one PEAK before it may turn out a change."""
        past = len(self._frames) - AFTER
        odds = -np.inf
        if past >= MIN_PAST and (self._dropped + past) % EVERY == 0:
            inputs = describe(np.array(self._frames[-PAST - AFTER :]), self._weights)
            odds = float(self._weights.log_odds(inputs[None])[0])
        self._odds = [*self._odds[-2 * PEAK :], odds]
        if len(self._frames) > PAST + AFTER:
            del self._frames[0]
            self._dropped += 1
        middle = self._odds[-PEAK - 1] if len(self._odds) > 2 * PEAK else -np.inf
        if middle < self._weights.threshold or middle < max(self._odds):
            return None
        moment = self._dropped + len(self._frames) - AFTER - PEAK
        if moment < self._rests_until:
            return None
        self._rests_until = moment + REST
        middle_us = round(0.5e6 * sf.WINDOW / sf.RATE_HZ)
        utime = (self._first_utime or 0) + moment * sf.HOP_US + middle_us
        self.newest = Change(utime, middle - self._weights.threshold)
        return self.newest
