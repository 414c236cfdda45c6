"""Passages that two recordings of a catalogue share: a quotation, a common intro, another mix.

Windows of every track are asked of all others at once. What is found in one pair of tracks does not
depend on which other tracks there are, so that adding a track asks only what concerns it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from downbeat.perception.alignment import CoarseScan, FineAligner, Heard
from downbeat.perception.candidates import ProposedScan
from downbeat.perception.codes import make_code_table
from downbeat.perception.features import F32, HOP_S
from downbeat.perception.index import FINE_PER_COARSE, PAD_FRAMES, QUANTUM, Fine, Index, coarse
from downbeat.perception.passages import Passage, shared_among

WINDOW_S = 4.0
COARSE_LIKE, FINE_LIKE = 0.3, 0.45
"""The same sound on two grids of 160 ms that lie half a step apart is still above the first; four
seconds of tracks that share nothing stay below the second: in 206 recordings it named two pairs of
mixes, one of copies, and one piece that plays another's phrases."""
EDGE_S, EDGE_LIKE, EDGES = 1.0, 0.4, 4
"""A passage is followed beyond its windows in steps of this length, so many at most."""
SAME_LINE_S = 0.1
SEARCH = 6
MAX_SCANNED, PROPOSED, SPARSE = 300, 200, 2
"""In larger catalogues every second window is asked, by an inverted index: else the time would grow
with the square of the number of tracks."""
FRAMES = round(WINDOW_S / HOP_S) // 2 * 2
STEP = 2 * FRAMES // FINE_PER_COARSE * FINE_PER_COARSE

Run = tuple[int, int, float, float, float]
"""(track, other, begin [s], end [s], offset [s])."""


def update_passages(index: Index, made: Sequence[str]) -> tuple[Passage, ...]:
    """Return what the tracks of an index share, asking only what concerns new tracks.

    Args:
        index: With what was known of its other tracks in `shared`, None if nothing was.
        made: Names of new and changed tracks.
    """
    if index.shared is None or len(index.names) > MAX_SCANNED:
        return find_passages(index)
    kept = shared_among(index.shared, set(index.names) - set(made))
    new = [number for number, name in enumerate(index.names) if name in set(made)]
    if not new:
        return kept
    old = [number for number in range(len(index.names)) if number not in set(new)]
    everything = list(range(len(index.names)))
    runs = [*_asked(index, new, everything), *_asked(index, old, new)]
    return tuple(sorted([*kept, *_passages(index, runs)]))


def find_passages(index: Index) -> tuple[Passage, ...]:
    """Return what the tracks of an index share; an index of one track shares nothing."""
    everything = list(range(len(index.names)))
    return _passages(index, _asked(index, everything, everything))


def _asked(index: Index, asking: Sequence[int], of: Sequence[int]) -> list[Run]:
    """Ask windows of some tracks of other tracks."""
    if not asking or len(set(asking) | set(of)) < 2:
        return []
    is_large = len(of) > MAX_SCANNED
    scan: CoarseScan | ProposedScan
    if is_large:
        scan = ProposedScan(index.coarse, index.codes or make_code_table(index.coarse))
    else:
        scan = CoarseScan([index.coarse[number] for number in of])
    aligner = FineAligner(index.fine, index.power)
    runs: list[Run] = []
    for track in asking:
        hits: dict[int, list[tuple[int, float]]] = {}
        fine = index.fine[track]
        step = STEP * (SPARSE if is_large else 1)
        for first in range(PAD_FRAMES, len(fine) - 2 * FRAMES - PAD_FRAMES + 1, step):
            heard = Heard(_window(fine, first, FRAMES))
            for number, begin in _places(scan, _window(fine, first, FRAMES)):
                other = number if is_large else of[number]
                if other == track:
                    continue
                fit = aligner.align(heard, other, begin, SEARCH, (1.0,))
                if fit.similarity >= FINE_LIKE:
                    start_s = (first - PAD_FRAMES) * HOP_S / 2.0
                    hits.setdefault(other, []).append((first, fit.tau_s - start_s))
        for other, found in hits.items():
            runs += _runs(index, aligner, track, other, found, step)
    return runs


