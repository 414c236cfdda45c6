"""The paper's experiment: does a 5 s chunk of a track name the policy of its section?

Tracks carry a policy per section; a chunk is right if it is accepted and the section at its middle,
as found, has the policy of the section at its middle, as played. A chunk over a boundary is scored
apart, by the section in which it begins and by the one in which it ends.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from downbeat.perception.matcher import MatchResult
from downbeat.perception.source import Recording
from downbeat.tools.chunks_make import CHUNK_S, SHIFTS_S, Query, starts
from downbeat.tools.errors import ToolError

TRACKS, CHUNKS = 4, 574
"""As many as the paper has, or more."""
PAPER_ACCURACY = 0.848
SECTION_S = 20.0
POLICIES = ("sway", "kpop", "disco", "robot", "salsa")
NO_POLICY = ""


@dataclass
class PaperScore:
    """The result in one condition.

    Attributes:
        total: Chunks inside one section.
        correct: Accepted, and its policy is right.
        straddling: Chunks over a boundary.
        by_start, by_end: Of those, right by the section in which they begin, or end.
        wrong: Which were not.
    """

    total: int = 0
    correct: int = 0
    straddling: int = 0
    by_start: int = 0
    by_end: int = 0
    wrong: list[str] = field(default_factory=list)

    def shares(self) -> dict[str, float | list[str]]:
        """Return counts and shares."""
        across = max(self.straddling, 1)
        return {
            "total": self.total,
            "correct": self.correct,
            "accuracy": round(self.correct / max(self.total, 1), 4),
            "straddling": self.straddling,
            "straddling_by_start": round(self.by_start / across, 4),
            "straddling_by_end": round(self.by_end / across, 4),
            "wrong": self.wrong[:20],
        }

    def add(self, query: Query, result: MatchResult, score: Sections) -> None:
        """Count one chunk."""
        begin, end = query.start_s, query.start_s + CHUNK_S
        tau_s = result.tau_s if result.accepted else float("nan")
        if score.number(begin) != score.number(end - 1e-6):
            self.straddling += 1
            found = score.policy(result.track, tau_s), score.policy(result.track, tau_s + CHUNK_S)
            self.by_start += found[0] == score.policy(query.track, begin)
            self.by_end += found[1] == score.policy(query.track, end)
            return
        self.total += 1
        middle = CHUNK_S / 2
        if score.policy(result.track, tau_s + middle) == score.policy(query.track, begin + middle):
            self.correct += 1
        else:
            self.wrong.append(f"{query.track} at {begin:g} s: {result.track} {result.tau_s:.1f} s")


class Sections:
    """Which policy a track has at a position; neighbours differ, and so do tracks."""

    def __init__(self, names: list[str], section_s: float = SECTION_S) -> None:
        self._names, self._section_s = names, section_s

    def number(self, tau_s: float) -> int:
        """Return the number of the section at a position."""
        return int(max(tau_s, 0.0) // self._section_s)

    def policy(self, track: str, tau_s: float) -> str:
        """Return the policy there; none for no track or position."""
        if track not in self._names or tau_s != tau_s:
            return NO_POLICY
        return POLICIES[(self._names.index(track) + self.number(tau_s)) % len(POLICIES)]


def paper_tracks(recordings: Mapping[str, Recording]) -> list[str]:
    """Return the longest tracks, at least four, until they give the paper's number of chunks.

    Raises:
        ToolError: There are too few.
    """
    ranked = sorted(recordings, key=lambda name: -recordings[name].duration_s)
    chunks = 0
    for count, name in enumerate(ranked, 1):
        length_s = recordings[name].duration_s
        chunks += sum(len(starts(length_s, 10_000, shift_s)) for shift_s in SHIFTS_S)
        if count >= TRACKS and chunks >= CHUNKS:
            return ranked[:count]
    raise ToolError(
        f"The experiment needs {TRACKS} tracks and {CHUNKS} chunks; these {len(ranked)} tracks "
        f"give {chunks}."
    )
