"""How unlike its past a moment of music is, and how usual that is here: a stream of inputs.

What follows a moment is compared with what came before it, in many aspects: timbre, harmony,
rhythm, level, the peaks of the spectrum, directions that tell recordings apart, the best earlier
place where the music went the same way, and what stopped or began at once. Each number comes with
its difference to the mean and to the most of the last quarter of a minute.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from downbeat.perception import section_features as sf
from downbeat.perception.features import F32

AFTER, SOON = 14, 6
"""Frames that are judged: the 1.4 s, and the 0.6 s, after a moment."""
LAST = 200
"""Frames of the past with which they are compared: 20 s."""
USUAL = 150
"""Frames of the past that say what is usual: 15 s."""
LAGS = np.arange(8, LAST)
"""Frames between a passage and an earlier one that may be its like."""
EDGE = 5
"""Frames on both sides of a moment that what happens at once is heard in."""
AHEAD = AFTER - EDGE
"""Frames after it in which something as sudden may happen: 4 to AHEAD."""
NOT_YET = {"slow": 8, "fast": 4}
"""Frames before a moment that do not count as its past yet."""
UNLIKE = 4.0
"""A distance where there is nothing to compare with."""
NUM_SLOW, NUM_FAST = 35, 17
NUM_INPUTS = 3 * NUM_SLOW + 4 * NUM_FAST + 1
NUM_SHAPE = 16
SLAB = (2 * EDGE + 1) * sf.NUM_SHORT
AT = slice(EDGE * sf.NUM_SHORT - 2, EDGE * sf.NUM_SHORT + 12)
"""Short windows of a slab that belong to its moment."""


@dataclass(frozen=True)
class Maps:
    """What turns frames into vectors to compare; learned.

    Attributes:
        centre, spread: Of frames' log powers, (NUM_LONG,).
        shape_centre, shape_spread: Of their cosine coefficients, (NUM_SHAPE,).
        bare_centre, bare_spread: Of log powers less their mean, (NUM_LONG,).
        piece, piece_soon: Directions of window statistics (2 NUM_LONG, d) that tell recordings
            apart.
        frame: Directions of single frames that do, (NUM_LONG, d).
        mix: Random directions of the spectrum's peaks, (NUM_FINE, d).
    """

    centre: F32
    spread: F32
    shape_centre: F32
    shape_spread: F32
    bare_centre: F32
    bare_spread: F32
    piece: F32
    piece_soon: F32
    frame: F32
    mix: F32


class Tail:
    """The end of a sequence of rows, each known by its number from the start."""

    def __init__(self, keep: int) -> None:
        """Begin; `keep`: rows that are not forgotten."""
        self._keep, self._rows, self.first = keep, None, 0

    def append(self, rows: np.ndarray) -> None:
        """Add rows (n, ...), after dropping those that are too old."""
        if self._rows is None:
            self._rows = rows
            return
        old = max(0, len(self._rows) - self._keep)
        self._rows = np.concatenate([self._rows[old:], rows])
        self.first += old

    @property
    def end(self) -> int:
        """One past the number of the last row."""
        return self.first + (0 if self._rows is None else len(self._rows))

    def at(self, numbers: np.ndarray) -> np.ndarray:
        """Return rows by number, numbers.shape + row's; before the start: the first there is."""
        return self._rows[np.maximum(numbers - self.first, 0)]


