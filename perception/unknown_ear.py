"""Listening to music that nobody knows: its beat, where it changes, and what it resembles.

The beat is followed always, so that it is there when a lock is lost; changes and likeness matter
only while nothing is locked.
"""

from __future__ import annotations

import math
from typing import Any, Protocol

from downbeat.lcm_types import music_beat_t, music_match_t
from downbeat.perception.features import F32
from downbeat.perception.ring import Ring
from downbeat.perception.section_finder import Change

LOOK_US = 1_000_000
"""Between two looks at what the music resembles."""
LOOK_S = 5.0


class BeatLine(Protocol):
    """The beat at a moment (beat_follower.Beat)."""

    @property
    def beat_utime(self) -> int:
        """A beat near that moment [us]."""

    @property
    def period_s(self) -> float:
        """From beat to beat [s]."""

    @property
    def phase_std_s(self) -> float:
        """How sure the phase is [s]."""

    @property
    def confidence(self) -> float:
        """0..1."""

    @property
    def is_steady(self) -> bool:
        """Whether it may be danced to."""


class Follower(Protocol):
    """What follows the beat (beat_follower.BeatFollower)."""

    def hear(self, samples: F32, first_utime: int) -> None:
        """Take a block."""

    def reset(self) -> None:
        """Begin anew."""

    def beat(self, utime: int) -> BeatLine | None:
        """Return the beat line at a moment [us]; None while searching."""


class Resembling(Protocol):
    """The most similar track (likeness.Similar)."""

    track: str
    similarity: float
    margin: float
    runner_up: str


class Likeness(Protocol):
    """What finds it (likeness.Likeness)."""

    def nearest(self, samples: F32, sample_rate_hz: int) -> Resembling | None:
        """Return the most similar track, None of too little sound."""


class Finder(Protocol):
    """What finds section changes."""

    def hear(self, samples: F32, first_utime: int) -> Change | None:
        """Take a block; returns a change found in it."""

    def reset(self) -> None:
        """Begin anew."""


class UnknownEar:
    """Feeds the three and turns what they say into messages."""

    def __init__(
        self,
        follower: Follower,
        finder: Finder | None = None,
        likeness: Likeness | None = None,
    ) -> None:
        """Wire it.

        Args:
            follower: Of the beat.
            finder: Of section changes; None: none are told.
            likeness: Finds the most similar track; None: nothing is.
        """
        self._follower = follower
        self._finder = finder
        self._likeness = likeness
        self._change: Change | None = None
        self._looked_utime = 0

    def hear(self, samples: F32, first_utime: int, is_known: bool) -> None:
        """Take a block.

        Args:
            samples: (n,) at 16 kHz, right after the last block.
            first_utime: When samples[0] sounded [us].
            is_known: A track is locked.
        """
        self._follower.hear(samples, first_utime)
        if self._finder is None:
            return
        if is_known:
            self._finder.reset()
            self._change = None
        else:
            self._change = self._finder.hear(samples, first_utime) or self._change

    def reset(self) -> None:
        """After a gap: what comes may be anything."""
        self._follower.reset()
        if self._finder is not None:
            self._finder.reset()
        self._change = None

    def beat_message(self, now: int, is_music: bool) -> Any:
        """Return the MUSIC_BEAT of a moment [us]."""
        msg: Any = music_beat_t()
        msg.phase_std_s = math.nan
        beat = self._follower.beat(now) if is_music else None
        msg.state = music_beat_t.SEARCHING if is_music else music_beat_t.NONE
        if beat is not None:
            msg.confidence = beat.confidence
            msg.phase_std_s = beat.phase_std_s
            if beat.is_steady:
                msg.state = music_beat_t.FOLLOWING
                msg.beat_utime = beat.beat_utime
                msg.period_s = beat.period_s
        if self._change is not None:
            msg.section_utime = self._change.utime
            msg.section_novelty = self._change.novelty
        return msg

    def resemblance(self, ring: Ring, now: int) -> Any:
        """Return the MUSIC_MATCH of what the music is like, None while it is not time for one.

        Args:
            ring: The newest sound.
            now: Time of its last sample [us].
        """
        if self._likeness is None or now - self._looked_utime < LOOK_US:
            return None
        self._looked_utime = now
        similar = self._likeness.nearest(ring.last(LOOK_S), ring.sample_rate_hz)
        if similar is None:
            return None
        msg: Any = music_match_t()
        msg.method = music_match_t.EMBEDDING
        msg.track = similar.track
        msg.similarity = min(max(similar.similarity, -1.0), 1.0)
        msg.confidence = similar.margin
        msg.runner_up = similar.runner_up
        msg.rate = 1.0
        msg.tau_std_s = msg.next_boundary_s = math.nan
        return msg
