"""The walk: a family of gaits on a grid of commands that share one phase, blended by command."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from downbeat.catalog.robot import load_g1
from downbeat.policies.generator import checks
from downbeat.policies.generator.choreography import (
    LEFT_ARM,
    NUM_LEG_JOINTS,
    RIGHT_ARM,
    BodyMotion,
)
from downbeat.policies.generator.export import CommandGrid, Tables, make_tables
from downbeat.policies.generator.feedback import (
    Feedback,
    Weights,
    build_feedback,
    linearise,
    turn_wrap,
)
from downbeat.policies.generator.footsteps import StepStyle, plan_steps, walk_footfalls
from downbeat.policies.generator.model import TICK_S, BodyModel
from downbeat.policies.generator.package import Label
from downbeat.policies.generator.reference import Motion, Reference, build_reference

GRID = CommandGrid(vx=(-0.15, 0.0, 0.15, 0.3), yaw_rate=(-0.3, 0.0, 0.3))
STEP_S = 0.5
CYCLE_TICKS = round(2 * STEP_S / TICK_S)
"""A cycle is two steps: 1 s."""
PLANNED_CYCLES = 4
STEADY_CYCLE = 2
"""The cycle taken: far enough from both ends of the plan."""
HEIGHT_M = 0.745
ARM_SWING_RAD = 0.25
STYLE = StepStyle(double_support=0.4)

LABEL = Label(
    name="walk",
    title="Walk",
    kind="locomotion",
    duration_s=2 * STEP_S,
    phrases=("walk", "come here", "walk forward", "turn around"),
    command={
        # Inside the grid: at its corners 4 of 10 runs fall under half of BeyondMimic's noise.
        "vx": [-0.1, 0.25],
        "vy": [0.0, 0.0],
        "yaw_rate": [-0.3, 0.3],
        "slew_linear": 0.2,
        "slew_yaw": 0.6,
        "heading_gain": 1.0,
        "heading_filter_s": 0.5,
    },
)


@dataclass(frozen=True, slots=True)
class Gait:
    """One steady gait, one cycle long."""

    reference: Reference
    feedback: Feedback


def gait_motion(velocity: np.ndarray) -> Motion:
    """Return the motion of several cycles from a stand at (vx, vy, yaw rate), (3,)."""
    falls, _ = walk_footfalls(velocity, STEP_S, 2 * PLANNED_CYCLES)
    plan = plan_steps(falls, CYCLE_TICKS / 2, STYLE)
    ticks = len(plan.pos)
    pelvis = np.zeros((ticks, 3))
    pelvis[:, 2] = HEIGHT_M
    upper = np.tile(load_g1().default_joint_pos[NUM_LEG_JOINTS:], (ticks, 1))  # (N, 17)
    swing = ARM_SWING_RAD * np.cos(2.0 * np.pi * np.arange(ticks) / CYCLE_TICKS)
    upper[:, LEFT_ARM.start] += swing
    upper[:, RIGHT_ARM.start] -= swing
    return Motion(TICK_S, BodyMotion(pelvis, np.zeros((ticks, 3)), upper), plan, periodic=False)


def build_gait(body: BodyModel, velocity: np.ndarray, weights: Weights) -> Gait:
    """Build one gait.

    Raises:
        SkillRejected: With the limit that was broken.
    """
    name = f"walk at vx {velocity[0]:g} m/s, yaw rate {velocity[2]:g} rad/s"
    whole = build_reference(body, gait_motion(velocity))
    start = STEADY_CYCLE * CYCLE_TICKS
    reference = whole.window(start, start + CYCLE_TICKS)
    checks.check_reference(name, body, reference, planted=False)
    dynamics = turn_wrap(linearise(body, reference), float(velocity[2]) * 2.0 * STEP_S)
    feedback = build_feedback(body, reference, dynamics, weights)
    checks.check_gain(name, feedback)
    return Gait(reference, feedback)


def build_walk(body: BodyModel | None = None) -> Tables:
    """Build the whole family on GRID and return its tables.

    Raises:
        SkillRejected: One of the gaits broke a limit.
    """
    body = body or BodyModel()
    gaits = [
        build_gait(body, np.array([vx, 0.0, yaw_rate]), Weights())
        for vx in GRID.vx
        for yaw_rate in GRID.yaw_rate
    ]
    return make_tables(
        [gait.reference.target for gait in gaits],
        [gait.feedback.obs_ref for gait in gaits],
        [gait.feedback.gain for gait in gaits],
    )
