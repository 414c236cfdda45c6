"""What the conductor may be told: show.toml's `[hearing]` file, table `[conductor]`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class ConductorConfig:
    """Gates, habits and modes of the conductor.

    Attributes:
        mode: "predict": asks ahead of every known boundary. "chunks": the paper's way, to compare
            with: one decision per chunk of sound, at once, without phase.
        look_ahead_s: A known boundary is asked for so long before it [s]. Footwork may need a whole
            loop of its dance to find its exit.
        min_confidence: A match counts with this confidence or more, on the matcher's own scale;
            0: the matcher's acceptance rule alone decides.
        min_votes: And with so many votes.
        cool_down_s: A skill is not started again within this time after its last start [s]: where
            two tracks blend into each other, the match wavers.
        unknown: What to do with music that the catalogue lacks: "dance" the skill of the most
            similar track on the beat that is heard, or "ignore" it.
        unknown_after_s: Music is unknown when nothing locked for so long [s].
    """

    mode: Literal["predict", "chunks"] = "predict"
    look_ahead_s: float = 10.0
    min_confidence: float = 0.0
    min_votes: int = 0
    cool_down_s: float = 2.0
    unknown: Literal["dance", "ignore"] = "dance"
    unknown_after_s: float = 5.0

    def __post_init__(self) -> None:
        for name in ("look_ahead_s", "cool_down_s", "unknown_after_s"):
            value = getattr(self, name)
            if not 0.0 <= value <= 60.0:
                raise ValueError(f"{name} = {value:g} must lie in 0..60 seconds")
        if self.min_votes < 0:
            raise ValueError(f"min_votes = {self.min_votes} must not be negative")