class Context:
    """Turns frames into the inputs of the moments AFTER frames before the last."""

    def __init__(self, maps: Maps) -> None:
        """Begin a stream."""
        self._maps = maps
        keep = LAST + 4 * AFTER
        names = ("long", "fine", "short", "vectors", "frame_lags", "mix_lags", "line", "mix")
        self._frames = {name: Tail(keep) for name in names}
        self._views = {name: Tail(keep) for name in VIEWS}
        self._slow, self._fast = Tail(keep), Tail(keep)
        self._next_slow = self._next_fast = 0

    def push(self, frames: sf.Frames) -> np.ndarray:
        """Take the next frames; returns inputs (n, NUM_INPUTS) of the moments that can be judged.

        The first of them is moment 0; each is judged once.
        """
        self._take(frames)
        end = self._frames["long"].end
        fast = np.arange(self._next_fast, max(end - EDGE, self._next_fast))
        if len(fast):
            self._fast.append(self._sudden(fast))
            self._next_fast = fast[-1] + 1
        slow = np.arange(self._next_slow, max(end - AFTER, self._next_slow))
        if not len(slow):
            return np.zeros((0, NUM_INPUTS))
        self._slow.append(self._unlike(slow))
        self._next_slow = slow[-1] + 1
        return self._inputs(slow)

    def _take(self, frames: sf.Frames) -> None:
        """Keep frames, and the vectors that each has alone."""
        maps, tails = self._maps, self._frames
        scaled = (frames.long - maps.centre) / maps.spread
        bands = frames.long[:, : sf.NUM_BANDS]
        shape = (bands @ cosines() - maps.shape_centre) / maps.shape_spread
        tones = np.exp(0.5 * frames.long[:, sf.NUM_BANDS :]).reshape(len(frames), -1, 12).sum(1)
        tones /= np.sqrt((tones**2).sum(1, keepdims=True)) + 1e-6
        level = np.stack([bands[:, part].mean(1) for part in LEVELS], 1)
        bare = frames.long - frames.long.mean(1, keepdims=True)
        line = ((bare - maps.bare_centre) / maps.bare_spread) @ maps.frame
        tails["long"].append(frames.long)
        tails["fine"].append(frames.fine)
        tails["short"].append(frames.short)
        tails["vectors"].append(np.concatenate([scaled, shape, tones, level], 1))
        tails["line"].append(line)
        tails["mix"].append(frames.fine @ maps.mix)
        numbers = np.arange(tails["long"].end - len(frames), tails["long"].end)
        for rows, lags in (("line", "frame_lags"), ("mix", "mix_lags")):
            square = apart(tails[rows], numbers, LAGS) ** 2
            tails[lags].append(np.where(np.isinf(square), UNLIKE**2 * 5.0, square))

    def _unlike(self, moments: np.ndarray) -> np.ndarray:
        """Return how unlike its past what follows each moment is, (n, NUM_SLOW)."""
        tails, maps = self._frames, self._maps
        window = tails["vectors"].at(moments[:, None] + np.arange(AFTER))  # (n, AFTER, 111)
        mean, deviation = window.mean(1), window.std(1)
        soon = window[:, :SOON, : sf.NUM_LONG]
        fine = tails["fine"].at(moments[:, None] + np.arange(AFTER)).mean(1)
        long, shape = slice(0, sf.NUM_LONG), slice(sf.NUM_LONG, sf.NUM_LONG + NUM_SHAPE)
        tones, level = slice(shape.stop, shape.stop + 12), slice(shape.stop + 12, None)
        views = {
            "shape": mean[:, shape],
            "shape_spread": deviation[:, shape],
            "tones": mean[:, tones],
            "rhythm": deviation[:, level],
            "level": mean[:, level],
            "fine": fine / (np.sqrt((fine**2).sum(1, keepdims=True)) + 1e-6),
            "piece": np.concatenate([mean[:, long], deviation[:, long]], 1) @ maps.piece,
            "piece_soon": np.concatenate([soon.mean(1), soon.std(1)], 1) @ maps.piece_soon,
            "pitch": mean[:, sf.NUM_BANDS : sf.NUM_LONG],
        }
        columns = []
        for name, rows in views.items():
            self._views[name].append(rows)
            columns += _nearness(self._views[name], moments, VIEWS[name])
        columns += self._repeats("frame_lags", moments) + self._repeats("mix_lags", moments)
        half = AFTER // 2
        first, second = window[:, :half, long].mean(1), window[:, half:, long].mean(1)
        columns.append(np.sqrt(((first - second) ** 2).mean(1)))
        return np.stack(columns, 1)

    def _repeats(self, name: str, moments: np.ndarray) -> list[np.ndarray]:
        """Return how unlike the best earlier passage is to that after, about and around moments."""
        half = AFTER // 2
        square = self._frames[name].at(moments[:, None] + np.arange(-AFTER, AFTER))  # (n, 28, lags)
        before, after = square[:, :AFTER].mean(1), square[:, AFTER:].mean(1)
        about = square[:, AFTER - half : AFTER + half].mean(1)
        past = after[:, LAGS >= AFTER]
        least = [past.min(1), about.min(1), np.maximum(before, after).min(1)]
        return [np.minimum(np.sqrt(one), UNLIKE) for one in least]

    def _sudden(self, moments: np.ndarray) -> np.ndarray:
        """Return what stops and begins at once at moments, (n, NUM_FAST)."""
        around = moments[:, None] + np.arange(-EDGE, EDGE + 1)
        slab = self._frames["short"].at(around).reshape(len(moments), SLAB, sf.SHORT_BANDS)
        fine = self._frames["fine"].at(around)  # (n, 11, NUM_FINE)
        near = (fine[:, EDGE + 2] * fine[:, EDGE - 2]).sum(1)
        before, after = fine[:, : EDGE - 1].sum(1), fine[:, EDGE + 2 :].sum(1)
        lengths = np.sqrt((before**2).sum(1) * (after**2).sum(1))
        wide = (before * after).sum(1) / (lengths + 1e-6)
        return np.stack([1.0 - near, 1.0 - wide, *_steps(slab)], 1)

    def _inputs(self, moments: np.ndarray) -> np.ndarray:
        """Return inputs of moments, (n, NUM_INPUTS)."""
        columns = []
        for tail, key in ((self._slow, "slow"), (self._fast, "fast")):
            here = tail.at(moments)
            numbers = moments[:, None] - np.arange(NOT_YET[key], USUAL + 1)
            there = (numbers >= 0)[:, :, None]
            past = tail.at(numbers)  # (n, past, NUM_SLOW)
            count = np.maximum(there.sum(1), 1)
            mean = np.where(there, past, 0.0).sum(1) / count
            most = np.where(there.any(1), np.where(there, past, -np.inf).max(1), 0.0)
            columns += [here, here - mean, here - most]
        later = self._fast.at(moments[:, None] + np.arange(4, AHEAD + 1)).max(1)
        columns += [here - later, np.minimum(moments / USUAL, 1.0)[:, None]]
        return np.concatenate(columns, 1)


