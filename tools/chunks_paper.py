"""The paper's experiment: does a 5 s chunk of a track name the policy of its section?

Tracks carry a policy per section; a chunk is right if it is accepted and the section at its middle,
as found, has the policy of the section at its middle, as played. A chunk over a boundary is scored
apart, by the section in which it begins and by the one in which it ends. A chunk that is silent in
the clean recording has nothing to recognise: it is named, and counted as neither.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from downbeat.catalog.tracks import Track
from downbeat.perception.matcher import MatchResult
from downbeat.perception.source import Recording
from downbeat.tools.chunks_make import (
    CHUNK_S,
    MORE_SHIFTS_S,
    SHIFTS_S,
    Query,
    is_silent,
    starts,
)
from downbeat.tools.errors import ToolError

TRACKS, CHUNKS = 4, 574
"""As many as the paper has, or more."""
PAPER_ACCURACY = 0.848
SECTION_S = 20.0
POLICIES = ("sway", "kpop", "disco", "robot", "salsa")
NO_POLICY = ""

Policy = Callable[[str, float], str]
"""(track, position [s]) -> policy; none for no track or position."""


@dataclass
class PaperScore:
    """The result in one condition.

    Attributes:
        total: Chunks inside one section.
        correct: Accepted, and its policy is right.
        straddling: Chunks over a boundary.
        by_start, by_end: Of those, right by the section in which they begin, or end.
        repeats: Chunks found where the identical recording has another policy: one window alone
            cannot know which of the two plays. Not in `total`.
        wrong: Which were not.
    """

    total: int = 0
    correct: int = 0
    straddling: int = 0
    by_start: int = 0
    by_end: int = 0
    repeats: int = 0
    wrong: list[str] = field(default_factory=list)
    silent: list[str] = field(default_factory=list)

    def shares(self) -> dict[str, float | list[str]]:
        """Return counts and shares; chunks over a boundary, at a repeat or silent stand apart."""
        across = max(self.straddling, 1)
        return {
            "total": self.total,
            "correct": self.correct,
            "accuracy": round(self.correct / max(self.total, 1), 4),
            "repeats": self.repeats,
            "accuracy_with_repeats": round(self.correct / max(self.total + self.repeats, 1), 4),
            "straddling": self.straddling,
            "straddling_by_start": round(self.by_start / across, 4),
            "straddling_by_end": round(self.by_end / across, 4),
            "wrong": self.wrong,
            "silent": len(self.silent),
            "silent_chunks": self.silent,
        }

    def add(
        self,
        query: Query,
        result: MatchResult,
        policy: Policy,
        is_repeat: Callable[[Query, MatchResult], bool],
    ) -> None:
        """Count one chunk.

        Args:
            query: The chunk.
            result: What the matcher said.
            policy: (track, position) -> policy.
            is_repeat: Whether the place found holds the identical recording.
        """
        begin, end = query.start_s, query.start_s + CHUNK_S - 1e-6
        tau_s = result.tau_s if result.accepted else float("nan")
        if policy(query.track, begin) != policy(query.track, end):
            self.straddling += 1
            self.by_start += policy(result.track, tau_s) == policy(query.track, begin)
            self.by_end += policy(result.track, tau_s + CHUNK_S) == policy(query.track, end)
            return
        middle = CHUNK_S / 2
        if policy(result.track, tau_s + middle) == policy(query.track, begin + middle):
            self.total += 1
            self.correct += 1
        elif result.accepted and is_repeat(query, result):
            self.repeats += 1
        else:
            self.total += 1
            self.wrong.append(f"{query.track} at {begin:g} s: {_answer(result)}")

    def leave_out(self, query: Query) -> None:
        """Note a chunk that is silent."""
        self.silent.append(f"{query.track} at {query.start_s:g} s")


def _answer(result: MatchResult) -> str:
    """Return what the matcher said in a few words."""
    if not result.track:
        return "nothing found"
    place = f"{result.track} at {result.tau_s:.1f} s"
    return f"taken for {place}" if result.accepted else f"not accepted (best is {place})"


def policies_by_length(names: Sequence[str], section_s: float = SECTION_S) -> Policy:
    """Return policies for tracks without rules: another one in every section and track."""

    def policy(track: str, tau_s: float) -> str:
        if track not in names or tau_s != tau_s:
            return NO_POLICY
        number = int(max(tau_s, 0.0) // section_s)
        return POLICIES[(names.index(track) + number) % len(POLICIES)]

    return policy


def policies_by_rule(tracks: Mapping[str, Track]) -> Policy:
    """Return the skills that the tracks' own timed rules ask for."""

    def policy(track: str, tau_s: float) -> str:
        if track not in tracks or tau_s != tau_s:
            return NO_POLICY
        return tracks[track].skill_at(tau_s)

    return policy


def paper_shifts(recordings: Sequence[Recording]) -> Sequence[float]:
    """Return the paper's five shifts, or twenty where they give fewer chunks than it has [s]."""
    chunks = sum(sounding_chunks(recording) for recording in recordings)
    return SHIFTS_S if chunks >= CHUNKS else MORE_SHIFTS_S


def sounding_chunks(recording: Recording) -> int:
    """Return how many chunks at the paper's shifts hold sound."""
    rate = recording.sample_rate_hz
    begins = [s for shift in SHIFTS_S for s in starts(recording.duration_s, 10_000, shift)]
    chunks = (recording.samples[round(s * rate) : round((s + CHUNK_S) * rate)] for s in begins)
    return sum(not is_silent(samples) for samples in chunks)


def paper_tracks(recordings: Mapping[str, Recording]) -> list[str]:
    """Return the longest tracks, at least four, until they give the paper's number of chunks.

    Raises:
        ToolError: There are too few.
    """
    ranked = sorted(recordings, key=lambda name: -recordings[name].duration_s)
    chunks = 0
    for count, name in enumerate(ranked, 1):
        chunks += sounding_chunks(recordings[name])
        if count >= TRACKS and chunks >= CHUNKS:
            return ranked[:count]
    raise ToolError(
        f"The experiment needs {TRACKS} tracks and {CHUNKS} chunks that hold sound; these "
        f"{len(ranked)} tracks give {chunks}."
    )
