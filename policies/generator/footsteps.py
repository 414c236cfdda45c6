"""Where the feet, the zero moment point and the weight are at every tick of a stepping motion.

Poses in the plane are (x, y, yaw) arrays of shape (3,). One beat holds one step: double support
first, while the weight moves onto the stance foot, then the swing, which lands at the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from downbeat.policies.generator.choreography import Step, minimum_jerk
from downbeat.policies.generator.model import SIDES

F64 = NDArray[np.float64]
STANCE_HALF_WIDTH_M = 0.1185
"""Sideways place of a foot in the stand."""
FOOT_FRAME_HEIGHT_M = 0.0344
"""Ankle-roll frame above the floor: the sole at 35 mm, pressed in 0.6 mm to be in contact."""
SOLE_CENTRE_M = 0.035
"""Middle of the sole in front of the ankle frame."""
PLANES = (1.0, -1.0)
"""Sign of y for the left and the right foot."""


@dataclass(frozen=True, slots=True)
class StepStyle:
    """How steps are made.

    Attributes:
        double_support: Share of the beat with both feet on the floor.
        swing_height: [m].
        inward: The zero moment point goes this far inside of the stance foot's middle [m].
    """

    double_support: float = 0.4
    swing_height: float = 0.04
    inward: float = 0.03


@dataclass(frozen=True, slots=True)
class FootPlan:
    """Feet over N ticks.

    Attributes:
        pos: (N, 2, 3) [m] foot frames, left then right.
        yaw: (N, 2) [rad].
        zmp: (N, 2) [m] wanted zero moment point.
        left_weight: (N,) share of the weight on the left foot.
        path: (N, 3) middle of the feet, smoothed: where the body travels.
    """

    pos: F64
    yaw: F64
    zmp: F64
    left_weight: F64
    path: F64

    def window(self, start: int, stop: int) -> FootPlan:
        """Return ticks start to stop."""
        part = slice(start, stop)
        return FootPlan(
            self.pos[part], self.yaw[part], self.zmp[part], self.left_weight[part], self.path[part]
        )


@dataclass(frozen=True, slots=True)
class Footfall:
    """One beat: which foot swings (0 left, 1 right, None), and the plane pose where it lands."""

    side: int | None
    landing: F64 | None = None


def compose(frame: F64, inner: F64) -> F64:
    """Return pose `inner`, given in `frame`, in the frame of `frame`'s parent, (3,)."""
    cos, sin = np.cos(frame[2]), np.sin(frame[2])
    return np.array(
        [
            frame[0] + cos * inner[0] - sin * inner[1],
            frame[1] + sin * inner[0] + cos * inner[1],
            frame[2] + inner[2],
        ]
    )


def home(side: int) -> F64:
    """Return the plane pose (3,) of a foot in the stand."""
    return np.array([0.0, PLANES[side] * STANCE_HALF_WIDTH_M, 0.0])


def dance_footfalls(steps: Sequence[Step], amplitude: float) -> list[Footfall]:
    """Turn a dance's steps, relative to the stand, into footfalls."""
    falls = []
    for step in steps:
        if step.foot is None:
            falls.append(Footfall(None))
            continue
        side = SIDES.index(step.foot)
        falls.append(Footfall(side, home(side) + amplitude * np.array([step.x, step.y, step.yaw])))
    return falls


def walk_footfalls(velocity: F64, step_s: float, steps: int) -> tuple[list[Footfall], list[F64]]:
    """Return the footfalls of a steady walk, left foot first, and the body pose after each.

    Args:
        velocity: (3,) vx, vy [m/s], yaw rate [rad/s].
        step_s: Time of one step [s].
        steps: How many.
    """
    body = np.zeros(3)
    falls, bodies = [], []
    for index in range(steps):
        side = index % 2
        body = compose(body, velocity * step_s)
        falls.append(Footfall(side, compose(body, home(side))))
        bodies.append(body)
    return falls, bodies


