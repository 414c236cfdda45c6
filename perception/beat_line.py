"""A straight line through the onsets around a beat: the clock that others dance to."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from downbeat.perception.onset_stream import F64, HOP_S, LATE_S, STEP_FRAMES

HISTORY_S = 12.0
FIT_MEMORY_S = 5.0
"""Beats count for the line for so long."""
SMOOTH_S = 0.012
MAX_PHASE_S, PHASE_STEP_S = 0.06, 0.004
PERIOD_SHARES = np.linspace(-0.015, 0.015, 13)
"""Where a better line is sought around the present one."""
PHASE_GAIN, PERIOD_GAIN, FIRST_GAIN = 0.15, 0.08, 0.5
"""Of the distance between fit and line, taken per look: fits jump, clocks do not. A new line takes
more, one over the number of looks."""
PRIOR_PHASE_S, PRIOR_PERIOD = 0.035, 0.006
PRIOR_WEIGHT = 0.25
"""Weak onsets do not move the line: a place this far off must be so many mean frames stronger."""
FIRST_STD_S = 0.014
STD_MEMORY = 0.85
LEAST_STD_S = 0.003


@dataclass(frozen=True, slots=True)
class BeatLine:
    """Beats at beat_s + k period_s.

    Attributes:
        beat_s: One of them, in seconds of the stream.
        period_s: [s].
        std_s: Uncertainty of a beat now [s].
        looks: How often it was fitted.
        number: Of beat_s among the line's beats: at half the tempo, even ones count.
    """

    beat_s: float
    period_s: float
    std_s: float = FIRST_STD_S
    looks: int = 0
    number: int = 0

    def moved_to(self, time_s: float) -> BeatLine:
        """Return the same line, named by its last beat that is not after a time [s]."""
        beats = math.floor((time_s - self.beat_s) / self.period_s)
        beat_s = self.beat_s + beats * self.period_s
        return replace(self, beat_s=beat_s, number=self.number + beats)


class LineFitter:
    """Keeps the last seconds of onsets and fits lines to them."""

    def __init__(self) -> None:
        self._curve = np.zeros(round(HISTORY_S / HOP_S))
        self._frames = 0

    def push(self, strength: F64) -> None:
        """Hear one step of an Equaliser, (STEP_FRAMES, NUM_GROUPS)."""
        self._curve = np.concatenate([self._curve[STEP_FRAMES:], strength.mean(axis=1)])
        self._frames += STEP_FRAMES

    def begin(self, line: BeatLine, now_s: float) -> BeatLine:
        """Return the line that fits best near a coarse one."""
        return replace(self._fit(line, now_s), std_s=FIRST_STD_S)

    def follow(self, line: BeatLine, now_s: float) -> BeatLine:
        """Return the line moved towards the best fit."""
        fit = self._fit(line, now_s)
        line = line.moved_to(now_s)
        error_s = fit.beat_s - line.beat_s
        error_s -= round(error_s / line.period_s) * line.period_s
        std_s = np.sqrt(STD_MEMORY * line.std_s**2 + (1.0 - STD_MEMORY) * error_s**2)
        gain = FIRST_GAIN / (1.0 + FIRST_GAIN * line.looks)
        return BeatLine(
            line.beat_s + max(gain, PHASE_GAIN) * error_s,
            line.period_s + max(gain, PERIOD_GAIN) * (fit.period_s - line.period_s),
            float(max(std_s, LEAST_STD_S)),
            line.looks + 1,
            line.number,
        )

    def _fit(self, line: BeatLine, now_s: float) -> BeatLine:
        """Search phase and period around a line for the strongest onsets."""
        curve = np.maximum(gaussian_filter1d(self._curve, SMOOTH_S / HOP_S), 0.0)
        last_s = line.moved_to(now_s - 0.02).beat_s
        heard_s = min(self._frames * HOP_S, HISTORY_S) - 0.1
        count = max(3, int(heard_s / line.period_s))
        ages = np.arange(count)
        weights = np.exp(-ages * line.period_s / FIT_MEMORY_S)
        reach = min(MAX_PHASE_S, 0.12 * line.period_s)
        shifts = np.arange(-reach, reach + 1e-9, PHASE_STEP_S)
        # The period turns about the weighted middle, so that it and the phase are independent.
        middle = float((weights * ages).sum() / weights.sum())
        spans = line.period_s * PERIOD_SHARES[:, None] * (middle - ages)  # (periods, beats)
        times = last_s - ages * line.period_s + spans
        first_s = now_s - len(curve) * HOP_S
        places = (times[:, None] + shifts[:, None] + LATE_S - first_s) / HOP_S
        values = np.interp(places, np.arange(len(curve)), curve, 0.0, 0.0)
        score = values @ weights / weights.sum()  # (periods, shifts)
        score -= PRIOR_WEIGHT * (shifts / PRIOR_PHASE_S) ** 2
        score -= PRIOR_WEIGHT * (PERIOD_SHARES[:, None] / PRIOR_PERIOD) ** 2
        row, column = np.unravel_index(int(score.argmax()), score.shape)
        period_s = line.period_s * (1.0 + _peak(score[:, column], int(row), PERIOD_SHARES))
        shift_s = _peak(score[row], int(column), shifts)
        return BeatLine(last_s + shift_s + middle * (period_s - line.period_s), period_s)


def _peak(score: F64, index: int, places: F64) -> float:
    """Return the place of a maximum, between samples by a parabola."""
    if not 0 < index < len(score) - 1:
        return float(places[index])
    left, middle, right = score[index - 1 : index + 2]
    bend = left - 2.0 * middle + right
    shift = 0.5 * (left - right) / bend if bend < 0.0 else 0.0
    return float(places[index] + shift * (places[1] - places[0]))
