"""The constellation map (Wang 2003): peaks of the spectrum, hashed in pairs.

Peaks are taken from the whitened log spectrum of features.py, so that loudness, room and microphone
matter little, and on its log axis, so that a pair keeps its interval when the pitch changes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter1d

from downbeat.perception import features as ft
from downbeat.perception.features import F32

I64 = npt.NDArray[np.int64]
U32 = npt.NDArray[np.uint32]
I8 = npt.NDArray[np.int8]

PEAK_FRAMES = PEAK_BANDS = 8
"""A peak is the highest within so many frames (40 ms) and bands (1/24 octave) on either side."""
PEAK_MIN = 30
"""On the int8 scale of the index; 0.7 deviations above the neighbourhood."""
FAN = 5
"""Pairs of one anchor: the next peaks that are in reach."""
MIN_STEP, MAX_STEP = 8, 60
"""Frames between the peaks of a pair: nearer ones are the same note, alike in all music."""
MAX_INTERVAL = 31
"""Bands between the peaks of a pair: 1.3 octaves."""
AHEAD = 90
"""Following peaks looked at from each anchor."""
CONSTANTS = (
    PEAK_FRAMES, PEAK_BANDS, PEAK_MIN, FAN, MIN_STEP, MAX_STEP, MAX_INTERVAL, AHEAD
)  # fmt: skip
STEP_BITS, INTERVAL_BITS = 6, 6
ANCHOR = 1 << (STEP_BITS + INTERVAL_BITS)
"""One band of the anchor in a key."""
KEYS = 256 * ANCHOR


def find_peaks(values: I8) -> tuple[I64, I64]:
    """Return frame and band of the peaks of features, (n, NUM_BANDS), in the order of time."""
    frames, bands = (np.arange(n, dtype=np.float32) for n in values.shape)
    # Features are clipped: of equal neighbours the earliest, lowest is the peak.
    height = values - (1e-3 * frames[:, None] + 1e-4 * bands)
    around = maximum_filter1d(height, 2 * PEAK_FRAMES + 1, axis=0, mode="constant", cval=-1e9)
    around = maximum_filter1d(around, 2 * PEAK_BANDS + 1, axis=1, mode="constant", cval=-1e9)
    return np.nonzero((height == around) & (values >= PEAK_MIN))


def pair_peaks(frames: I64, bands: I64) -> U32:
    """Hash every peak with some that follow.

    Args:
        frames: (p,) ascending.
        bands: (p,).

    Returns:
        (m, 2): key, and frame of the anchor.
    """
    pairs: list[U32] = [np.zeros((0, 2), np.uint32)]
    used = np.zeros(len(frames), np.int64)
    for ahead in range(1, min(AHEAD, len(frames) - 1) + 1):
        step = frames[ahead:] - frames[:-ahead]
        interval = bands[ahead:] - bands[:-ahead]
        is_pair = (step >= MIN_STEP) & (step <= MAX_STEP) & (np.abs(interval) <= MAX_INTERVAL)
        (anchor,) = np.nonzero(is_pair & (used[:-ahead] < FAN))
        used[anchor] += 1
        key = (bands[anchor] << INTERVAL_BITS) + interval[anchor] + MAX_INTERVAL
        key = (key << STEP_BITS) + step[anchor]
        pairs.append(np.stack([key, frames[anchor]], axis=1).astype(np.uint32))
    return np.concatenate(pairs)


def landmarks_of(values: I8) -> U32:
    """Return the landmarks of features at 40 ms, (n, NUM_BANDS): (m, 2) key and frame."""
    return pair_peaks(*find_peaks(values))


def query_landmarks(samples: F32, quantum: float) -> U32:
    """Return the landmarks of a query, also as they would be a band lower and higher.

    Args:
        samples: (n,) at the rate of the features.
        quantum: int8 scale of the index.

    Returns:
        (m, 2): key, and frame of 40 ms after the query's start.
    """
    even, odd = ft.features(samples), ft.features(samples[ft.HOP // 2 :])
    count = len(odd)
    values = np.zeros((2 * count, ft.NUM_BANDS), np.float32)
    values[::2], values[1::2] = even[:count], odd
    found = landmarks_of(np.round(values * quantum).astype(np.int8)).astype(np.int64)
    key, frame = found[:, 0], found[:, 1]
    shifted = np.concatenate([key, key - ANCHOR, key + ANCHOR])
    rows = np.stack([shifted, np.tile(frame, 3)], axis=1)
    return rows[(shifted >= 0) & (shifted < KEYS)].astype(np.uint32)


class Postings:
    """Where in all tracks each landmark occurs."""

    def __init__(self, tracks: Sequence[U32], lengths: Sequence[int]) -> None:
        """Take the landmarks of each track, (m_i, 2), and its number of frames."""
        begins = np.concatenate([[0], np.cumsum(lengths)])
        rows = [
            track[:, 0].astype(np.uint64) << np.uint64(32)
            | (track[:, 1].astype(np.uint64) + np.uint64(begin))
            for track, begin in zip(tracks, begins)
        ]
        joined = np.concatenate(rows) if rows else np.zeros(0, np.uint64)
        joined.sort()
        counts = np.bincount((joined >> np.uint64(32)).astype(np.int64), minlength=KEYS)
        self._starts = np.concatenate([[0], np.cumsum(counts)])
        self._places = (joined & np.uint64(0xFFFFFFFF)).astype(np.uint32)

    def look_up(self, landmarks: U32, limit: int) -> I64:
        """Return the frame at which a query would start, for every landmark in common, (v,).

        Args:
            landmarks: (m, 2) of the query.
            limit: At most so many, those of rare landmarks first.
        """
        first = self._starts[landmarks[:, 0]]
        counts = self._starts[landmarks[:, 0].astype(np.int64) + 1] - first
        rare = np.argsort(counts, kind="stable")
        rare = rare[: np.searchsorted(np.cumsum(counts[rare]), limit, side="right")]
        counts = counts[rare]
        total = int(counts.sum())
        shift = first[rare] - (np.cumsum(counts) - counts)
        found = self._places[np.repeat(shift, counts) + np.arange(total)].astype(np.int64)
        return found - np.repeat(landmarks[rare, 1].astype(np.int64), counts)
