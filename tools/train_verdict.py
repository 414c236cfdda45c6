"""`python -m downbeat.tools.train_verdict`: learn what makes a match right, and where to accept it.

Logistic regression on windows of every recording of some folders, asked of a catalogue that holds
it and of one that does not (verdict_windows.py). Each folder is held apart in turn: what the
script reports, and the thresholds, come from weights that never heard the folder.
"""

from __future__ import annotations

import argparse
import io
import sys
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import Bounds, minimize
from scipy.special import expit

from downbeat.perception import features as ft
from downbeat.perception.verdict import (
    FORMAT,
    MEASURES,
    WEIGHTS,
    WITNESSES,
    Line,
    certainty,
    with_length,
)
from downbeat.runtime.errors import DownbeatError
from downbeat.tools import sparse_sounds
from downbeat.tools.console import say
from downbeat.tools.errors import ToolError
from downbeat.tools.verdict_windows import LENGTHS_S, VerdictStudy

F64 = npt.NDArray[np.float64]
Rows = Mapping[str, npt.NDArray[Any]]

SOUNDS, SEED = 16, 1
SPARSE_ROW = "single sounds"
RIDGE = 20.0
"""Cost of a squared weight, in rows; of measures in units of their own spread."""
ACCEPTED = 0.00075
"""Share of windows of strangers, voices and tones among them, that may stand above the threshold.
One in two thousand accepts a point less of 3 s through the robot's microphone, one in a thousand
takes twice as many for another piece of their composer as one in two thousand does."""
LOCKED_ABOVE = 1.75
"""A lock asks for so much more: a listener that is lost asks 40,000 windows an hour."""


@dataclass(frozen=True)
class Model:
    """Weights for measures as they are."""

    weights: F64
    bias: float

    def log_odds(self, measures: F64) -> F64:
        """Weigh rows, (n, 2 MEASURES + 1), as `Verdict.log_odds` does."""
        return np.asarray(measures @ self.weights + self.bias + certainty(measures))


def main(arguments: Sequence[str] | None = None) -> None:
    """Gather, report on each folder held apart, write weights and thresholds."""
    parser = argparse.ArgumentParser(prog="python -m downbeat.tools.train_verdict")
    parser.add_argument("--tracks", type=Path, nargs="+", required=True, help="folders of music")
    parser.add_argument("--groups", type=Path, nargs="*", default=[], help="track, tab, group")
    parser.add_argument("--speech", type=Path, nargs="*", default=[], help="folders of voices")
    parser.add_argument(
        "--windows", type=Path, help="keep what was gathered in this folder, for another run"
    )
    parser.add_argument(
        "--sounds", type=int, default=SOUNDS, help=f"of each recording (default: {SOUNDS})"
    )
    parser.add_argument(
        "--out", type=Path, default=WEIGHTS,
        help="an .npz file (default: replace the weights that the matcher reads)",
    )  # fmt: skip
    args = parser.parse_args(arguments)
    _check(args)
    folders = {
        str(tracks): gather(tracks, groups, args.speech, args.sounds, args.windows)
        for tracks, groups in zip(args.tracks, args.groups or [None] * len(args.tracks))
    }
    apart = held_apart(folders) if len(folders) > 1 else {n: fit([r]) for n, r in folders.items()}
    scores = np.concatenate([apart[n].log_odds(_measures(r)) for n, r in folders.items()])
    rows = {
        key: np.concatenate([r[key] for r in folders.values()])
        for key in ("frames", "is_right", "is_known", "is_kin", "condition", "track")
    }
    accept, lock = thresholds(rows, scores)
    report(rows, scores, accept, lock)
    save(args.out, fit(list(folders.values())), accept, lock)
    print(f"written: {args.out} ({args.out.stat().st_size / 1e3:.1f} kB)")


def _check(args: argparse.Namespace) -> None:
    """Refuse before the work what would fail after it."""
    if args.groups and len(args.groups) != len(args.tracks):
        raise ToolError(
            f"{len(args.groups)} group files for {len(args.tracks)} folders; valid is one for "
            "each, or none."
        )
    if len({path.resolve() for path in args.tracks}) < len(args.tracks):
        raise ToolError("--tracks names a folder twice; each is held apart from the others.")
    if args.sounds < 1:
        raise ToolError(f"--sounds {args.sounds} gathers nothing; valid is 1 or more.")
    if args.out.suffix != ".npz" or not args.out.parent.is_dir():
        raise ToolError(f"--out {args.out} cannot be written; valid is NAME.npz in a folder.")
    if not args.speech:
        say("no --speech: nothing is heard among voices or through the robot's microphone")
    if len(args.tracks) < 2:
        say("one folder: nothing is held apart, and the thresholds come from what was learned")


def gather(
    tracks: Path, groups: Path | None, speech: Sequence[Path], count: int, keep: Path | None
) -> Rows:
    """Return the windows of a folder, perhaps those kept by an earlier run."""
    what = [str(path.resolve()) for path in (tracks, *speech)]
    made_of = zlib.crc32("|".join([*what, str(groups), str(count), str(SEED)]).encode())
    kept = keep / f"{tracks.name}-{made_of:08x}.npz" if keep else None
    if kept is not None and kept.is_file():
        with np.load(kept) as file:
            return dict(file)
    print(f"{tracks}: gathering", flush=True)
    rows = VerdictStudy(tracks, speech, groups).windows(count, SEED).arrays()
    if kept is not None:
        buffer = io.BytesIO()
        np.savez_compressed(buffer, allow_pickle=False, **rows)
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_bytes(buffer.getvalue())
    return rows


