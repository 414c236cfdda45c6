"""The score of section changes: cuts found, and what was told besides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

NEAR_S, CLOSE_S, ROUGH_S = 0.5, 0.1, 1.0
LEAD_S = 5.0
"""What happens in the first seconds of a mashup is not judged: nobody knows the first piece yet."""


@dataclass
class SectionScore:
    """Cuts found, and what was found besides.

    Attributes:
        cuts: In the sound.
        found: Of them, within 0.5 s.
        close, rough: Of the cuts, those found within 0.1 s, and within 1 s.
        told: Changes told.
        error_s, latency_s: Of the cuts found [s].
        seconds: Of sound.
    """

    cuts: int = 0
    found: int = 0
    close: int = 0
    rough: int = 0
    told: int = 0
    error_s: list[float] = field(default_factory=list)
    latency_s: list[float] = field(default_factory=list)
    seconds: float = 0.0

    @property
    def recall(self) -> float:
        """Share of the cuts that were found."""
        return self.found / max(self.cuts, 1)

    @property
    def precision(self) -> float:
        """Share of what was told that is a cut."""
        return self.found / max(self.told, 1)

    def add(self, told: Sequence[tuple[float, float]], cuts_s: Sequence[float]) -> None:
        """Count one mashup; `told`: (where, when it was told) [s]."""
        counted = [t for t in told if t[0] > LEAD_S]
        self.told += len(counted)
        self.cuts += len(cuts_s)
        for cut, (where, when) in _matched(counted, cuts_s, NEAR_S):
            self.found += 1
            self.close += abs(where - cut) <= CLOSE_S
            self.error_s.append(abs(where - cut))
            self.latency_s.append(when - cut)
        self.rough += len(_matched(counted, cuts_s, ROUGH_S))

    def text(self) -> str:
        """Return the score in a line."""
        return (
            f"recall {self.recall:.1%} of {self.cuts}, precision {self.precision:.1%} of "
            f"{self.told}, within 0.1 s {self.close / max(self.cuts, 1):.1%}"
        )

    def as_json(self) -> dict[str, Any]:
        """Return the score as plain values."""
        p50, p95 = np.percentile(self.latency_s or [np.nan], (50, 95))
        return {
            "cuts": self.cuts,
            "told": self.told,
            "recall": round(self.recall, 4),
            "recall_95": interval(self.found, self.cuts),
            "precision": round(self.precision, 4),
            "precision_95": interval(self.found, self.told),
            "within_0.1_s": round(self.close / max(self.cuts, 1), 4),
            "within_1_s": round(self.rough / max(self.cuts, 1), 4),
            "latency_s": {"p50": round(float(p50), 2), "p95": round(float(p95), 2)},
        }


def _matched(
    told: Sequence[tuple[float, float]], cuts_s: Sequence[float], near_s: float
) -> list[tuple[float, tuple[float, float]]]:
    """Return (cut, what was told of it): the nearest, each only once."""
    left, pairs = list(told), []
    for cut in cuts_s:
        near = [t for t in left if abs(t[0] - cut) <= near_s]
        if near:
            best = min(near, key=lambda t: abs(t[0] - cut))
            left.remove(best)
            pairs.append((cut, best))
    return pairs


def interval(count: int, total: int) -> tuple[float, float]:
    """Return the 95 % interval of a share (Wilson)."""
    if not total:
        return 0.0, 1.0
    z, share = 1.96, count / total
    middle = (share + z * z / (2 * total)) / (1.0 + z * z / total)
    half = z * np.sqrt(share * (1.0 - share) / total + (z / (2.0 * total)) ** 2)
    half /= 1.0 + z * z / total
    return round(float(max(0.0, middle - half)), 4), round(float(min(1.0, middle + half)), 4)
