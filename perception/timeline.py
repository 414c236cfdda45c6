"""What is playing and what comes next, as spans of one skill on the show's time base."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from downbeat.catalog.setlist import SetList
from downbeat.catalog.tracks import Track

SAME_ANCHOR_US = 80_000
DOUBT_US = 3_000_000
"""A lock that puts the show elsewhere must hold for this long: music repeats itself."""
AHEAD_S = 0.6
"""A phase line is drawn so far ahead; the conductor draws a new one twice a second."""
SET_TOLERANCE_S = 1.0
"""How far outside its passage a position may lie and still belong to a set entry."""


class SkillInfo(Protocol):
    """What the conductor must know of a skill (a SkillManifest has it)."""

    @property
    def bpm(self) -> float:
        """Built tempo, 0 for gestures."""

    @property
    def duration_s(self) -> float:
        """Length of the loop [s of skill time]."""

    @property
    def tempo_range_bpm(self) -> tuple[float, float]:
        """Tempos that it can be danced at."""


@dataclass(frozen=True, slots=True)
class Span:
    """A stretch of one skill.

    Attributes:
        track: Track that plays.
        skill: Skill for it.
        start_utime: When it starts (or started) [us].
        track_zero_utime: When the track was at 0 s [us].
    """

    track: str
    skill: str
    start_utime: int
    track_zero_utime: int

    def is_same(self, other: Span | None) -> bool:
        """Whether both are the same passage, up to the jitter of the lock."""
        return (
            other is not None
            and (self.track, self.skill) == (other.track, other.skill)
            and abs(self.start_utime - other.start_utime) < 250_000
        )


@dataclass(frozen=True, slots=True)
class PhaseFit:
    """A phase line: phase_s at `utime`, and its rate (skill seconds per second)."""

    utime: int
    phase_s: float
    rate: float


class Timeline:
    """Turns a track position into the current span and the next one.

    With a set list the whole show hangs on one number, the time at which it began (`anchor`): it is
    found by the first lock and then carries over cuts and lost locks.
    """

    def __init__(self, tracks: Mapping[str, Track], set_list: SetList | None = None) -> None:
        self._tracks = tracks
        self._set = set_list
        self._starts_s = [] if set_list is None else set_list.starts_s()
        self._anchor: int | None = None
        self._doubt_since_utime: int | None = None

    @property
    def has_set_list(self) -> bool:
        """Whether cuts are known ahead."""
        return self._set is not None

    def lock(self, track: str, zero: int, now: int) -> None:
        """Take a lock: place the show in time. A contradiction must last to be believed."""
        candidates = self._anchors(track, (now - zero) * 1e-6, zero)
        if not candidates:
            return
        if self._anchor is None:
            self._anchor = candidates[0]
            return
        before = self._anchor
        nearest = min(candidates, key=lambda anchor: abs(anchor - before))
        if abs(nearest - before) <= SAME_ANCHOR_US:
            self._anchor = nearest
            self._doubt_since_utime = None
        elif self._doubt_since_utime is None:
            self._doubt_since_utime = now
        elif now - self._doubt_since_utime > DOUBT_US:
            self._anchor = nearest
            self._doubt_since_utime = None

    def _anchors(self, track: str, tau_s: float, zero: int) -> list[int]:
        """Return the show beginnings under which `track` would be at `tau_s` now."""
        if self._set is None:
            return []
        return [
            zero + round((row.from_s - start_s) * 1e6)
            for row, start_s in zip(self._set.entries, self._starts_s)
            if row.track == track
            and row.from_s - SET_TOLERANCE_S <= tau_s <= row.from_s + row.seconds + SET_TOLERANCE_S
        ]

    def scheduled(self, now: int) -> tuple[str, int] | None:
        """Return (track, zero) that the set list says must play at `now`, or None."""
        entry = self._entry_at(now)
        if entry is None or self._set is None or self._anchor is None:
            return None
        row = self._set.entries[entry]
        begin = self._anchor + round(self._starts_s[entry] * 1e6)
        return row.track, begin - round(row.from_s * 1e6)

    def _entry_at(self, now: int) -> int | None:
        if self._set is None or self._anchor is None:
            return None
        show_s = (now - self._anchor) * 1e-6
        for index, row in enumerate(self._set.entries):
            if self._starts_s[index] <= show_s < self._starts_s[index] + row.seconds:
                return index
        return None

    def spans(self, name: str, zero: int, now: int) -> tuple[Span, Span | None]:
        """Return the span at `now` and the one after it, given track and position."""
        track = self._tracks[name]
        tau_s = (now - zero) * 1e-6
        entry = self._entry_at(now)
        begin_s = self._span_begin_s(track, tau_s)
        if entry is not None and self._set is not None:
            begin_s = max(begin_s, self._set.entries[entry].from_s)
        here = Span(name, track.skill_at(tau_s), zero + round(begin_s * 1e6), zero)
        change_s = track.next_change_s(tau_s)
        change = None if change_s is None else zero + round(change_s * 1e6)
        if entry is not None and self._set is not None and self._anchor is not None:
            row = self._set.entries[entry]
            cut = self._anchor + round((self._starts_s[entry] + row.seconds) * 1e6)
            if change is None or change >= cut:
                return here, self._first_of(entry + 1, cut)
        if change_s is None or change is None:
            return here, None
        return here, Span(name, track.skill_at(change_s), change, zero)

    def _first_of(self, entry: int, utime: int) -> Span | None:
        """Return the span that begins with a set entry."""
        if self._set is None or entry >= len(self._set.entries):
            return None
        row = self._set.entries[entry]
        zero = utime - round(row.from_s * 1e6)
        return Span(row.track, self._tracks[row.track].skill_at(row.from_s), utime, zero)

    @staticmethod
    def _span_begin_s(track: Track, tau_s: float) -> float:
        """Return where the span that contains `tau_s` begins."""
        begin_s = 0.0
        while (change := track.next_change_s(begin_s)) is not None and change <= tau_s:
            begin_s = change
        return begin_s

    def phase(self, span: Span, skill: SkillInfo, utime: int) -> PhaseFit:
        """Return the phase line that puts skill beats on music beats, fitted around `utime`.

        Skill beat 0 stands on the downbeat nearest to the span's start. A tempo outside the
        skill's range is halved or doubled.
        """
        if skill.bpm <= 0.0:
            return PhaseFit(utime, 0.0, 1.0)  # a gesture has no beat; it is played from its start
        grid = self._tracks[span.track].grid
        tau_s = (utime - span.track_zero_utime) * 1e-6
        start_s = (span.start_utime - span.track_zero_utime) * 1e-6
        bar = grid.beats_per_bar
        origin = round(grid.beats_at(start_s) / bar) * bar
        # The straight line over what comes until the next look: live music breathes.
        bpm = 60.0 * (grid.beats_at(tau_s + AHEAD_S) - grid.beats_at(tau_s)) / AHEAD_S
        octave = tempo_octave(grid.tempo_bpm, skill.tempo_range_bpm)
        beats = octave * (grid.beats_at(tau_s) - origin)
        phase_s = beats * 60.0 / skill.bpm
        return PhaseFit(utime, phase_s % skill.duration_s, octave * bpm / skill.bpm)


def tempo_octave(bpm: float, wanted: tuple[float, float]) -> float:
    """Return 1, 1/2 or 2: skill beats per music beat that bring the tempo into the range."""
    low, high = wanted

    def excess(octave: float) -> float:
        tempo = bpm * octave
        return max(low / tempo, tempo / high, 1.0)

    return min((1.0, 0.5, 2.0), key=excess)
