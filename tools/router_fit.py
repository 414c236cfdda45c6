"""The network of the embedded router, fitted with numpy alone (Adam, dropout, several starts)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from downbeat.perception.features import F32
from downbeat.perception.router_embedded import CLIP, RouterNet
from downbeat.perception.router_features import VAD_FEATURES


@dataclass(frozen=True)
class FitOptions:
    """How the network is fitted.

    Attributes:
        hidden: Units of the hidden layer.
        networks: How many, from different starts.
        epochs: Rounds over the rows.
        batch: Rows per step.
        rate: Step size at the beginning; it falls to nothing (cosine).
        decay: Weight decay.
        noise: Of the standardised features: rooms that nobody heard.
        no_voice: Share of rows that are shown without voice activity, for where there is none.
    """

    hidden: int = 48
    networks: int = 5
    epochs: int = 80
    batch: int = 256
    rate: float = 3e-3
    decay: float = 1e-3
    noise: float = 0.4
    no_voice: float = 0.15


def fit(values: F32, truth: F32, weights: F32, seed: int, options: FitOptions) -> RouterNet:
    """Fit.

    Args:
        values: (n, NUM_FEATURES).
        truth: (n, 2) p_music and p_speech.
        weights: (n,) how much a row counts.
        seed: Of starts, order and noise.
        options: How.
    """
    mean = np.nanmean(values, axis=0)
    spread = np.nanstd(values, axis=0) + 1e-3
    scaled = np.clip((values - mean) / spread, -CLIP, CLIP).astype(np.float32)
    scaled = np.where(np.isfinite(scaled), scaled, 0.0)
    made = [
        _fit_one(scaled, truth, weights, np.random.default_rng([seed, n]), options)
        for n in range(options.networks)
    ]
    parts = [np.stack(part).astype(np.float32) for part in zip(*made)]
    return RouterNet(mean.astype(np.float32), spread.astype(np.float32), *parts)


def _fit_one(
    scaled: F32, truth: F32, weights: F32, rng: np.random.Generator, options: FitOptions
) -> tuple[F32, ...]:
    count, features = scaled.shape
    hidden = options.hidden
    parts = [
        rng.standard_normal((features, hidden)) * np.sqrt(2.0 / features),
        np.zeros(hidden),
        rng.standard_normal((hidden, 2)) * np.sqrt(1.0 / hidden),
        np.zeros(2),
    ]
    first = [np.zeros_like(p) for p in parts]
    second = [np.zeros_like(p) for p in parts]
    steps = options.epochs * (count // options.batch)
    step = 0
    for _ in range(options.epochs):
        order = rng.permutation(count)
        for begin in range(0, count - options.batch + 1, options.batch):
            rows = order[begin : begin + options.batch]
            x = scaled[rows] + options.noise * rng.standard_normal((len(rows), features))
            x[rng.random(len(rows)) < options.no_voice, -VAD_FEATURES:] = 0.0
            slopes = _slopes(x, truth[rows], weights[rows], parts, rng)
            step += 1
            rate = options.rate * 0.5 * (1.0 + np.cos(np.pi * step / steps))
            for n, slope in enumerate(slopes):
                first[n] = 0.9 * first[n] + 0.1 * slope
                second[n] = 0.999 * second[n] + 0.001 * slope**2
                move = first[n] / (1 - 0.9**step)
                move = move / (np.sqrt(second[n] / (1 - 0.999**step)) + 1e-8)
                parts[n] = parts[n] - rate * (move + options.decay * parts[n] * (parts[n].ndim > 1))
    return tuple(parts)


def _slopes(
    x: F32, truth: F32, weights: F32, parts: list[F32], rng: np.random.Generator
) -> tuple[F32, ...]:
    """Return the slopes of the weighted cross entropy, with a fifth of the hidden units off."""
    into, into_bias, out, out_bias = parts
    raw = x @ into + into_bias  # (b, h)
    keep = (raw > 0.0) * (rng.random(raw.shape) < 0.8) / 0.8
    active = raw * keep
    guess = 1.0 / (1.0 + np.exp(-(active @ out + out_bias)))  # (b, 2)
    wrong = (guess - truth) * weights[:, None] / weights.sum()
    back = (wrong @ out.T) * keep
    return x.T @ back, back.sum(axis=0), active.T @ wrong, wrong.sum(axis=0)
