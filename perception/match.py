"""What a matcher is, and what it answers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32

MIN_SAMPLE_RATE_HZ = 8_000


@dataclass(frozen=True, slots=True)
class MatchResult:
    """The answer to one query.

    Attributes:
        track: Best track, empty if nothing was heard.
        tau_s: Position of the window's start in it [s].
        rate: Track seconds per real second.
        confidence: Acceptance score. Of the alignment matcher: the logarithm of the odds that it
            is right, above what a window of its length must have.
        accepted: It may be believed; of the alignment matcher, with a confidence above 0.
        doubtful: It is not enough for a lock.
        similarity: Best raw correlation, -1..1.
        runner_up: Best other track; empty if it is a decoy.
        runner_up_confidence: Its raw correlation.
        votes: Frames compared.
        repeats: Other positions in the same track that fit nearly as well [s], best first.
        twins: Other tracks that share the passage and fit nearly as well, (track, where the window
            starts there [s]): the window alone cannot tell them apart, and is not accepted.
            `confidence` then says how sure it is that it is one of them.
    """

    track: str = ""
    tau_s: float = 0.0
    rate: float = 1.0
    confidence: float = 0.0
    accepted: bool = False
    doubtful: bool = False
    similarity: float = 0.0
    runner_up: str = ""
    runner_up_confidence: float = 0.0
    votes: int = 0
    repeats: tuple[float, ...] = ()
    twins: tuple[tuple[str, float], ...] = ()


class MusicMatcher(Protocol):
    """What catalogue and listener need; constellation and embedding matchers implement it too.

    Samples are (n,) float32, mono, at any rate >= 8 kHz.
    """

    @property
    def names(self) -> list[str]:
        """Track names."""

    def add(self, name: str, samples: F32, sample_rate_hz: int) -> None:
        """Index one track; call `finish` after the last."""

    def finish(self) -> None:
        """Prepare for queries."""

    def save(self, path: Path) -> None:
        """Write the index."""

    def query(self, samples: F32, sample_rate_hz: int) -> MatchResult:
        """Match a window of 1 to 10 s."""

    def agreement(
        self, samples: F32, sample_rate_hz: int, track: str, tau_s: float
    ) -> tuple[float, float]:
        """Return (similarity, correction [s]) of a window against a known place."""


def check_rate(sample_rate_hz: int) -> None:
    """Raise PerceptionError where sound at a rate cannot be matched."""
    if sample_rate_hz < MIN_SAMPLE_RATE_HZ:
        raise PerceptionError(
            f"Sound at {sample_rate_hz} Hz cannot be matched; valid is {MIN_SAMPLE_RATE_HZ} Hz "
            "and above."
        )
