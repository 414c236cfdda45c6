"""The paper's listening: non-overlapping chunks, each judged alone; no lock, no memory."""

from __future__ import annotations

from typing import Protocol

from downbeat.perception.features import F32
from downbeat.perception.matcher import MusicMatcher
from downbeat.perception.tracker import Lock, Place, TrackState

CHUNK_S = 5.0


class Sound(Protocol):
    """What is read of the ring."""

    sample_rate_hz: int

    @property
    def seconds(self) -> float:
        """How much there is [s]."""

    def last(self, seconds: float) -> F32:
        """Return the newest samples, (n,)."""


class ChunkTracker:
    """Has the tracker's methods."""

    def __init__(self, matcher: MusicMatcher, chunk_s: float = CHUNK_S) -> None:
        """Begin.

        Args:
            matcher: Loaded and ready.
            chunk_s: Length of a chunk [s].
        """
        self._matcher = matcher
        self._chunk_s = chunk_s
        self._due_utime: int | None = None
        self.state = TrackState()

    def update(self, ring: Sound, now: int, audible: bool) -> TrackState:
        """Judge a chunk when one is complete.

        Args:
            ring: Sound heard so far.
            now: Time of its last sample [us].
            audible: False during silence.
        """
        chunk_us = round(self._chunk_s * 1e6)
        if self._due_utime is None:
            self._due_utime = now - round(ring.seconds * 1e6) + chunk_us
        self.state = TrackState()
        if now < self._due_utime:
            return self.state
        while self._due_utime <= now:
            self._due_utime += chunk_us
        if not audible:
            return self.state
        chunk = ring.last(self._chunk_s)
        result = self._matcher.query(chunk, ring.sample_rate_hz)
        if result.accepted:
            begin = now - round(len(chunk) / ring.sample_rate_hz * 1e6)
            place = Place(result.track, result.tau_s, begin, result.rate)
            self.state = TrackState(Lock.CANDIDATE, place, result.similarity, result)
        else:
            self.state = TrackState(similarity=result.similarity, result=result)
        return self.state
