"""Learn what a beat looks like (perception/data/beat_template.json) from folders of recordings.

    python -m downbeat.tools.train_follow --tracks DIR DIR --speech DIR --out beat_template.json

Recordings that have a steady beat by the offline analyses, and all of them through a robot's
microphone, are heard by the follower's own bank; the template is the soft choice among all tempos
and phases that picks the reference's beat most surely. Stretched copies keep it from learning the
tempos of the folders, and passages that begin in the middle teach it what little it knows in the
first seconds.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import soxr
import tyro

from downbeat.perception.features import F32
from downbeat.perception.onset_stream import (
    F64,
    LATE_S,
    SAMPLE_RATE_HZ,
    STEP_FRAMES,
    STEP_S,
    OnsetStream,
)
from downbeat.perception.rhythm import (
    FEATURES,
    NUM_PHASES,
    NUM_TEMPOS,
    PERIODS_S,
    PHASES,
    TEMPOS_BPM,
    BeatTemplate,
    Equaliser,
    RhythmBank,
    features,
)
from downbeat.tools.eval_follow import Hears, robot_hears, sounds
from downbeat.tools.follow_reference import Reference

MIN_STRETCH, MAX_STRETCH = 0.85, 1.18
WHOLE_EVERY_S, PASSAGE_EVERY_S = 8.0, 2.5
PASSAGES, ROBOT_PASSAGES, PASSAGE_S = 8, 3, 10.0
WHOLE_S, ROBOT_S = 90.0, 60.0
FIRST_S = 2.0
RIGHT_TEMPO, RIGHT_S = 0.0125, 0.03
TEMPO_STRIDE = 4
"""Every fourth tempo is enough to learn from; some of them are always right."""
HIDDEN = 24
EPOCHS, BATCH, DECAY = 8, 32, 1e-2
RATE, HIDDEN_RATE = 0.05, 0.0075
AVERAGE = 0.99
"""The second half of the steps is averaged: single steps differ more than their mean is right."""

Look = tuple[np.ndarray, np.ndarray]
"""(choices, FEATURES) float16, and (choices,) which are right."""


@dataclass(frozen=True)
class Options:
    """Learn the beat template."""

    tracks: tuple[Path, ...]
    """Folders of recordings."""
    out: Path
    """Where the weights go."""
    speech: Path | None = None
    """Folder of voices for the robot's microphone; omitted: clean sound only."""
    seed: int = 0
    """Of stretches, passages and noise."""


def onsets_of(sound: F32) -> F64:
    """Return the onset frames of a sound, (frames, NUM_GROUPS)."""
    return np.concatenate(OnsetStream().push(sound))


def stretch_frames(frames: F64, factor: float) -> F64:
    """Return frames of the same music `factor` times as long."""
    places = np.arange(int(len(frames) * factor)) / factor
    low = np.minimum(places.astype(int), len(frames) - 2)
    share = (places - low)[:, None]
    return np.asarray(frames[low] * (1.0 - share) + frames[low + 1] * share)


def right_choices(reference: Reference, now_s: float) -> np.ndarray:
    """Return which tempos and phases name the reference's beat, (NUM_TEMPOS, NUM_PHASES) bool."""
    true_s = 60.0 / reference.grid.tempo_bpm
    right = np.zeros((NUM_TEMPOS, NUM_PHASES), bool)
    for octave in (0.5, 1.0, 2.0):
        near = np.abs(np.log(TEMPOS_BPM / (reference.grid.tempo_bpm * octave))) < RIGHT_TEMPO
        period_s = PERIODS_S[near][:, None]
        modulo_s = true_s / max(octave, 1.0)
        late_s = now_s - LATE_S + PHASES * period_s - reference.grid.first_beat_s
        off_s = np.abs((late_s + 0.5 * modulo_s) % modulo_s - 0.5 * modulo_s)
        right[near] |= off_s <= np.maximum(RIGHT_S, 0.5 * period_s / NUM_PHASES)
    return right