LEVELS = (slice(0, 4), slice(4, 12), slice(12, sf.NUM_BANDS))
VIEWS: dict[str, tuple[int, int, bool]] = {
    "shape": (AFTER, 2, True),
    "shape_spread": (AFTER, 3, False),
    "tones": (AFTER, 2, True),
    "rhythm": (AFTER, 3, False),
    "level": (AFTER, 3, False),
    "fine": (AFTER, 2, True),
    "piece": (AFTER, 2, True),
    "piece_soon": (SOON, 3, True),
    "pitch": (AFTER, 3, False),
}
"""Aspects: frames to the nearest past, frames between windows of it, whether all of it counts."""


def apart(rows: Tail, numbers: np.ndarray, lags: np.ndarray) -> np.ndarray:
    """Return the root mean square differences of rows to those lags before, inf where none is."""
    earlier = numbers[:, None] - lags
    difference = rows.at(numbers)[:, None] - rows.at(earlier)
    square = np.einsum("ijk,ijk->ij", difference, difference) / difference.shape[-1]
    return np.where(earlier >= 0, np.sqrt(square), np.inf)


def _nearness(rows: Tail, numbers: np.ndarray, view: tuple[int, int, bool]) -> list[np.ndarray]:
    """Return how far the nearest past is, and the most alike; if `full` the mean and a fifth."""
    first, stride, full = view
    far = apart(rows, numbers, np.arange(first, LAST, stride))
    known = np.isfinite(far)
    count = np.maximum(known.sum(1), 1)
    near = np.where(known[:, 0], far[:, 0], 0.0)
    least = np.where(known[:, 0], far.min(1), 0.0)
    if not full:
        return [near, least]
    mean = np.where(known, far, 0.0).sum(1) / count
    fifth = np.sort(far, 1)[np.arange(len(far)), np.minimum(count // 5, far.shape[1] - 1)]
    return [near, least, mean, np.where(np.isfinite(fifth), fifth, 0.0)]


def _steps(slab: np.ndarray) -> list[np.ndarray]:
    """Return how much falls, is replaced and changes at the middle of slabs (n, SLAB, bands)."""
    columns = []
    for lag in (4, 8):
        change = slab[:, lag:] - slab[:, :-lag]
        change = change[:, AT.start - lag // 2 : AT.stop - lag // 2]
        fallen, risen = np.maximum(-change, 0.0).mean(2), np.maximum(change, 0.0).mean(2)
        much = (np.abs(change) > 1.0).mean(2)
        columns += [fallen.max(1), np.minimum(fallen, risen).max(1), much.max(1)]
    total = np.cumsum(np.pad(slab, ((0, 0), (1, 0), (0, 0))), 1, dtype=np.float64)
    at = np.arange(AT.start, AT.stop)
    gap = 2
    for width in (5, 10, 30):
        after = total[:, at + gap + width] - total[:, at + gap]
        before = total[:, at - gap] - total[:, at - gap - width]
        change = (after - before) / width
        size = np.sort(np.abs(change), 2)
        fallen = np.maximum(-change, 0.0).mean(2)
        columns += [size[:, :, 5:7].mean(2).max(1), size.mean(2).max(1), fallen.max(1)]
    return columns


def cosines() -> np.ndarray:
    """Return the cosine transform without its constant, (NUM_BANDS, NUM_SHAPE)."""
    at = (np.arange(sf.NUM_BANDS) + 0.5) * np.pi / sf.NUM_BANDS
    return np.cos(np.outer(at, np.arange(1, NUM_SHAPE + 1))) * np.sqrt(2.0 / sf.NUM_BANDS)


def map_names() -> list[str]:
    """Return what a file of weights calls the maps."""
    return [field.name for field in fields(Maps)]
