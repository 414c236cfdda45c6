"""How sure it is that the beat is the beat, and that there is one at all.

The choice among tempos and phases does not know "none of them". A logistic regression does: it was
learned from looks at music, right or wrong by the offline beats, and at voices and noise, where
every beat is wrong (`downbeat.tools.train_surety`).
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources

import numpy as np
from scipy.special import logsumexp

from downbeat.perception.beat_line import LEAST_STD_S, BeatLine
from downbeat.perception.onset_stream import F64

SHARPNESS = 2.0
"""Scores are averages of looks that overlap; their soft maximum is so much sharper."""
HEIGHT_MEMORY_S = 1.5
LEAST_HEIGHT = 1.0
SHARE_FLOOR = 0.003
MAX_LOGIT, MIN_MARGIN, MAX_MARGIN, MAX_AGE = 4.0, -1.0, 4.0, 4.0
"""Beyond these, more says no more."""
EVIDENCE = 7


@dataclass(frozen=True)
class Surety:
    """Weights of the evidence.

    Attributes:
        weights: (EVIDENCE,).
        bias: What no evidence says.
    """

    weights: F64
    bias: float

    def chance(self, evidence: F64) -> float:
        """Return the chance that the beat is right, 0..1."""
        return 1.0 / (1.0 + math.exp(-float(self.weights @ evidence) - self.bias))


class Witness:
    """Collects the evidence, look by look."""

    def __init__(self, look_s: float) -> None:
        """Begin; looks come every `look_s` seconds."""
        self._gain = 1.0 - math.exp(-look_s / HEIGHT_MEMORY_S)
        self._height: float | None = None

    def look(self, scores: F64, newest: F64, mine: np.ndarray, line: BeatLine, fill: float) -> F64:
        """Return the evidence for a beat.

        Args:
            scores: (tempos, phases) averaged.
            newest: (tempos, phases) of this look.
            mine: (tempos, phases) bool, which of them mean the beat.
            line: The beat's line.
            fill: How much of the memory holds sound, 0..1.

        Returns:
            How far the beat's score stands above the middle of all, now and on average (logs); the
            log odds of its share of the soft maximum; its lead over the best other; how far the
            line is from rest (log); how long it was kept (log); fill.
        """
        height = float(newest[mine].max(initial=newest.min()) - np.median(newest))
        if self._height is None:
            self._height = height
        self._height += self._gain * (height - self._height)
        best = float(scores[mine].max(initial=scores.min()))
        sharp = SHARPNESS * scores
        share = float(np.exp(sharp[mine] - logsumexp(sharp)).sum())
        odds = math.log((share + SHARE_FLOOR) / (1.0 + SHARE_FLOOR - min(share, 1.0)))
        lead = best - float(scores[~mine].max())
        return np.array(
            [
                math.log(max(self._height, LEAST_HEIGHT)),
                math.log(max(best - float(np.median(scores)), LEAST_HEIGHT)),
                min(max(odds, -MAX_LOGIT), MAX_LOGIT),
                min(max(lead, MIN_MARGIN), MAX_MARGIN),
                math.log(line.std_s / LEAST_STD_S),
                min(math.log1p(line.looks), MAX_AGE),
                fill,
            ]
        )


@lru_cache(maxsize=1)
def bundled_surety() -> Surety:
    """Return the weights in the wheel."""
    text = (resources.files("downbeat.perception") / "data" / "beat_surety.json").read_text()
    parts = json.loads(text)
    return Surety(np.array(parts["weights"], np.float64), float(parts["bias"]))