def _measures(rows: Rows) -> F64:
    return with_length(rows["measures"], rows["frames"])


def fit(folders: Sequence[Rows]) -> Model:
    """Fit weights to the rows of some folders; of witnesses they are the same at every length."""
    measures = np.concatenate([_measures(rows) for rows in folders])
    is_right = np.concatenate([rows["is_right"] for rows in folders])
    centre, spread = measures.mean(0), measures.std(0) + 1e-9
    scaled = (measures - centre) / spread
    sign = np.where(is_right, 1.0, -1.0)

    def cost(parameters: F64) -> tuple[float, F64]:
        weights, bias = parameters[:-1], parameters[-1]
        margin = sign * (scaled @ weights + bias)
        pull = -sign * expit(-margin)
        slope = np.append(scaled.T @ pull + RIDGE * weights, pull.sum())
        value = float(np.logaddexp(0.0, -margin).sum()) + 0.5 * RIDGE * float(weights @ weights)
        return value, slope

    start = np.zeros(measures.shape[1] + 1)
    lowest, highest = np.full_like(start, -np.inf), np.full_like(start, np.inf)
    lowest[:MEASURES][WITNESSES] = lowest[MEASURES:-2][WITNESSES] = 0.0
    highest[MEASURES:-2][WITNESSES] = 0.0
    found = minimize(
        cost, start, jac=True, method="L-BFGS-B", bounds=Bounds(lowest, highest),
        options={"maxiter": 2000},
    )  # fmt: skip
    weights = found.x[:-1] / spread
    return Model(weights, float(found.x[-1] - centre @ weights))


def held_apart(folders: Mapping[str, Rows]) -> dict[str, Model]:
    """Return for each folder weights that have not heard it."""
    return {name: fit([r for n, r in folders.items() if n != name]) for name in folders}


def thresholds(rows: Rows, scores: F64) -> tuple[Line, Line]:
    """Return what a window must reach to be accepted, and for a lock, by its length."""
    strangers, share = ~rows["is_known"], 1.0 - ACCEPTED
    fewest = min(int((is_long & strangers).sum()) for is_long in _by_length(rows))
    if fewest == 0:
        raise ToolError("Too few windows for thresholds; valid are more --sounds or recordings.")
    if fewest * ACCEPTED < 1.0:
        say(f"only {fewest} windows of strangers of a length: one in a thousand is a guess")
    # Straight over the logarithm of the length: the few highest of each length scatter.
    levels = [np.quantile(scores[is_long & strangers], share) for is_long in _by_length(rows)]
    slope = float(np.polyfit(np.log(LENGTHS_S), levels, 1)[0])
    level = Line(0.0, slope).of((rows["frames"] + 1.0) * ft.HOP_S)
    accept = float(np.quantile((scores - level)[strangers], share))
    return Line(accept, slope), Line(accept + LOCKED_ABOVE, slope)


def _by_length(rows: Rows) -> list[npt.NDArray[np.bool_]]:
    # A window holds a few frames less than its length: odd ones, and what has no whole hop left.
    seconds = (rows["frames"] + 1.0) * ft.HOP_S
    nearest = np.abs(np.log(seconds[:, None] / np.array(LENGTHS_S))).argmin(1)
    return [nearest == number for number in range(len(LENGTHS_S))]


def report(rows: Rows, scores: F64, accept: Line, lock: Line) -> None:
    """Print a table per length: what is accepted of which condition, and of strangers."""
    # "tempo+2%" and its like are one row.
    plain = np.array([str(name).rstrip("0123456789+-%.") for name in rows["condition"]])
    plain = np.where(np.char.startswith(rows["track"], sparse_sounds.NAME), SPARSE_ROW, plain)
    names = sorted(set(plain.tolist()))
    for is_long, length in zip(_by_length(rows), LENGTHS_S):
        needed, sure = accept.of(length), lock.of(length)
        known = is_long & rows["is_known"]
        strangers = is_long & ~rows["is_known"]
        others = strangers & ~rows["is_kin"]
        print(
            f"{length:g} s: accepted above {needed:.2f}, locked above {sure:.2f}; strangers "
            f"{strangers.sum()}: {_share(scores[strangers] > needed, strangers[strangers]):.2f} %, "
            f"highest {scores[strangers].max():.1f}; not kin {others.sum()}: "
            f"{_share(scores[others] > needed, others[others]):.2f} %, "
            f"highest {scores[others].max():.1f}"
        )
        for name in names:
            here = known & (plain == name)
            right = rows["is_right"] & here
            if here.any():
                print(
                    f"    {name:13} n {here.sum():5}  right {_share(right, here):5.1f}  accepted "
                    f"{_share(right & (scores > needed), here):5.1f}  locked "
                    f"{_share(right & (scores > sure), here):5.1f}"
                )


def _share(some: npt.NDArray[np.bool_], of: npt.NDArray[np.bool_]) -> float:
    return 100.0 * float(some.sum()) / max(float(of.sum()), 1.0)


def save(path: Path, model: Model, accept: Line, lock: Line) -> None:
    """Write what perception/verdict.py reads."""
    np.savez_compressed(
        path, format=FORMAT, weights=model.weights.astype(np.float32), bias=model.bias,
        accept=np.array(accept), lock=np.array(lock),
    )  # fmt: skip


if __name__ == "__main__":
    try:
        main()
    except DownbeatError as error:
        print(f"train_verdict: {error}", file=sys.stderr)
        sys.exit(2)
