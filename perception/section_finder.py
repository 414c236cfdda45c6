"""Where unknown music changes: the sound after a moment against the last twenty seconds.

A new piece is unlike all of what came before; a verse, a break or a fill is like some of it. How
unlike a moment is in many aspects, and how much more so than is usual in what is being heard
(section_context.py), goes into small networks (tools/train_sections.py). A change is told 1.8 s
after it sounded.
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
from downbeat.perception.section_context import Context, Maps, map_names

PEAK = 2
"""A change is the most likely moment within +-0.2 s, and lies where those around it weigh."""
MIN_PAST = 32
"""Frames before it at least: 3.2 s."""
WEIGHTS = Path(__file__).with_name("data") / "section_finder.npz"
REST = 20
"""Frames without another change after one: 2 s."""
CLIP = 6.0
"""Inputs count up to so many deviations."""


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
        maps: What turns frames into vectors to compare.
        input_centre, input_spread: Of the networks' inputs, (NUM_INPUTS,).
        nets: Networks whose log odds are averaged: (matrix, bias) pairs each, tanh between.
        threshold: Log odds from which a moment is a change.
    """

    maps: Maps
    input_centre: F32
    input_spread: F32
    nets: tuple[tuple[tuple[F32, F32], ...], ...]
    threshold: float

    def log_odds(self, inputs: np.ndarray) -> np.ndarray:
        """Return the log odds of a change, (n,), of inputs (n, NUM_INPUTS)."""
        scaled = np.clip((inputs - self.input_centre) / self.input_spread, -CLIP, CLIP)
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
            maps = Maps(*(data[name].astype(np.float32) for name in map_names()))
            nets = tuple(
                tuple(
                    (data[f"w{n}_{i}"], data[f"b{n}_{i}"]) for i in range(int(data["num_layers"]))
                )
                for n in range(int(data["num_nets"]))
            )
            centre, spread = data["input_centre"], data["input_spread"]
            return Weights(maps, centre, spread, nets, float(data["threshold"]))
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise PerceptionError(
            f"{path} does not hold the section finder's weights; "
            "`python -m downbeat.tools.train_sections` makes them."
        ) from error


class SectionFinder:
    """Finds the changes of a stream of sound."""

    def __init__(self, weights: Weights | None = None) -> None:
        """Begin; `weights`: None: those that come with Downbeat."""
        self._weights = weights or load_weights()
        self.reset()

    def reset(self) -> None:
        """Begin anew: after a gap, or where another piece is known to begin."""
        self._stream = sf.FrameStream()
        self._context = Context(self._weights.maps)
        self._picker = Picker(self._weights.threshold)
        self._first_utime: int | None = None
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
            inputs = self._context.push(frame)
            for odds in self._weights.log_odds(inputs):
                found = self._change(self._picker.push(float(odds))) or found
        self.newest = found or self.newest
        return found

    def _change(self, picked: tuple[float, float] | None) -> Change | None:
        if picked is None:
            return None
        frame, novelty = picked
        middle_us = round(0.5e6 * sf.WINDOW / sf.RATE_HZ)
        utime = (self._first_utime or 0) + round(frame * sf.HOP_US) + middle_us
        return Change(utime, novelty)


class Picker:
    """Picks the changes out of the log odds of moments in a row."""

    def __init__(self, threshold: float) -> None:
        """Begin at moment 0."""
        self._threshold = threshold
        self._odds: list[float] = []
        self._count = 0
        self._rests_until = MIN_PAST

    def push(self, odds: float) -> tuple[float, float] | None:
        """Take a moment's log odds; returns (place, log odds above the threshold) of a change.

        The place is a moment's number, in parts of it too.
        """
        self._odds = [*self._odds[-2 * PEAK :], odds if self._count >= MIN_PAST else -np.inf]
        moment = self._count - PEAK
        self._count += 1
        middle = self._odds[-PEAK - 1] if moment >= MIN_PAST else -np.inf
        if middle < self._threshold or middle < max(self._odds) or moment < self._rests_until:
            return None
        self._rests_until = moment + REST
        weight = 1.0 / (1.0 + np.exp(-np.array(self._odds)))
        place = moment + float(weight @ np.arange(-PEAK, PEAK + 1)) / float(weight.sum())
        return place, middle - self._threshold
