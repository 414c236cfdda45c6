"""Sections: when the asked skill came, how much of it was danced, whether the robot stood."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from downbeat.tools.runlog import RunLog, TruthColumns
from downbeat.tools.truth import Section, Truth

TICK_S = 0.02
FOLLOWED_FRACTION = 0.8
GRACE_S = 3.0
"""Nobody can follow a cut that nobody could know before this."""
EARLY_S = 5.0
"""An onset this long before its boundary, or half a section, is not meant for it."""
FALLEN_HEIGHT_M = 0.5
FALLEN_TILT_RAD = 1.0
SAME_FALL_S = 1.0
DIVERGED_S = 0.5
"""Truth that ends this long before control does: the physics diverged."""


@dataclass(frozen=True)
class SectionResult:
    """One section as it went.

    Attributes:
        index: Number of the section.
        section: What was asked.
        onset_s: Onset minus boundary [s], negative: early; None: never.
        fraction: Share of the counted time in which the asked skill had the weight.
        upright: No fall in it.
    """

    index: int
    section: Section
    onset_s: float | None
    fraction: float
    upright: bool

    @property
    def followed(self) -> bool:
        """Whether it counts as followed."""
        return self.upright and self.fraction >= FOLLOWED_FRACTION


def evaluate_sections(log: RunLog, truth: Truth, zero_utime: int) -> list[SectionResult]:
    """Judge every section of the truth file.

    Args:
        log: The run.
        truth: What was asked.
        zero_utime: When the show's second 0 was [us].
    """
    ticks_s = (log.control.utime - zero_utime) * 1e-6
    executed = log.control.executed
    falls_s = [
        ((start - zero_utime) * 1e-6, (end - zero_utime) * 1e-6) for start, end in fallen_spans(log)
    ]
    results = []
    for index, section in enumerate(truth.sections):
        has_skill = executed == section.skill
        previous_s = truth.sections[index - 1].start_s if index else section.start_s - 2 * EARLY_S
        early_s = min(EARLY_S, 0.5 * (section.start_s - previous_s))
        results.append(
            SectionResult(
                index=index,
                section=section,
                onset_s=_onset_s(ticks_s, has_skill, section, early_s),
                fraction=_fraction(ticks_s, has_skill, section),
                upright=not any(a < section.end_s and b > section.start_s for a, b in falls_s),
            )
        )
    return results


def _onset_s(
    ticks_s: NDArray[np.float64], has_skill: NDArray[np.bool_], section: Section, early_s: float
) -> float | None:
    """Return onset minus boundary [s], None if the skill never came.

    The onset is the start of the run of ticks that is on at the boundary, if it began less than
    `early_s` before; else the first start after the boundary. A skill that has been on for longer
    (the same one was asked before) is on time: 0.
    """
    before = np.flatnonzero(ticks_s <= section.start_s)
    if before.size and has_skill[before[-1]]:
        off = np.flatnonzero(~has_skill[: before[-1] + 1])
        start = off[-1] + 1 if off.size else 0
        lead_s = section.start_s - float(ticks_s[start])
        return -lead_s if lead_s <= early_s else 0.0
    inside = (ticks_s > section.start_s) & (ticks_s < section.end_s) & has_skill
    if not inside.any():
        return None
    return float(ticks_s[np.argmax(inside)]) - section.start_s


def _fraction(
    ticks_s: NDArray[np.float64], has_skill: NDArray[np.bool_], section: Section
) -> float:
    """Return the share of the section's ticks that had the skill; missing ticks had not."""
    grace_s = 0.0 if section.boundary == "announced" else GRACE_S
    start_s = min(section.start_s + grace_s, section.end_s)
    inside = (ticks_s >= start_s) & (ticks_s < section.end_s)
    expected = max(round((section.end_s - start_s) / TICK_S), int(inside.sum()), 1)
    return float(np.count_nonzero(inside & has_skill) / expected)


def is_fallen(truth: TruthColumns) -> NDArray[np.bool_]:
    """Return per true state whether the robot is down, (n,); written so that NaN is down."""
    x, y = truth.qpos[:, 4], truth.qpos[:, 5]
    up = 1.0 - 2.0 * (x * x + y * y)  # cosine of the tilt
    upright = (truth.qpos[:, 2] > FALLEN_HEIGHT_M) & (up > np.cos(FALLEN_TILT_RAD))
    return ~upright


def fallen_spans(log: RunLog) -> list[tuple[int, int]]:
    """Return (start, end) [us] of every fall; two within a second are one."""
    truth = log.truth
    if truth.utime.size == 0:
        return []
    spans: list[tuple[int, int]] = []
    for utime in truth.utime[is_fallen(truth)].tolist():
        if spans and utime - spans[-1][1] < SAME_FALL_S * 1e6:
            spans[-1] = (spans[-1][0], utime)
        else:
            spans.append((utime, utime))
    last_truth, last_tick = int(truth.utime[-1]), int(log.control.utime[-1])
    silent = last_tick - last_truth > DIVERGED_S * 1e6
    if silent and not (spans and last_truth - spans[-1][1] < SAME_FALL_S * 1e6):
        spans.append((last_truth, last_tick))
    elif silent:
        spans[-1] = (spans[-1][0], last_tick)
    return spans
