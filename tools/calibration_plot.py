"""Reliability of the atlas: what it says at most falls, and what fell in fresh changes."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from downbeat.sim.batch.proof import at_most, fixed_upper_bound
from downbeat.tools import palette

EDGES = (0.0, 0.0101, 0.02, 0.05, 0.15, 0.999, 1.01)
NAMES = ("proven", "1 to 2 %", "2 to 5 %", "5 to 15 %", "over 15 %", "dropped slot")


def bins_of(trials: list[dict[str, Any]]) -> list[tuple[str, float, int, int]]:
    """Return name, mean bound, changes and falls of each bin of the atlas' bound."""
    made = [t for t in trials if t["plan"] in ("direct", "refused") and not t["early"]]
    made = [t for t in made if t["mode"]]
    bounds = np.array([t["bound"] for t in made])
    fell = np.array([t["fell"] for t in made])
    found = []
    for name, low, high in zip(NAMES, EDGES, EDGES[1:], strict=False):
        inside = (bounds > low) & (bounds <= high)
        if inside.any():
            mean = float(np.minimum(bounds[inside], 1.0).mean())
            found.append((name, mean, int(inside.sum()), int(fell[inside].sum())))
    return found


def lower(fallen: int, count: int) -> float:
    """Return the Clopper-Pearson lower bound (95 %, one-sided)."""
    if fallen == 0:
        return 0.0
    low, high = 0.0, fallen / count
    for _ in range(60):
        p = 0.5 * (low + high)
        if 1.0 - at_most(fallen - 1, count, p) > 0.05:
            high = p
        else:
            low = p
    return low


def draw(trials: list[dict[str, Any]], path: Path) -> Path:
    """Draw the plot."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    bins = bins_of(trials)
    with matplotlib.rc_context({"font.family": "DejaVu Sans", "font.size": 12}):
        figure = Figure(figsize=(9.6, 5.6), dpi=120, facecolor=palette.BACKGROUND)
        FigureCanvasAgg(figure)
        axes = figure.add_axes((0.1, 0.14, 0.86, 0.7), facecolor=palette.BACKGROUND)
        for spine in axes.spines.values():
            spine.set_color(palette.MUTED)
        axes.tick_params(colors=palette.MUTED)
        for index, (_, bound, count, fallen) in enumerate(bins):
            share, top = fallen / count, fixed_upper_bound(fallen, count)
            bottom = lower(fallen, count)
            good = bottom <= bound
            colour = palette.GOOD if good else palette.BAD
            axes.plot([index - 0.32, index + 0.32], [100 * bound] * 2, color=palette.INK, lw=2.2)
            axes.plot([index] * 2, [100 * bottom, 100 * top], color=colour, lw=3)
            axes.plot([index], [100 * share], "o", color=colour, ms=9)
            axes.annotate(
                f"{fallen} of {count}",
                (index, 100 * top),
                xytext=(0, 8),
                textcoords="offset points",
                color=palette.MUTED,
                ha="center",
            )
        axes.set_yscale("symlog", linthresh=0.5, linscale=0.6)
        axes.set_ylim(0.0, 150.0)
        axes.set_yticks([0, 0.5, 1, 2, 5, 10, 20, 50, 100])
        axes.set_yticklabels([f"{t:g} %" for t in (0, 0.5, 1, 2, 5, 10, 20, 50, 100)])
        axes.set_xlim(-0.6, len(bins) - 0.4)
        axes.set_xticks(range(len(bins)), [name for name, *_ in bins])
        axes.set_xlabel("what the atlas says at most falls", color=palette.MUTED)
        axes.set_ylabel("what fell", color=palette.MUTED)
        figure.text(0.03, 0.93, "Is the atlas honest?", color=palette.INK, size=18, weight="bold")
        figure.text(
            0.03,
            0.875,
            "fresh changes in the plant of the show; bars: 95 % interval, line: mean bound",
            color=palette.MUTED,
            size=11,
        )
        figure.savefig(path)
    return path


def main() -> int:
    """Draw from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("trials", type=Path, help="trials.json of a calibration")
    parser.add_argument("--out", type=Path, default=Path("docs/reliability.png"))
    args = parser.parse_args()
    trials = json.loads(args.trials.read_text(encoding="utf-8"))
    for name, bound, count, fallen in bins_of(trials):
        print(f"{name:14s} bound {bound:6.2%}  fell {fallen} of {count} ({fallen / count:.2%})")
    print(draw(trials, args.out))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