def looks(
    frames: F64, reference: Reference, every_s: float, rng: np.random.Generator
) -> Iterator[Look]:
    """Yield features and right choices at every fourth tempo, now and then."""
    equaliser, bank = Equaliser(), RhythmBank()
    every = round(every_s / STEP_S)
    chosen = int(rng.integers(every))
    count = NUM_TEMPOS // TEMPO_STRIDE
    for number in range(len(frames) // STEP_FRAMES):
        step = frames[number * STEP_FRAMES : (number + 1) * STEP_FRAMES]
        bank.push(equaliser.push(step))
        now_s = (number + 1) * STEP_S
        if now_s < FIRST_S or number % every != chosen:
            continue
        right = right_choices(reference, now_s)
        part = slice(int(rng.integers(TEMPO_STRIDE)), None, TEMPO_STRIDE)
        if right[part][:count].any():
            values = features(bank.coefficients())[part][:count].astype(np.float16)
            yield values.reshape(-1, FEATURES), right[part][:count].ravel()


def passages(
    frames: F64, reference: Reference, number: int, rng: np.random.Generator
) -> Iterator[Look]:
    """Yield looks at a recording: as it is, stretched, and some passages of it, stretched."""
    starts = rng.uniform(0.0, 0.8, number) * len(frames) * STEP_S / STEP_FRAMES
    yield from looks(frames, reference, WHOLE_EVERY_S, rng)
    for start_s in (0.0, *starts):
        factor = float(rng.uniform(MIN_STRETCH, MAX_STRETCH))
        first = round(start_s / STEP_S) * STEP_FRAMES
        count = None if start_s == 0.0 else round(PASSAGE_S / STEP_S) * STEP_FRAMES
        part = frames[first:][:count]
        if len(part) < STEP_FRAMES * FIRST_S / STEP_S:
            continue
        moved = reference.moved(first * STEP_S / STEP_FRAMES).stretched(factor)
        every_s = WHOLE_EVERY_S if start_s == 0.0 else PASSAGE_EVERY_S
        yield from looks(stretch_frames(part, factor), moved, every_s, rng)


class Learner:
    """The template's network while it learns: Adam on the soft choice, then the mean of steps."""

    def __init__(self, scale: F32, rng: np.random.Generator) -> None:
        """Begin.

        Args:
            scale: (FEATURES,) what features are divided by.
            rng: First hidden weights.
        """
        spread = 0.5 / np.sqrt(FEATURES)
        self._scale = scale
        self._values: list[F32] = [
            np.zeros(FEATURES, np.float32),
            (spread * rng.standard_normal((FEATURES, HIDDEN))).astype(np.float32),
            np.zeros(HIDDEN, np.float32),
            (0.1 * rng.standard_normal(HIDDEN)).astype(np.float32),
        ]
        self._momentum = [np.zeros_like(v) for v in self._values]
        self._power = [np.zeros_like(v) for v in self._values]
        self._mean = [v.copy() for v in self._values]
        self._steps = 0

    def step(self, looks: F32, right: np.ndarray, weight: F32, rate: float, average: bool) -> None:
        """Learn from some looks.

        Args:
            looks: (looks, choices, FEATURES).
            right: (looks, choices) bool, at least one in each look.
            weight: (looks,) how much each counts.
            rate: Share of the full learning rate.
            average: Whether this step counts for the result.
        """
        linear, into, bias, out = self._values
        x = looks / self._scale
        hidden = np.tanh(x @ into + bias)
        score = x @ linear + hidden @ out
        share = np.exp(score - score.max(axis=1, keepdims=True))
        wanted = share * right
        share /= share.sum(axis=1, keepdims=True)
        wanted /= wanted.sum(axis=1, keepdims=True) + 1e-9
        slope = ((share - wanted) * weight[:, None]).astype(np.float32).ravel() / len(looks)
        x, hidden = x.reshape(-1, FEATURES), hidden.reshape(-1, HIDDEN)
        inner = slope[:, None] * out * (1.0 - hidden**2)
        slopes = [slope @ x, x.T @ inner, inner.sum(axis=0), slope @ hidden]
        self._steps += 1
        rates = [RATE] + [HIDDEN_RATE] * 3
        for i, (value, raw) in enumerate(zip(self._values, slopes, strict=True)):
            full = raw + DECAY * value
            self._momentum[i] = 0.9 * self._momentum[i] + 0.1 * full
            self._power[i] = 0.99 * self._power[i] + 0.01 * full**2
            move = self._momentum[i] / (1.0 - 0.9**self._steps)
            move /= np.sqrt(self._power[i] / (1.0 - 0.99**self._steps)) + 1e-8
            value -= (rates[i] * rate + 1e-3) * move
            keep = AVERAGE if average else 0.0
            self._mean[i] = keep * self._mean[i] + (1.0 - keep) * value

    def template(self) -> BeatTemplate:
        """Return what was learned."""
        linear, into, bias, out = (np.asarray(v, np.float64) for v in self._mean)
        return BeatTemplate(np.vstack([linear, into.T]) / self._scale, bias, out)


def learn(
    values: np.ndarray, right: np.ndarray, weight: F32, rng: np.random.Generator
) -> BeatTemplate:
    """Return the template that chooses right most surely.

    Args:
        values: (looks, choices, FEATURES) float16.
        right: (looks, choices) bool, at least one in each look.
        weight: (looks,).
        rng: First weights and order of the looks.
    """
    some = values[::7, ::31].astype(np.float32)
    learner = Learner(np.sqrt((some**2).mean(axis=(0, 1))) + 1e-6, rng)
    for epoch in range(EPOCHS):
        order = rng.permutation(len(values))
        for first in range(0, len(order), BATCH):
            batch = order[first : first + BATCH]
            looks_now = values[batch].astype(np.float32)
            rate = 1.0 - epoch / EPOCHS
            learner.step(looks_now, right[batch], weight[batch], rate, epoch >= EPOCHS // 2)
    return learner.template()


def main(options: Options) -> None:
    """Learn and write."""
    rng = np.random.default_rng(options.seed)
    robot: Hears | None = robot_hears(options.speech) if options.speech is not None else None
    values, right, weight = [], [], []
    for recording, reference in (pair for folder in options.tracks for pair in sounds(folder)):
        if not reference.is_steady:
            continue
        sound = soxr.resample(recording.samples, recording.sample_rate_hz, SAMPLE_RATE_HZ)
        sound = np.asarray(sound[: round(WHOLE_S * SAMPLE_RATE_HZ)], np.float32)
        found = list(passages(onsets_of(sound), reference, PASSAGES, rng))
        if robot is not None:
            heard = robot(sound[: round(ROBOT_S * SAMPLE_RATE_HZ)], rng)
            found += passages(onsets_of(heard), reference, ROBOT_PASSAGES, rng)
        values += [look for look, _ in found]
        right += [choices for _, choices in found]
        weight += [1.0 / np.sqrt(len(found))] * len(found)
        print(f"{recording.name}: {len(values)} looks", flush=True)
    weights = np.array(weight, np.float32) / np.mean(weight)
    template = learn(np.array(values), np.array(right), weights.astype(np.float32), rng)
    parts = {name: _rounded(getattr(template, name)) for name in ("weights", "bias", "out")}
    options.out.write_text(json.dumps(parts) + "\n", encoding="utf-8")


def _rounded(values: F64) -> list[Any]:
    short: list[Any] = np.vectorize(lambda v: float(f"{v:.4g}"))(values).tolist()
    return short


if __name__ == "__main__":
    main(tyro.cli(Options))
