"""The two stages of the search: a coarse scan of everything, a fine alignment of the best places.

Coarse: normalised correlation of the query with every place (160 ms, 1/8 octave), by spectra.
Fine: one Gram matrix query x reference; every (offset, rate) hypothesis is a line through it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
import scipy.fft
from numpy.lib.stride_tricks import as_strided

from downbeat.perception import features as ft
from downbeat.perception.best_places import I64, best_places
from downbeat.perception.features import F32
from downbeat.perception.index import FINE_PER_COARSE, PAD_FRAMES, QUANTUM, Coarse, Fine, Power
from downbeat.perception.index import coarse as coarse_of

FINE_S = ft.HOP_S / 2.0
"""40 ms: the grid of the reference."""
RATES = (1.0, 0.99, 1.01, 0.98, 1.02, 0.97, 1.03, 0.96, 1.04, 0.95, 1.05)
"""Time stretch; 1 first, so that ties go to it."""
BLOCK, MAX_WIDTH = 1024, 64
"""Coarse frames per spectrum and per query, 164 and 10 s."""
BLOCK_HOP = BLOCK - MAX_WIDTH
GROUP = 16
"""Blocks whose spectra are made at once."""
OFTEN = 2.0
"""One place in fifty stands that many chance spreads high: the best are among these."""
ROWS = 16
"""Frames of a query that are multiplied at once."""
QUIET_SHARE = 0.25
"""A quiet reference counts as this share of the usual: chance likeness must not be blown up."""


@dataclass(frozen=True, slots=True, order=True)
class Fit:
    """How well a query fits one place, best last in sorting order.

    Attributes:
        similarity: Normalised correlation, -1..1.
        track: Number of the track; decoys come after the tracks.
        tau_s: Position of the window's start [s].
        rate: Track seconds per real second.
        pitch: How much too high the query sounds, 1 if not.
    """

    similarity: float
    track: int
    tau_s: float
    rate: float
    pitch: float = field(default=1.0, compare=False)


class Heard:
    """A query, ready to be aligned: its frames in groups of ROWS."""

    def __init__(self, values: F32, pitch: float = 1.0) -> None:
        """Take features, (w, NUM_BANDS), and the pitch at which they were taken."""
        self.frames = len(values)
        self.pitch = pitch
        self.energy = float((values**2).sum())
        groups = -(-len(values) // ROWS)
        padded = np.zeros((groups * ROWS, values.shape[1]), np.float32)
        padded[: len(values)] = values
        self.groups = padded.reshape(groups, ROWS, -1)  # (g, ROWS, NUM_BANDS)


class CoarseScan:
    """All places of all tracks, ready to be compared with a query.

    Kept as spectra of overlapping blocks: one product per block correlates the query with all its
    places, for a quarter of what sliding it along would cost.
    """

    def __init__(self, tracks: Sequence[Coarse]) -> None:
        """Take the coarse features of each track, (n_i, d)."""
        lengths = np.array([len(values) for values in tracks])
        joined = np.concatenate(tracks)  # (n, d)
        self.starts: I64 = np.concatenate([[0], np.cumsum(lengths)[:-1]])
        self.track_of: I64 = np.repeat(np.arange(len(lengths)), lengths)  # (n,)
        self._ends = (self.starts + lengths)[self.track_of]  # (n,)
        self._scales: dict[int, tuple[F32, I64]] = {}
        blocks = -(-len(joined) // BLOCK_HOP)
        self._spectra = np.empty((BLOCK // 2 + 1, blocks, joined.shape[1]), np.complex64)
        power = np.empty(len(joined), np.float32)
        # In groups that stay in the cache: a robot waits for this when it starts.
        for first in range(0, blocks, GROUP):
            count = min(GROUP, blocks - first)
            begin, hops = first * BLOCK_HOP, count * BLOCK_HOP
            part = np.zeros((hops - BLOCK_HOP + BLOCK, joined.shape[1]), np.float32)
            rows = joined[begin : begin + len(part)]
            part[: len(rows)] = rows
            part /= np.float32(QUANTUM)
            power[begin : begin + hops] = np.einsum("ij,ij->i", part, part)[:hops][: len(rows)]
            each = np.lib.stride_tricks.sliding_window_view(part, BLOCK, axis=0)[::BLOCK_HOP]
            parts = each.transpose(2, 0, 1)  # (BLOCK, count, d)
            self._spectra[:, first : first + count] = scipy.fft.rfft(parts, axis=0)
        self._energy = np.concatenate([[0.0], np.cumsum(power, dtype=np.float64)])

    def search(self, values: F32, count: int) -> tuple[I64, float]:
        """Find the places most like a query.

        Args:
            values: (w, NUM_BANDS) features of the query.
            count: Places wanted.

        Returns:
            At most `count` places, best first, and the chance spread of the scores.
        """
        scores, chance = self.scores(coarse_of(values))
        high = np.flatnonzero(scores > OFTEN * chance)
        if len(high) < count:
            return best_places(scores, count), chance
        return high[best_places(scores[high], count)], chance

    def scores(self, query: F32) -> tuple[F32, float]:
        """Compare a query with every place.

        Args:
            query: (w, d) coarse features; what is longer than MAX_WIDTH is left out.

        Returns:
            Normalised correlation, (n,), 0 where the window would leave its track; and its standard
            deviation over the places where it does not: how much chance there is.
        """
        query = query[:MAX_WIDTH]
        scale, sample = self._scale(len(query))
        spectrum = scipy.fft.rfft(query, BLOCK, axis=0).conj()  # (bins, d)
        products = self._spectra @ spectrum[:, :, None]  # (bins, blocks, 1)
        sums = scipy.fft.irfft(products[:, :, 0].T, BLOCK, axis=1)  # (blocks, BLOCK)
        scores = sums[:, :BLOCK_HOP].ravel()[: len(scale)] * scale
        scores /= np.sqrt(float((query**2).sum()) + 1e-9)
        return scores, float(scores[sample].std()) if len(sample) else 1.0

    def _scale(self, width: int) -> tuple[F32, I64]:
        """Return what windows of this width are divided by, and places to sample chance at.

        Returns:
            (n,), 0 where a window would leave its track; and one in four of the other places.
        """
        if width not in self._scales:
            places = np.arange(len(self.track_of))
            stops = np.minimum(places + width, len(places))
            energy = self._energy[stops] - self._energy[:-1]
            floor = QUIET_SHARE * float(np.median(energy)) + 1e-9
            inside = places + width <= self._ends
            scale = np.where(inside, 1.0 / np.sqrt(np.maximum(energy, floor)), 0.0)
            sample = np.flatnonzero(inside)[::FINE_PER_COARSE]
            self._scales[width] = scale.astype(np.float32), sample
        return self._scales[width]


class FineAligner:
    """Aligns a query with one track around a place."""

    def __init__(self, fine: Sequence[Fine], power: Sequence[Power]) -> None:
        """Take the fine features of each track, (n_i, NUM_BANDS), and their power, (n_i,)."""
        self._fine = fine
        self._power = power
        self._usual: dict[int, float] = {}  # power of a frame of a track

    def align(
        self,
        heard: Heard,
        track: int,
        first: int,
        search: int,
        rates: tuple[float, ...] = RATES,
    ) -> Fit:
        """Find the best offset and rate of a query near a place.

        Args:
            heard: The query.
            track: Number of the track.
            first: Frame of the reference (40 ms) at which the query may start.
            search: Frames around it to try.
            rates: Rates to try.
        """
        frames, energy = heard.frames, heard.energy
        columns, met, margin = _lines(frames, search, rates)
        groups, span = len(heard.groups), 2 * ROWS + 2 * margin
        begin, count = first - margin, 2 * ROWS * (groups - 1) + span
        reference = _cut(self._fine[track], begin, count)  # (count, NUM_BANDS)
        along, across = reference.strides
        # Only what lies near the diagonal is multiplied: each group with the frames it may meet.
        near = as_strided(
            reference, (groups, ft.NUM_BANDS, span), (2 * ROWS * along, across, along)
        )
        gram = heard.groups @ near  # (g, ROWS, span)
        taken = gram.ravel().take(columns, mode="clip")  # (frames, rates * offsets)
        power = _cut(self._power[track], begin, count)
        # Of every line its own: chords that last are alike all along, and the loudest would win.
        length = count - 2 * search
        each = as_strided(power, (length, 2 * search + 1), 2 * power.strides)
        norms = np.sqrt(met[:, :length] @ each)  # (rates, offsets)
        scores = taken.sum(0).reshape(norms.shape)
        scores /= np.maximum(norms, self._least_norm(track, frames))
        r, d = np.unravel_index(int(scores.argmax()), scores.shape)
        # Between the frames of the reference: half a frame off costs what tells two repeats apart.
        off, top = vertex(scores[r], int(d))
        similarity = min(top / math.sqrt(max(energy, 1e-9)), 1.0)
        rate = rates[int(r)]
        # The line turns about the middle of the window; at another rate the start moves.
        turned = (frames - 1) * (1.0 - rate)
        start = first + int(d) - search + off + turned - PAD_FRAMES
        return Fit(similarity, track, start * FINE_S, rate, heard.pitch)

    def rows(self, fit: Fit, frames: int) -> Fine:
        """Return the rows of the reference that a query of so many frames met, (frames, NUM_BANDS).

        Args:
            fit: Where, and at which rate.
            frames: Of the query.
        """
        fine = self._fine[fit.track]
        at = fit.tau_s / FINE_S + PAD_FRAMES + 2.0 * fit.rate * np.arange(frames)
        places = np.round(at).astype(np.int64)
        found = np.zeros((frames, ft.NUM_BANDS), np.int8)
        inside = (places >= 0) & (places < len(fine))
        found[inside] = fine[places[inside]]
        return found

    def _least_norm(self, track: int, frames: int) -> float:
        if track not in self._usual:
            self._usual[track] = max(float(self._power[track].mean(dtype=np.float64)), 1e-9)
        return math.sqrt(max(QUIET_SHARE * self._usual[track] * frames, 1.0))


def _cut(rows: Fine | Power, begin: int, count: int) -> F32:
    """Return `count` rows from `begin`, zeros beyond the ends."""
    if begin >= 0 and begin + count <= len(rows):
        return rows[begin : begin + count].astype(np.float32)
    found = np.zeros((count, *rows.shape[1:]), np.float32)
    low, high = max(begin, 0), min(begin + count, len(rows))
    if high > low:
        found[low - begin : high - begin] = rows[low:high]
    return found


@lru_cache(maxsize=64)
def _lines(frames: int, search: int, rates: tuple[float, ...]) -> tuple[I64, F32, int]:
    """Return the lines through the Gram matrix as flat places in it, and its margin.

    Returns:
        (frames, rates * offsets) indices into the flattened (g, ROWS, 2 ROWS + 2 margin) matrix;
        which frames of the reference each rate meets at the first offset, (rates, n); the margin.
    """
    centre = (frames - 1) / 2.0
    steepest = max(abs(rate - 1.0) for rate in rates)
    margin = int(np.ceil(2.0 * centre * steepest)) + search + 2
    rows = np.arange(frames)
    lines = np.round(2.0 * (centre + np.outer(rates, rows - centre))).astype(np.int64)
    offsets = np.arange(-search, search + 1)
    columns = lines[:, None, :] + margin + offsets[None, :, None]
    # In its group, the first column is that of the group's first frame.
    begin = rows * (2 * ROWS + 2 * margin) - 2 * ROWS * (rows // ROWS)
    places = begin + columns  # (rates, offsets, frames)
    met = np.zeros((len(rates), int(columns.max()) + 2 * ROWS + 2 * margin), np.float32)
    np.add.at(met, (np.arange(len(rates))[:, None], columns[:, 0]), 1.0)
    return np.ascontiguousarray(places.reshape(-1, frames).T), met, margin


def vertex(scores: F32, peak: int) -> tuple[float, float]:
    """Return where the parabola through a peak and its neighbours stands, off it, and how high."""
    middle = float(scores[peak])
    if not 0 < peak < len(scores) - 1:
        return 0.0, middle
    left, right = float(scores[peak - 1]), float(scores[peak + 1])
    curvature = left - 2.0 * middle + right
    if curvature >= 0.0:
        return 0.0, middle
    off = 0.5 * (left - right) / curvature
    return off, middle - 0.25 * (left - right) * off