def plan_steps(falls: Sequence[Footfall], ticks_per_step: float, style: StepStyle) -> FootPlan:
    """Sample footfalls at ticks, from a start in the stand.

    Args:
        falls: One per beat.
        ticks_per_step: Ticks per beat, not necessarily whole.
        style: How steps are made.
    """
    ticks = round(len(falls) * ticks_per_step)
    # A tick's command acts until the next tick: its middle stands for it.
    time = (np.arange(ticks) + 0.5) / ticks * len(falls)  # (N,) in steps
    index = time.astype(int)
    share = time - index
    start, end = _poses(falls)  # (S, 2, 3) each: before and after every step
    zmp_points, weights = _support(falls, start, style)  # (S + 1, 2), (S + 1,)
    moved = np.clip(share / style.double_support, 0.0, 1.0)
    moved = moved**2 * (3.0 - 2.0 * moved)  # (N,) weight shift
    swung = np.clip((share - style.double_support) / (1.0 - style.double_support), 0.0, 1.0)
    travel = minimum_jerk(swung)[:, None, None]  # (N, 1, 1)
    pose = start[index] + (end[index] - start[index]) * travel  # (N, 2, 3)
    lift = style.swing_height * 16.0 * swung**2 * (1.0 - swung) ** 2  # (N,)
    height = np.full((ticks, 2), FOOT_FRAME_HEIGHT_M)
    for step, fall in enumerate(falls):
        if fall.side is not None:
            height[index == step, fall.side] += lift[index == step]
    return FootPlan(
        pos=np.concatenate([pose[:, :, :2], height[:, :, None]], axis=2),
        yaw=pose[:, :, 2],
        zmp=_mix(zmp_points[index], zmp_points[index + 1], moved[:, None]),
        left_weight=_mix(weights[index], weights[index + 1], moved),
        path=smooth(pose.mean(axis=1), round(ticks_per_step)),
    )


def _mix(a: F64, b: F64, share: F64) -> F64:
    return a * (1.0 - share) + b * share


def _poses(falls: Sequence[Footfall]) -> tuple[F64, F64]:
    current = np.stack([home(0), home(1)])  # (2, 3)
    before, after = [], []
    for fall in falls:
        before.append(current)
        if fall.side is not None and fall.landing is not None:
            current = current.copy()
            current[fall.side] = fall.landing
        after.append(current)
    return np.stack(before), np.stack(after)


def _support(falls: Sequence[Footfall], start: F64, style: StepStyle) -> tuple[F64, F64]:
    """Return the zero moment point (S + 1, 2) and left weight (S + 1,) at the step boundaries."""
    zmp = [_midpoint(start[0])]
    weight = [0.5]
    for fall, feet in zip(falls, start):
        if fall.side is None:
            zmp.append(_midpoint(feet))
            weight.append(0.5)
            continue
        stance = 1 - fall.side
        inner = np.array([SOLE_CENTRE_M, -PLANES[stance] * style.inward, 0.0])
        zmp.append(compose(feet[stance], inner)[:2])
        weight.append(1.0 if stance == 0 else 0.0)
    return np.array(zmp), np.array(weight)


def _midpoint(feet: F64) -> F64:
    return compose(feet.mean(axis=0), np.array([SOLE_CENTRE_M, 0.0, 0.0]))[:2]


def smooth(path: F64, half_width: int) -> F64:
    """Return `path` (N, D) under a Hann window of 2 half_width + 1 ticks, ends held."""
    window = np.hanning(2 * half_width + 1)
    window /= window.sum()
    padded = np.pad(path, ((half_width, half_width), (0, 0)), mode="edge")
    columns = [np.convolve(padded[:, d], window, mode="valid") for d in range(path.shape[1])]
    return np.stack(columns, axis=1)


def dance_plan(steps: Sequence[Step], ticks: int, amplitude: float, style: StepStyle) -> FootPlan:
    """Return one steady loop (N = ticks) of a dance's footwork.

    The loop is planned three times over and the middle one taken, so that its start is the end
    of the loop before, not a stand.
    """
    falls = dance_footfalls(steps, amplitude)
    plan = plan_steps(falls * 3, ticks / len(steps), style)
    return plan.window(ticks, 2 * ticks)
