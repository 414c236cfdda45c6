"""What is playing and what comes next, as spans of one skill on the show's time base."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from downbeat.catalog.setlist import SetList
from downbeat.catalog.tracks import Track

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
    """Turns a track position into the current span and the next one."""

    def __init__(self, tracks: Mapping[str, Track], set_list: SetList | None = None) -> None:
        self._tracks = tracks
        self._set = set_list
        self._set_index = 0

    def spans(self, track: str, zero: int, now: int) -> tuple[Span, Span | None]:
        """Return the span at `now` and the one after it, given the lock."""
        tau_s = (now - zero) * 1e-6
        entry = self._entry_of(track, tau_s)
        if entry is None:
            return self._in_track(track, zero, now, None)
        row = self._set.entries[entry] if self._set else None
        assert row is not None
        cut_utime = zero + round((row.from_s + row.seconds) * 1e6)
        return self._in_track(track, zero, now, (entry, cut_utime))

    def after_cut(self, track: str, zero: int, now: int) -> tuple[str, int] | None:
        """Return (track, zero) that the set list says must play at `now`, if it says so."""
        entry = self._entry_of(track, self._last_tau_s(track, zero, now))
        if entry is None or self._set is None:
            return None
        at = zero + round((self._set.entries[entry].from_s) * 1e6)
        for row in self._set.entries[entry:]:
            end = at + round(row.seconds * 1e6)
            if at <= now < end:
                return row.track, at - round(row.from_s * 1e6)
            at = end
        return None

    def _last_tau_s(self, track: str, zero: int, now: int) -> float:
        """The position, clamped into the passage that the lock was in."""
        tau_s = (now - zero) * 1e-6
        if self._set is None:
            return tau_s
        row = self._set.entries[self._set_index]
        return min(tau_s, row.from_s + row.seconds) if row.track == track else tau_s

    def _entry_of(self, track: str, tau_s: float) -> int | None:
        """Return the set entry that a position belongs to; the next fitting one wins."""
        if self._set is None:
            return None
        count = len(self._set.entries)
        for step in range(count):
            index = (self._set_index + step) % count
            row = self._set.entries[index]
            low, high = row.from_s - SET_TOLERANCE_S, row.from_s + row.seconds + SET_TOLERANCE_S
            if row.track == track and low <= tau_s <= high:
                self._set_index = index
                return index
        return None

    def _in_track(
        self, name: str, zero: int, now: int, cut: tuple[int, int] | None
    ) -> tuple[Span, Span | None]:
        track = self._tracks[name]
        tau_s = (now - zero) * 1e-6
        begin_s = self._span_begin_s(track, tau_s)
        if cut is not None and self._set is not None:
            begin_s = max(begin_s, self._set.entries[cut[0]].from_s)
        here = Span(name, track.skill_at(tau_s), zero + round(begin_s * 1e6), zero)
        change = track.next_change_s(tau_s)
        change_utime = None if change is None else zero + round(change * 1e6)
        if cut is not None and (change_utime is None or change_utime >= cut[1]):
            return here, self._first_of(cut[0] + 1, cut[1])
        if change is None or change_utime is None:
            return here, None
        return here, Span(name, track.skill_at(change), change_utime, zero)

    def _first_of(self, entry: int, utime: int) -> Span | None:
        """Return the span that begins with a set entry."""
        if self._set is None or entry >= len(self._set.entries):
            return None
        row = self._set.entries[entry]
        track = self._tracks[row.track]
        zero = utime - round(row.from_s * 1e6)
        return Span(row.track, track.skill_at(row.from_s), utime, zero)

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
            elapsed_s = (utime - span.start_utime) * 1e-6
            return PhaseFit(utime, max(elapsed_s, 0.0) % skill.duration_s, 1.0)
        grid = self._tracks[span.track].grid
        tau_s = (utime - span.track_zero_utime) * 1e-6
        start_s = (span.start_utime - span.track_zero_utime) * 1e-6
        bar = grid.beats_per_bar
        origin = round(grid.beats_at(start_s) / bar) * bar
        bpm = grid.bpm_at(tau_s)
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
