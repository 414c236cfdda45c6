"""A window of sound in numbers: what tells music, speech and everything else apart.

Speech comes in syllables (about 4 Hz), its pitch glides, and it pauses into silence. Music keeps
its partials for longer than a syllable, has a beat, bass, and fills the pauses. A song does both,
and so does somebody who talks over music: what sounds in the *quiet* frames tells.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.fft

from downbeat.perception.features import F32
from downbeat.perception.router_frames import FRAME_RATE_HZ, NUM_MELS, Frames

MIN_FRAMES = 62
"""1 s: below this nothing can be said about rhythm."""
RANGE_DB = 50.0
"""What is quieter than this below the loud frames is silence."""
GROUPS = 8
MODULATION_HZ = (0.4, 1.5, 3.0, 5.0, 8.0, 14.0, 28.0)
BEAT_S = (0.3, 1.0)
LAGS = (4, 8, 16, 32)
"""Frames: 64 ms (a phoneme) to half a second (two syllables)."""
NUM_SHAPE = 12
VAD_FEATURES = 7
"""The last so many; they are left out where there is no voice activity detector."""


def window_features(frames: Frames, voice: F32) -> F32:
    """Return the numbers of a window, (NUM_FEATURES,).

    Args:
        frames: At least MIN_FRAMES.
        voice: (k,) p(voice) of the frames of 32 ms in the same window; empty: not known (NaN).
    """
    loud = float(np.percentile(frames.level, 95.0)) + 1e-12
    floor = loud * 10.0 ** (-RANGE_DB / 10.0)
    level_db = 10.0 * np.log10((frames.level + floor) / loud)  # (n,)
    bands_db = 10.0 * np.log10((frames.mels + floor / NUM_MELS) / loud)  # (n, NUM_MELS)
    order = np.argsort(level_db, kind="stable")
    quarter = len(order) // 4
    quiet, loudest = order[:quarter], order[-quarter:]
    return np.concatenate(
        (
            _shape(bands_db),
            _change(bands_db),
            _beat(bands_db),
            _modulation(bands_db),
            _level(level_db, bands_db),
            _tonality(frames, quiet, loudest),
            _pitch(frames, level_db),
            _continuity(frames, quiet),
            _voice(voice),
        )
    ).astype(np.float32)


def _shape(bands_db: F32) -> F32:
    """Envelope of the mean spectrum without its level, (NUM_SHAPE,)."""
    return np.asarray(scipy.fft.dct(bands_db.mean(axis=0), norm="ortho")[1 : NUM_SHAPE + 1])


def _change(bands_db: F32) -> F32:
    """How much eight groups of bands move, over the window and from frame to frame, (16,)."""
    spread = bands_db.std(axis=0).reshape(GROUPS, -1).mean(axis=1)
    step = np.abs(np.diff(bands_db, axis=0)).mean(axis=0).reshape(GROUPS, -1).mean(axis=1)
    return np.concatenate((spread, step))


def _beat(bands_db: F32) -> F32:
    """Onsets and how regular they are: of all bands, of the low and of the high ones, (15,)."""
    rise = np.maximum(np.diff(bands_db, axis=0), 0.0)
    found = []
    for part in (rise, rise[:, : NUM_MELS // 4], rise[:, NUM_MELS // 2 :]):
        onset = part.mean(axis=1)
        mean = onset.mean() + 1e-6
        centred = onset - mean
        spectrum = scipy.fft.rfft(centred, 2 * len(centred))
        correlation = scipy.fft.irfft(np.abs(spectrum) ** 2)[: len(centred)]
        correlation = correlation / (correlation[0] + 1e-6)
        first, end = (round(s * FRAME_RATE_HZ) for s in BEAT_S)
        end = min(end, len(correlation) - 1)
        lags = correlation[first:end]
        twice = correlation[2 * first : 2 * end : 2]
        both = lags[: len(twice)] + twice if len(twice) else lags
        found += [
            mean,
            onset.std() / mean,
            np.percentile(onset, 95.0) / mean,
            lags.max() - np.median(lags),
            both.max(),
        ]
    return np.array(found)


def _modulation(bands_db: F32) -> F32:
    """Log power of the envelopes of four groups of bands in six modulation bands, (24,)."""
    groups = bands_db.reshape(len(bands_db), 4, -1).mean(axis=2)  # (n, 4)
    centred = groups - groups.mean(axis=0)
    window = np.hanning(len(groups) + 2)[1:-1, None]
    power = np.abs(scipy.fft.rfft(centred * window, axis=0)) ** 2 / (window**2).sum()
    hertz = np.arange(len(power)) * FRAME_RATE_HZ / len(groups)
    found = []
    for low, high in zip(MODULATION_HZ, MODULATION_HZ[1:]):
        chosen = power[(hertz >= low) & (hertz < high)]
        found.append(np.log(chosen.mean(axis=0) + 1e-3) if len(chosen) else np.zeros(4))
    return np.concatenate(found)


def _level(level_db: F32, bands_db: F32) -> F32:
    """Pauses, bass and treble, (10,)."""
    low, high = bands_db[:, :3].mean(axis=1), bands_db[:, -6:].mean(axis=1)
    return np.array(
        [
            *np.percentile(level_db, (5.0, 25.0, 50.0, 75.0)),
            (level_db < -20.0).mean(),
            (level_db < -35.0).mean(),
            *np.percentile(low, (25.0, 90.0)),
            *np.percentile(high, (25.0, 90.0)),
        ]
    )


def _tonality(frames: Frames, quiet: F32, loudest: F32) -> F32:
    """How tonal the sound is, and whether it is so in the quiet frames too, (12,)."""
    crest = np.sqrt((frames.fine**2).mean(axis=1))
    found = []
    for values in (frames.flatness, frames.harmonicity, crest):
        found += [values.mean(), values.std(), values[quiet].mean(), values[loudest].mean()]
    return np.array(found)


def _pitch(frames: Frames, level_db: F32) -> F32:
    """How the pitch moves where there is one, (6,)."""
    voiced = (frames.harmonicity > 0.6) & (level_db > -25.0)
    pairs = voiced[1:] & voiced[:-1]
    if pairs.sum() < 10:
        return np.array([voiced.mean(), 0.0, 0.0, 0.0, 0.0, 0.0])
    step = np.abs(np.diff(frames.pitch))[pairs]
    held = pairs & (np.abs(np.diff(frames.pitch)) < 0.02)  # a quarter tone
    return np.array(
        [
            voiced.mean(),
            frames.pitch[voiced].mean() - 7.5,
            frames.pitch[voiced].std(),
            np.minimum(step, 0.2).mean(),
            (step < 0.02).mean(),
            _runs(held).max(initial=0) / FRAME_RATE_HZ,
        ]
    )


def _continuity(frames: Frames, quiet: F32) -> F32:
    """How long partials last, in the low and the high half, (12,)."""
    found: list[float] = []
    half = frames.fine.shape[1] // 3
    for part in (frames.fine[:, :half], frames.fine[:, half:]):
        norm = np.sqrt((part**2).sum(axis=1)) + 1e-3
        unit = part / norm[:, None]
        for lag in LAGS:
            alike = (unit[lag:] * unit[:-lag]).sum(axis=1)
            found.append(float(alike.mean()))
            if lag == 8:
                found.append(float(np.percentile(alike, 85.0)))
                found.append(float(alike[quiet[quiet < len(alike)]].mean()))
    return np.array(found)


def _voice(voice: F32) -> F32:
    """What the voice activity detector says, (VAD_FEATURES,)."""
    if len(voice) == 0:
        return np.full(VAD_FEATURES, np.nan)
    voiced = voice >= 0.5
    return np.array(
        [
            voiced.mean(),
            voice.mean(),
            voice.std(),
            (voice > 0.9).mean(),
            (voice < 0.1).mean(),
            np.abs(np.diff(voiced.astype(float))).sum() / len(voice),
            _runs(voiced).max(initial=0) / len(voice),
        ]
    )


def _runs(flags: F32) -> F32:
    """Return the lengths of the runs of true."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(np.int8), [0]))))
    return edges[1::2] - edges[::2]


def _count(make: Callable[[Frames, F32], F32]) -> int:
    from downbeat.perception.router_frames import WINDOW, analyse

    still = analyse(np.ones((MIN_FRAMES, WINDOW), np.float32))
    return len(make(still, np.zeros(0, np.float32)))


NUM_FEATURES = _count(window_features)
