"""The ways in which one skill may become another, cheapest first."""

from __future__ import annotations

from dataclasses import dataclass

from downbeat.control.transitions import Style
from downbeat.policies.manifest import SkillManifest


@dataclass(frozen=True, slots=True)
class Mode:
    """A blend.

    Attributes:
        name: As it stands in atlas, status and reports.
        blend_ticks: Its length; the onset is in its middle.
        style: As in `transitions.Hop`.
    """

    name: str
    blend_ticks: int
    style: Style


HARD = Mode("hard", 0, "full")
FADE_03 = Mode("fade_0.3", 15, "full")
FADE_06 = Mode("fade_0.6", 30, "full")
LEGS = Mode("legs_0.3", 15, "legs_hard")
MODES = (HARD, FADE_03, FADE_06, LEGS)
BY_NAME = {mode.name: mode for mode in MODES}


def modes_between(source: SkillManifest, target: SkillManifest) -> tuple[Mode, ...]:
    """Return the modes worth trying, in the order in which they are.

    Short blends react faster, but out of footwork the long one is the safer (of random changes
    1.0 % fell with 0.6 s, 3.1 % with 0.3 s, 6.4 % with the legs at once).
    """
    stepping = {"stepping", "locomotion"}
    if source.policy is None and target.policy is None and source.kind in stepping:
        return (FADE_06, LEGS) if target.kind in stepping else (FADE_06, FADE_03)
    return (FADE_03, FADE_06)
