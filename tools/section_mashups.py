"""Mashups to learn section changes from: passages at many speeds, cut or faded, in rooms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.signal
import soxr

from downbeat.perception import section_features as sf
from downbeat.perception.features import F32
from downbeat.perception.source import Recording
from downbeat.tools.eval_sections import LEVEL_DB, MIN_RMS

MASHUP_S = 300.0
SECTIONS_S, LONG_SECTIONS_S = (8.0, 40.0), (50.0, 150.0)
LONG_SHARE = 0.12
"""Of the mashups, with long sections: what changes inside a piece is no cut."""
KIN_SHARE, MIN_KIN = 0.35, 4
"""Of the mashups, of recordings whose names begin alike: one game's, one band's."""
SPEEDS, PLAIN_SHARE = (0.86, 1.17), 0.4
FADED_SHARE, FADES_S = 0.3, (0.003, 0.12)
ROOM_SHARE, ROOMS_S = 0.15, (0.2, 0.8)
NOISE_SHARE, NOISE_DB = 0.2, (-45.0, -20.0)
LOUDNESS_DB = (-18.0, 4.0)
QUIET_SHARE = 0.1
"""Of the passages that fall silent, those that are used."""


@dataclass(frozen=True)
class Pool:
    """Recordings to cut from, and which are kin.

    Attributes:
        tracks: At 16 kHz.
        kin: Numbers of recordings whose names begin alike, MIN_KIN or more each.
    """

    tracks: Sequence[Recording]
    kin: Sequence[np.ndarray]


def pool_of(tracks: Sequence[Recording]) -> Pool:
    """Return a pool of recordings."""
    families: dict[str, list[int]] = {}
    for number, track in enumerate(tracks):
        families.setdefault(track.name.partition("_")[0], []).append(number)
    return Pool(tracks, [np.array(kin) for kin in families.values() if len(kin) >= MIN_KIN])


def varied_mashup(pool: Pool, rng: np.random.Generator) -> tuple[F32, list[int]]:
    """Return (samples at 16 kHz, first samples after the cuts) of MASHUP_S."""
    numbers = np.arange(len(pool.tracks))
    if pool.kin and rng.random() < KIN_SHARE:
        numbers = pool.kin[int(rng.integers(len(pool.kin)))]
    section_s = LONG_SECTIONS_S if rng.random() < LONG_SHARE else SECTIONS_S
    faded = rng.random() < FADED_SHARE
    length, last = 0, -1
    sound = np.zeros(round((MASHUP_S + 2.0 * LONG_SECTIONS_S[1]) * sf.RATE_HZ), np.float32)
    cuts: list[int] = []
    while length < MASHUP_S * sf.RATE_HZ:
        number = int(numbers[rng.integers(len(numbers))])
        if number == last:
            continue
        part = _passage(pool.tracks[number].samples, float(rng.uniform(*section_s)), rng)
        if _falls_silent(part) and rng.random() >= QUIET_SHARE:
            continue
        if length:
            overlap = round(float(rng.uniform(*FADES_S)) * sf.RATE_HZ) if faded else 0
            rise = np.sqrt(np.linspace(0.0, 1.0, overlap, dtype=np.float32))
            part[:overlap] *= rise
            sound[length - overlap : length] *= rise[::-1]
            length -= overlap
            cuts.append(length + overlap // 2)
        sound[length : length + len(part)] += part
        length, last = length + len(part), number
    count = round(MASHUP_S * sf.RATE_HZ)
    sound = _placed(sound[:count], rng)
    return sound, [cut for cut in cuts if cut < count - sf.RATE_HZ]


def _passage(samples: F32, seconds: float, rng: np.random.Generator) -> F32:
    """Return a passage at some speed and level."""
    speed = 1.0 if rng.random() < PLAIN_SHARE else float(rng.uniform(*SPEEDS))
    count = min(round(seconds * speed * sf.RATE_HZ), len(samples))
    first = int(rng.integers(len(samples) - count + 1))
    part = samples[first : first + count]
    if speed != 1.0:
        part = soxr.resample(part, speed * sf.RATE_HZ, float(sf.RATE_HZ), quality="LQ")
    return np.float32(10.0 ** (float(rng.uniform(-LEVEL_DB, LEVEL_DB)) / 20.0)) * part


def _falls_silent(part: F32) -> bool:
    eighths = part[: len(part) // 8 * 8].reshape(8, -1).astype(np.float64)
    return float(np.sqrt((eighths**2).mean(1)).min()) < MIN_RMS


def _placed(sound: F32, rng: np.random.Generator) -> F32:
    """Return a sound as heard in some room, over some noise, at some loudness."""
    if rng.random() < ROOM_SHARE:
        count = round(float(rng.uniform(*ROOMS_S)) * sf.RATE_HZ)
        tail = rng.standard_normal(count) * 10.0 ** (-3.0 * np.arange(count) / count)
        tail = (tail / np.sqrt((tail**2).sum())).astype(np.float32)
        wet = scipy.signal.oaconvolve(sound, tail)[: len(sound)]
        sound = sound + np.float32(rng.uniform(0.2, 1.0)) * wet.astype(np.float32)
    if rng.random() < NOISE_SHARE:
        level = float(np.sqrt((sound.astype(np.float64) ** 2).mean()))
        level *= 10.0 ** (float(rng.uniform(*NOISE_DB)) / 20.0)
        sound = sound + np.float32(level) * rng.standard_normal(len(sound), dtype=np.float32)
    return np.float32(10.0 ** (float(rng.uniform(*LOUDNESS_DB)) / 20.0)) * sound
