"""Learn how sure a beat is (perception/data/beat_surety.json) from music, voices and noise.

    python -m downbeat.tools.train_surety --folds DIR TEMPLATE DIR TEMPLATE --none DIR --out FILE

A template must not have been learned from the recordings it is read on here, else it looks surer
than it is: learn one on each folder with `train_follow` and name it with the other folder. In the
folder `--none` nothing has a beat: voices, rooms, noise.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import soxr
import tyro

from downbeat.perception.beat_follower import BeatFollower
from downbeat.perception.features import F32
from downbeat.perception.onset_stream import F64, SAMPLE_RATE_HZ, OnsetStream
from downbeat.perception.rhythm import BeatTemplate, read_template
from downbeat.tools.eval_follow import SAME_TEMPO, sounds
from downbeat.tools.follow_reference import Reference
from downbeat.tools.matcher_sounds import load_folder

STARTS_S, LENGTH_S = (0.0, 25.0), 60.0
RIGHT_S = 0.06
NONE_WEIGHT = 2.0
"""Looks at what has no beat count twice: to dance to talk is worse than to begin late."""
RIDGE, ROUNDS = 1.0, 30


@dataclass(frozen=True)
class Options:
    """Learn the weights of the surety."""

    folds: tuple[tuple[Path, Path], ...]
    """Folders of recordings, each with a template that was learned without them."""
    none: Path
    """Folder of sounds without a beat."""
    out: Path
    """Where the weights go."""


def looks(
    sound: F32, template: BeatTemplate, reference: Reference | None
) -> Iterator[tuple[F64, bool]]:
    """Yield the evidence of each look at a sound, and whether the beat was right.

    Args:
        sound: (n,) mono, 16 kHz.
        template: What a beat looks like.
        reference: Where the beats are; None: there is none.
    """
    follower = BeatFollower(template=template)
    seen: F64 | None = None
    for onsets in OnsetStream().push(sound):
        follower.step(onsets)
        line = follower.line
        if follower.evidence is None or follower.evidence is seen or line is None:
            continue
        seen = follower.evidence
        yield seen, reference is not None and is_right(line.beat_s, line.period_s, reference)


def is_right(beat_s: float, period_s: float, reference: Reference) -> bool:
    """Return whether a beat of a line is one of the reference, at an octave of its tempo."""
    true_s = 60.0 / reference.grid.tempo_bpm
    octaves = np.log2(period_s / true_s)
    same = abs(octaves - round(octaves)) * np.log(2.0) < SAME_TEMPO
    modulo_s = min(period_s, true_s)
    off_s = (beat_s - reference.grid.first_beat_s + 0.5 * modulo_s) % modulo_s - 0.5 * modulo_s
    return bool(same and abs(off_s) < RIGHT_S)


def regress(evidence: F64, right: np.ndarray, weight: F64) -> tuple[F64, float]:
    """Return (weights, bias) of the logistic regression, by Newton's steps.

    Args:
        evidence: (looks, n).
        right: (looks,) bool.
        weight: (looks,) how much each counts.
    """
    middle, spread = evidence.mean(axis=0), evidence.std(axis=0) + 1e-9
    x = np.column_stack([(evidence - middle) / spread, np.ones(len(evidence))])
    ridge = RIDGE * np.append(np.ones(evidence.shape[1]), 0.0)
    found = np.zeros(x.shape[1])
    for _ in range(ROUNDS):
        chance = 1.0 / (1.0 + np.exp(-x @ found))
        slope = x.T @ (weight * (chance - right)) + ridge * found
        bend = (x * (weight * chance * (1.0 - chance))[:, None]).T @ x + np.diag(ridge + 1e-9)
        found -= np.linalg.solve(bend, slope)
    weights = found[:-1] / spread
    return weights, float(found[-1] - weights @ middle)


def main(options: Options) -> None:
    """Learn and write."""
    found: list[tuple[F64, bool, float]] = []
    templates = [read_template(path) for _, path in options.folds]
    for (folder, _), template in zip(options.folds, templates, strict=True):
        for recording, reference in sounds(folder):
            if not reference.is_steady:
                continue
            sound = at_16_khz(recording.samples, recording.sample_rate_hz)
            for start_s in STARTS_S:
                part = sound[round(start_s * SAMPLE_RATE_HZ) :][: round(LENGTH_S * SAMPLE_RATE_HZ)]
                seen = looks(part, template, reference.moved(start_s))
                found += [(e, r, 1.0) for e, r in seen]
    for recording in load_folder(options.none).values():
        sound = at_16_khz(recording.samples, recording.sample_rate_hz)
        sound = sound[: round(LENGTH_S * SAMPLE_RATE_HZ)]
        for template in templates:
            found += [(e, r, NONE_WEIGHT) for e, r in looks(sound, template, None)]
    evidence, right, weight = (np.array(column) for column in zip(*found, strict=True))
    weights, bias = regress(evidence, right, weight)
    parts = {"weights": [float(f"{w:.5g}") for w in weights], "bias": float(f"{bias:.5g}")}
    options.out.write_text(json.dumps(parts) + "\n", encoding="utf-8")
    print(f"{len(right)} looks, {right.mean():.1%} right: {parts}")


def at_16_khz(samples: F32, rate_hz: int) -> F32:
    """Return a sound at the follower's rate."""
    return np.asarray(soxr.resample(samples, rate_hz, SAMPLE_RATE_HZ), np.float32)


if __name__ == "__main__":
    main(tyro.cli(Options))
