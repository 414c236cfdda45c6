"""The constellation map (Wang 2003): peaks of the spectrum hashed in pairs, and who has them.

Peaks are taken from the whitened log spectrum of features.py, so that loudness, room and microphone
matter little, and on its log axis, so that a pair keeps its interval when the pitch changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter

I64 = npt.NDArray[np.int64]
U32 = npt.NDArray[np.uint32]
I8 = npt.NDArray[np.int8]

PEAK_FRAMES, PEAK_BANDS = 3, 4
"""A peak is the highest within so many frames (40 ms) and bands on either side."""
PEAK_MIN = 30
"""On the int8 scale of the index; 0.7 deviations above the neighbourhood."""
FAN = 5
"""Pairs of one anchor."""
MIN_STEP, MAX_STEP = 2, 30
"""Frames between the peaks of a pair: 80 ms to 1.2 s."""
MAX_INTERVAL = 31
"""Bands between the peaks of a pair: 1.3 octaves."""
PITCH_BANDS = 2
"""Bands of one cell of the anchor's pitch."""
AHEAD = 40
"""Following peaks looked at from each anchor."""
KEY_BITS = 18
CONSTANTS = (
    PEAK_FRAMES, PEAK_BANDS, PEAK_MIN, FAN, MIN_STEP, MAX_STEP, MAX_INTERVAL, PITCH_BANDS, AHEAD
)  # fmt: skip


@dataclass(frozen=True)
class Postings:
    """Which places have a landmark: rows of `places` between `starts[i]` and `starts[i + 1]`.

    Attributes:
        keys: (u,) hashes that occur, ascending.
        starts: (u + 1,) where the places of each begin.
        places: (m,) frame of the anchor, counted through all tracks, ascending within a hash.
    """

    keys: U32
    starts: U32
    places: U32


def find_peaks(values: I8) -> tuple[I64, I64]:
    """Return frame and band of the peaks, in the order of time."""
    size = (2 * PEAK_FRAMES + 1, 2 * PEAK_BANDS + 1)
    highest = maximum_filter(values, size, mode="constant", cval=-128)
    frames, bands = np.nonzero((values == highest) & (values >= PEAK_MIN))
    return frames, bands


def pair_peaks(frames: I64, bands: I64) -> tuple[U32, I64]:
    """Hash every peak with some that follow; return hashes and the frames of their anchors."""
    keys: list[U32] = []
    anchors: list[I64] = []
    used = np.zeros(len(frames), np.int64)
    for ahead in range(1, min(AHEAD, len(frames) - 1) + 1):
        step = frames[ahead:] - frames[:-ahead]
        interval = bands[ahead:] - bands[:-ahead]
        is_pair = (step >= MIN_STEP) & (step <= MAX_STEP) & (np.abs(interval) <= MAX_INTERVAL)
        (first,) = np.nonzero(is_pair & (used[:-ahead] < FAN))
        used[first] += 1
        key = (bands[first] // PITCH_BANDS) * 64 + interval[first] + MAX_INTERVAL
        keys.append((key * 32 + step[first]).astype(np.uint32))
        anchors.append(frames[first])
    if not keys:
        return np.zeros(0, np.uint32), np.zeros(0, np.int64)
    return np.concatenate(keys), np.concatenate(anchors)


def make_postings(tracks: Sequence[I8]) -> Postings:
    """Return the landmarks of tracks, each (n_i, NUM_BANDS)."""
    rows: list[npt.NDArray[np.uint64]] = []
    begin = 0
    for values in tracks:
        keys, frames = pair_peaks(*find_peaks(values))
        rows.append(keys.astype(np.uint64) << np.uint64(32) | (frames + begin).astype(np.uint64))
        begin += len(values)
    return sort_postings(np.concatenate(rows))


def sort_postings(rows: npt.NDArray[np.uint64]) -> Postings:
    """Return postings of (hash << 32 | place)."""
    rows = np.unique(rows)
    keys, starts = np.unique((rows >> np.uint64(32)).astype(np.uint32), return_index=True)
    starts = np.append(starts, len(rows)).astype(np.uint32)
    return Postings(keys, starts, (rows & np.uint64(0xFFFFFFFF)).astype(np.uint32))
