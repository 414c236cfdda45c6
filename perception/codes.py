"""An inverted index of binary codes: which places sound roughly like a moment of a query.

A code is the signs of 18 projections of 0.8 s of coarse features. The projections are the
eigenvectors of the mean correlation of music: smooth patterns in which noise averages out, and
whose signs are hardly correlated, so that all codes are about equally rare. Codes of all bands and
of the low, the high and the middle half live in four tables. A query also looks up the codes that
its least certain signs would give. Measured against pairs of peaks in docs/catalogue.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.linalg import eigh, toeplitz

from downbeat.perception import features as ft
from downbeat.perception.features import F32
from downbeat.perception.index import COARSE_BANDS, Coarse, coarse

I64 = npt.NDArray[np.int64]
U32 = npt.NDArray[np.uint32]

ROWS, CELLS = 5, ft.NUM_BANDS // COARSE_BANDS
"""0.8 s of coarse features, 1/8 octave each."""
BITS = 18
TABLES = (
    (0, CELLS),
    (0, CELLS // 2 + 1),
    (CELLS // 2, CELLS),
    (CELLS // 4, CELLS - CELLS // 4),
)
"""First cell of each table's codes, and where they stop."""
UNCERTAIN, SHORT_UNCERTAIN, SHORT_ROWS = 6, 8, 20
"""Signs tried both ways; more in a query of so few coarse rows (3.2 s), which has fewer codes."""
FLIP_COST = 2.0
"""log odds against a wrong sign, per standard deviation of its projection."""
TIME_CORRELATION = 0.8
CELL_CORRELATION = (
    1.0, 0.31, 0.03, -0.04, -0.06, -0.05, -0.1, -0.11, 0.04, -0.12, -0.14, -0.14, -0.07, 0.04,
    -0.02, -0.02, 0.04, -0.02, 0.01, 0.01, -0.01, 0.02,
)  # fmt: skip
"""Between cells so many apart, in 80 pieces of music; 0 beyond."""
CONSTANTS = (ROWS, BITS, TABLES, TIME_CORRELATION, CELL_CORRELATION)


@dataclass(frozen=True)
class CodeTable:
    """Which places have a code.

    Attributes:
        starts: (keys + 1,) where the places of each key begin.
        places: (m,) coarse places, counted through all tracks, ascending within a key.
    """

    starts: U32
    places: U32


@lru_cache(maxsize=1)
def projections() -> F32:
    """Return the patterns that a moment is projected on, (ROWS * CELLS, tables * BITS)."""
    cells = np.zeros(CELLS)
    cells[: len(CELL_CORRELATION)] = CELL_CORRELATION
    time_power, time_shapes = eigh(toeplitz(TIME_CORRELATION ** np.arange(ROWS)))
    out = np.zeros((ROWS, CELLS, len(TABLES) * BITS))
    for table, (first, stop) in enumerate(TABLES):
        power, shapes = eigh(toeplitz(cells[: stop - first]))
        strength = np.outer(time_power, power)
        strongest = np.argsort(-strength, axis=None, kind="stable")[:BITS]
        for bit, (row, column) in enumerate(zip(*np.unravel_index(strongest, strength.shape))):
            shape = np.outer(time_shapes[:, row], shapes[:, column])
            out[:, first:stop, table * BITS + bit] = shape * np.sign(shape.flat[0] + 1e-12)
    return out.reshape(ROWS * CELLS, -1).astype(np.float32)


def _project(values: F32) -> F32:
    """Project every moment of coarse features, (n, CELLS) -> (n - 4, tables, BITS)."""
    moments = np.lib.stride_tricks.sliding_window_view(values, ROWS, axis=0)  # (n - 4, CELLS, 5)
    flat = np.ascontiguousarray(moments.transpose(0, 2, 1)).reshape(len(moments), -1)
    return (flat @ projections()).reshape(len(moments), len(TABLES), BITS)


def codes_of(values: F32) -> I64:
    """Return the keys of every moment, (n - 4, tables)."""
    if len(values) < ROWS:
        return np.zeros((0, len(TABLES)), np.int64)
    return (_project(values) > 0.0) @ (1 << np.arange(BITS)) + (np.arange(len(TABLES)) << BITS)


def make_code_table(tracks: Sequence[Coarse]) -> CodeTable:
    """Index the moments of tracks, each (n_i, CELLS)."""
    keys: list[I64] = []
    places: list[I64] = []
    begin = 0
    for values in tracks:
        found = codes_of(values.astype(np.float32))
        keys.append(found.T.ravel())
        places.append(np.tile(np.arange(begin, begin + len(found)), len(TABLES)))
        begin += len(values)
    rows = np.concatenate(keys).astype(np.uint64) << np.uint64(32)
    rows |= np.concatenate(places).astype(np.uint64)
    rows.sort()
    counts = np.bincount(rows >> np.uint64(32), minlength=len(TABLES) << BITS)
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.uint32)
    return CodeTable(starts, (rows & np.uint64(0xFFFFFFFF)).astype(np.uint32))


def query_codes(values: F32) -> tuple[I64, I64, F32]:
    """Return what a query looks up.

    Args:
        values: (w, NUM_BANDS) features of the query; both phases of the coarse grid are used.

    Returns:
        (k,) keys, how many coarse rows after the query's start each is, and its cost: how unlikely
        it is that so many signs are wrong, as a logarithm.
    """
    keys, rows, costs = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [np.zeros(0, np.float32)]
    weights = 1 << np.arange(BITS)
    tried = UNCERTAIN if len(values) // 2 > SHORT_ROWS else SHORT_UNCERTAIN
    subsets = (np.arange(1 << tried)[:, None] >> np.arange(tried) & 1).T  # (6, 64)
    for phase in (0, 1):
        cells = coarse(values[phase:])
        if len(cells) < ROWS:
            continue
        signed = _project(cells)  # (m, tables, BITS)
        signed /= np.sqrt((signed**2).mean((0, 2), keepdims=True) + 1e-9)
        code = (signed > 0.0) @ weights + (np.arange(len(TABLES)) << BITS)
        margin = np.abs(signed)
        doubtful = np.argpartition(margin, tried, axis=2)[:, :, :tried]
        keys.append((code[:, :, None] ^ (weights[doubtful] @ subsets)).ravel())  # m tables 64
        cost = np.take_along_axis(margin, doubtful, 2) @ subsets.astype(np.float32)
        costs.append(np.float32(FLIP_COST) * cost.ravel())
        rows.append(np.repeat(np.arange(len(cells) - ROWS + 1), len(TABLES) << tried))
    return np.concatenate(keys), np.concatenate(rows), np.concatenate(costs)