def _places(scan: CoarseScan | ProposedScan, values: F32) -> Iterable[tuple[int, int]]:
    """Return the best place of each track that is like a window: (track, frame of 40 ms)."""
    if isinstance(scan, ProposedScan):
        ranked, _ = scan.search(values, PROPOSED)
        tracks, firsts = np.unique(scan.track_of[ranked], return_index=True)
        best = ranked[np.sort(firsts)]
        tracks = scan.track_of[best]
    else:
        scores, _ = scan.scores(coarse(values))
        tracks = np.flatnonzero(np.maximum.reduceat(scores, scan.starts) >= COARSE_LIKE)
        ends = np.append(scan.starts[1:], len(scores))
        best = np.array(
            [scan.starts[t] + scores[scan.starts[t] : ends[t]].argmax() for t in tracks], np.int64
        )
    for track, place in zip(tracks.tolist(), best.tolist()):
        yield int(track), FINE_PER_COARSE * (place - int(scan.starts[track]))


def _runs(
    index: Index, aligner: FineAligner, track: int, other: int,
    found: Sequence[tuple[int, float]], step: int,
) -> Iterable[Run]:  # fmt: skip
    """Join windows that continue each other, and follow the edges of what they make."""
    joined: list[tuple[int, int, float]] = []  # first frame, last frame, offset [s]
    for first, offset_s in found:
        last = first + 2 * FRAMES
        for k, (begin, end, offset) in enumerate(joined):
            if abs(offset - offset_s) < SAME_LINE_S and first <= end + step:
                joined[k] = (begin, last, offset)
                break
        else:
            joined.append((first, last, offset_s))
    for begin, end, offset_s in joined:
        begin = _edge(index, aligner, (track, other), begin, offset_s, -1)
        end = _edge(index, aligner, (track, other), end, offset_s, 1)
        if end <= begin:
            continue  # alike on the whole, and in no second of it
        frame_s = HOP_S / 2.0
        yield track, other, (begin - PAD_FRAMES) * frame_s, (end - PAD_FRAMES) * frame_s, offset_s


def _edge(
    index: Index, aligner: FineAligner, pair: tuple[int, int], edge: int, offset_s: float, way: int
) -> int:
    """Move the edge of what some windows found to where the two tracks part; returns the frame.

    Half a window is enough to find it, so that the edge may lie outside as well as inside.
    """
    fine = index.fine[pair[0]]
    frames = round(EDGE_S / HOP_S) // 2 * 2

    def is_same(first: int) -> bool:
        if first < PAD_FRAMES or first + 2 * frames > len(fine) - PAD_FRAMES:
            return False
        at = first + round(offset_s / (HOP_S / 2.0))
        heard = Heard(_window(fine, first, frames))
        return aligner.align(heard, pair[1], at, 2, (1.0,)).similarity >= EDGE_LIKE

    step, back = way * 2 * frames, 2 * frames if way > 0 else 0
    for _ in range(EDGES):
        if is_same(edge - back):
            break
        edge -= step
    for _ in range(EDGES):
        if not is_same(edge - back + step):
            break
        edge += step
    return edge


def _passages(index: Index, runs: Iterable[Run]) -> tuple[Passage, ...]:
    """Join what both tracks of a pair found of each other."""
    lines: dict[tuple[str, str], list[tuple[float, float, float]]] = {}
    for track, other, begin_s, end_s, offset_s in runs:
        one, two = index.names[track], index.names[other]
        if one > two:
            one, two = two, one
            begin_s, end_s, offset_s = begin_s + offset_s, end_s + offset_s, -offset_s
        lines.setdefault((one, two), []).append((begin_s, end_s, offset_s))
    passages: list[Passage] = []
    for (one, two), found in sorted(lines.items()):
        joined: list[tuple[float, float, float]] = []
        for begin_s, end_s, offset_s in sorted(found):
            for k, (begin, end, offset) in enumerate(joined):
                if abs(offset - offset_s) < SAME_LINE_S and begin_s <= end:
                    joined[k] = (begin, max(end, end_s), offset)
                    break
            else:
                joined.append((begin_s, end_s, offset_s))
        passages += [
            Passage(one, round(b, 2), two, round(b + offset, 2), round(e - b, 2))
            for b, e, offset in joined
        ]
    return tuple(sorted(passages))


def _window(fine: Fine, first: int, frames: int) -> F32:
    """Return features of a window of a track as if it were heard, (frames, NUM_BANDS)."""
    return fine[first : first + 2 * frames : 2].astype(np.float32) / np.float32(QUANTUM)
