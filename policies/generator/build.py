"""Build a skill: choreography -> reference -> gains -> ONNX and manifest."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from downbeat.policies.errors import PolicyError, SkillRejected
from downbeat.policies.generator import checks, feedback, gait
from downbeat.policies.generator.choreography import Choreography, sample
from downbeat.policies.generator.dances_planted import PLANTED_DANCES
from downbeat.policies.generator.dances_stepping import STEPPING_DANCES
from downbeat.policies.generator.export import make_tables
from downbeat.policies.generator.feedback import STAND_WEIGHTS, Feedback, Weights
from downbeat.policies.generator.footsteps import StepStyle, dance_plan
from downbeat.policies.generator.gestures import GESTURES
from downbeat.policies.generator.model import TICK_S, BodyModel
from downbeat.policies.generator.package import Label, write_skill
from downbeat.policies.generator.reference import (
    Motion,
    Reference,
    build_reference,
    planted_feet,
)
from downbeat.policies.manifest import Kind, SkillManifest
from downbeat.runtime.errors import one_of

CHOREOGRAPHIES: dict[str, Choreography] = {**GESTURES, **PLANTED_DANCES, **STEPPING_DANCES}
SKILL_NAMES = (*CHOREOGRAPHIES, gait.LABEL.name)
STAND_TICKS = 2
ZMP_WINDOWS = ((0.02, 0.04), (0.015, 0.03), (0.01, 0.02))
"""Half widths [m] tried in turn: how far the weight may travel inside the feet."""
AMPLITUDES = (1.0, 0.85, 0.7)
STEP_STYLE = StepStyle()
DOUBLE_SUPPORT_S = 0.2
TEMPO_MARGIN = (100.0 / 120.0, 140.0 / 120.0)
"""Tempo range of a dance before it is certified, as a factor on its tempo."""


@dataclass(frozen=True, slots=True)
class BuiltSkill:
    """A skill before it is written.

    Attributes:
        dance: Its choreography, at the tempo it was built for.
        reference: The motion. feedback: Gains along it.
        amplitude, zmp_window: What passed the checks.
        figures: The numbers behind the checks.
    """

    dance: Choreography
    reference: Reference
    feedback: Feedback
    amplitude: float
    zmp_window: tuple[float, float]
    figures: checks.Figures

    @property
    def kind(self) -> Kind:
        """Planted or stepping."""
        return "stepping" if self.dance.steps else "planted"


def choreography(name: str, bpm: float | None = None) -> Choreography:
    """Return the choreography of a skill, at another tempo if asked.

    Raises:
        PolicyError: There is no such skill, or it has no tempo.
    """
    if name == gait.LABEL.name:
        raise PolicyError("Skill 'walk' follows a velocity, not a tempo; leave the tempo out.")
    if name not in CHOREOGRAPHIES:
        raise PolicyError(f"Skill '{name}' is unknown; skills are {one_of(SKILL_NAMES)}.")
    dance = CHOREOGRAPHIES[name]
    if bpm is None:
        return dance
    if not dance.has_beat:
        raise PolicyError(f"Skill '{name}' is a gesture without a beat; leave the tempo out.")
    if not 60.0 <= bpm <= 200.0:
        raise PolicyError(f"{bpm:g} BPM is no tempo to dance '{name}' at; 60 to 200 BPM are.")
    return replace(dance, bpm=bpm)


def duration_s(dance: Choreography) -> float:
    """Return the exact length of the loop [s]."""
    return dance.beats * 60.0 / dance.bpm


def tick_count(dance: Choreography) -> int:
    """Return the rows of the table: one per 20 ms, rounded to close the loop."""
    if dance.name == "stand":
        return STAND_TICKS
    return round(duration_s(dance) / TICK_S)


def make_motion(
    dance: Choreography, amplitude: float = 1.0, zmp_window: tuple[float, float] = ZMP_WINDOWS[0]
) -> Motion:
    """Sample a choreography: body and feet at every tick."""
    ticks = tick_count(dance)
    tick_s = duration_s(dance) / ticks
    beat = np.arange(ticks) / ticks * dance.beats
    body = sample(dance, beat, amplitude)
    if not dance.steps:
        return Motion(tick_s, body, planted_feet(ticks), zmp_window=zmp_window)
    share = min(0.5, DOUBLE_SUPPORT_S * dance.bpm / 60.0)
    style = replace(STEP_STYLE, double_support=share)
    return Motion(tick_s, body, dance_plan(dance.steps, ticks, amplitude, style))


def build(dance: Choreography, body: BodyModel | None = None) -> BuiltSkill:
    """Build a skill; if it is rejected, shrink first the weight's window, then the motion.

    Raises:
        SkillRejected: Every attempt failed; the reason of the first one, at full size.
    """
    body = body or BodyModel()
    windows = ZMP_WINDOWS[:1] if dance.steps else ZMP_WINDOWS
    reason: SkillRejected | None = None
    for amplitude in AMPLITUDES:
        for window in windows:
            try:
                return build_once(dance, amplitude, window, body)
            except SkillRejected as error:
                reason = reason or error
    raise reason or SkillRejected(f"Skill '{dance.name}' was never tried.")


def build_once(
    dance: Choreography, amplitude: float, zmp_window: tuple[float, float], body: BodyModel
) -> BuiltSkill:
    """Build a skill at one size.

    Raises:
        SkillRejected: Which limit was broken, by how much.
    """
    planted = not dance.steps
    reference = build_reference(body, make_motion(dance, amplitude, zmp_window))
    checks.check_reference(dance.name, body, reference, planted)
    weights = STAND_WEIGHTS if dance.name == "stand" else Weights()
    gains = feedback.build_feedback(body, reference, feedback.linearise(body, reference), weights)
    checks.check_gain(dance.name, gains)
    numbers = checks.figures(body, reference, gains, planted)
    return BuiltSkill(dance, reference, gains, amplitude, zmp_window, numbers)


def generate(
    name: str, bpm: float | None, out_dir: Path, body: BodyModel | None = None
) -> SkillManifest:
    """Build a skill and write `out_dir/NAME/NAME.onnx` and `manifest.toml`.

    Args:
        name: One of SKILL_NAMES.
        bpm: Tempo; None: the choreography's own.
        out_dir: Folder of skills.
        body: Model to build on; None: a fresh one.

    Raises:
        PolicyError: Unknown name or tempo.
        SkillRejected: The choreography cannot be danced; the message has the numbers.
    """
    if name == gait.LABEL.name and bpm is None:
        return write_skill(gait.LABEL, gait.build_walk(body), out_dir, gait.GRID)
    skill = build(choreography(name, bpm), body)
    tables = make_tables([skill.reference.target], [skill.feedback.obs_ref], [skill.feedback.gain])
    return write_skill(_label(skill), tables, out_dir)


def _label(skill: BuiltSkill) -> Label:
    dance = skill.dance
    label = Label(
        name=dance.name,
        title=dance.title,
        kind=skill.kind,
        duration_s=duration_s(dance),
        loop=dance.loop,
        phrases=dance.phrases,
    )
    if not dance.has_beat:
        return label
    low, high = (float(round(dance.bpm * factor)) for factor in TEMPO_MARGIN)
    return replace(label, bpm=dance.bpm, beats=dance.beats, tempo_range_bpm=(low, high))
