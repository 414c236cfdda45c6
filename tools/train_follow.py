"""Learn what a beat looks like (perception/data/beat_template.json) from a folder of recordings.

    python -m downbeat.tools.train_follow --tracks DIR --speech DIR --out beat_template.json

Recordings that have a steady beat by the offline analyses, the bundled pieces, and all of them
through a robot's microphone are heard by the follower's own bank; the template is the linear soft
choice among all tempos and phases that picks the reference's beat most surely. Stretched copies
keep it from learning the tempos of the folder, and passages that begin in the middle teach it what
little it knows in the first seconds.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

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
    NUM_PHASES,
    NUM_TEMPOS,
    PERIODS_S,
    PHASES,
    TEMPOS_BPM,
    Equaliser,
    RhythmBank,
    features,
)
from downbeat.tools.eval_follow import Hears, robot_hears, sounds
from downbeat.tools.follow_reference import Reference

MIN_STRETCH, MAX_STRETCH = 0.85, 1.18
WHOLE_EVERY_S, PASSAGE_EVERY_S = 8.0, 2.5
PASSAGES, PASSAGE_S = 3, 10.0
ROBOT_S = 75.0
FIRST_S = 2.0
RIGHT_TEMPO, RIGHT_S = 0.0125, 0.03
EPOCHS, BATCH, RATE, DECAY = 6, 24, 0.1, 1e-4


@dataclass(frozen=True)
class Options:
    """Learn the beat template."""

    tracks: Path
    """Folder of recordings."""
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
) -> Iterator[tuple[F32, np.ndarray]]:
    """Yield features and right choices at every second tempo, now and then."""
    equaliser, bank = Equaliser(), RhythmBank()
    every = round(every_s / STEP_S)
    chosen = int(rng.integers(every))
    for number in range(len(frames) // STEP_FRAMES):
        step = frames[number * STEP_FRAMES : (number + 1) * STEP_FRAMES]
        bank.push(equaliser.push(step))
        now_s = (number + 1) * STEP_S
        if now_s < FIRST_S or number % every != chosen:
            continue
        right = right_choices(reference, now_s)
        half = slice(int(rng.integers(2)), NUM_TEMPOS - NUM_TEMPOS % 2, 2)
        if right[half].any():
            values = features(bank.coefficients())[half].astype(np.float32)
            yield values.reshape(-1, values.shape[-1]), right[half].ravel()


def passages(
    frames: F64, reference: Reference, rng: np.random.Generator
) -> Iterator[tuple[F32, np.ndarray]]:
    """Yield looks at a recording: as it is, stretched, and some passages of it, stretched."""
    starts = rng.uniform(0.0, 0.8, PASSAGES) * len(frames) * STEP_S / STEP_FRAMES
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


def learn(values: F32, right: np.ndarray, rng: np.random.Generator) -> F64:
    """Return the weights that choose right most surely.

    Args:
        values: (looks, choices, n).
        right: (looks, choices) bool, at least one in each look.
        rng: Order of the batches.
    """
    scale = np.sqrt((values[:, ::31] ** 2).mean(axis=(0, 1))) + 1e-6
    weights, momentum, power = np.zeros((3, values.shape[2]))
    number = 0
    for epoch in range(EPOCHS):
        order = rng.permutation(len(values))
        rate = RATE * (1.0 - epoch / EPOCHS) + 1e-3
        for first in range(0, len(order), BATCH):
            batch = order[first : first + BATCH]
            x = values[batch]
            score = x @ (weights / scale).astype(np.float32)
            share = np.exp(score - score.max(axis=1, keepdims=True))
            wanted = share * right[batch]
            share /= share.sum(axis=1, keepdims=True)
            wanted /= wanted.sum(axis=1, keepdims=True) + 1e-9
            slope = (share - wanted).ravel() @ x.reshape(-1, x.shape[2]) / len(batch) / scale
            slope = slope + DECAY * weights
            number += 1
            momentum = 0.9 * momentum + 0.1 * slope
            power = 0.99 * power + 0.01 * slope**2
            step = momentum / (1.0 - 0.9**number)
            weights = weights - rate * step / (np.sqrt(power / (1.0 - 0.99**number)) + 1e-8)
    return np.asarray(weights / scale)


def main(options: Options) -> None:
    """Learn and write."""
    rng = np.random.default_rng(options.seed)
    robot: Hears | None = robot_hears(options.speech) if options.speech is not None else None
    values, right = [], []
    for recording, reference in [*sounds(options.tracks), *sounds(None)]:
        if not reference.is_steady:
            continue
        sound = soxr.resample(recording.samples, recording.sample_rate_hz, SAMPLE_RATE_HZ)
        heard = [np.asarray(sound, np.float32)]
        if robot is not None:
            heard.append(robot(heard[0][: round(ROBOT_S * SAMPLE_RATE_HZ)], rng))
        for one in heard:
            for look, choices in passages(onsets_of(one), reference, rng):
                values.append(look)
                right.append(choices)
        print(f"{recording.name}: {len(values)} looks")
    weights = learn(np.array(values), np.array(right), rng)
    text = json.dumps({"weights": [float(f"{w:.5g}") for w in weights]})
    options.out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(tyro.cli(Options))
