"""The listener process: sound in; AUDIO_CLASS, MUSIC_MATCH and MUSIC_BEAT out, once per hop."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from downbeat.lcm_types import audio_class_t, audio_source_t, music_match_t
from downbeat.perception.features import F32
from downbeat.perception.matcher import MatchResult, MusicMatcher
from downbeat.perception.ring import Block, Ring
from downbeat.perception.router import MUSIC, Router, Verdict
from downbeat.perception.router_energy import EnergyRouter
from downbeat.perception.sound_share import SoundShare
from downbeat.perception.source import Source
from downbeat.perception.tracker import Lock, Tracker, TrackState
from downbeat.perception.unknown_ear import UnknownEar
from downbeat.runtime.bus import Bus

log = logging.getLogger("downbeat.listener")

HOP_US = 250_000
RING_S = 8.5
CLASS_WINDOW_S = 1.0
PAUSE_DBFS = -60.0
"""Below this a second of sound is a pause: too little to judge a lock by."""


class MusicTracker(Protocol):
    """What follows the track: `tracker.Tracker`, or the paper's `chunk_tracker.ChunkTracker`."""

    @property
    def state(self) -> TrackState:
        """What it believes."""

    def update(self, ring: Ring, now: int, audible: bool) -> TrackState:
        """Judge the newest sound."""


def level_dbfs(samples: F32) -> float:
    """Return the RMS level [dB], full scale 0, at least -120; a constant offset is no sound."""
    power = float(np.var(samples, dtype=np.float64)) if len(samples) else 0.0
    return max(10.0 * math.log10(power + 1e-12), -120.0)


class ListenerNode:
    """Node "listener"."""

    name = "listener"
    period_us = 50_000

    def __init__(
        self,
        bus: Bus,
        source: Source,
        matcher: MusicMatcher,
        next_boundary_s: Callable[[str, float], float | None] | None = None,
        router: Router | None = None,
        shares: bool = False,
        unknown: UnknownEar | None = None,
        tracker: MusicTracker | None = None,
    ) -> None:
        """Wire the process.

        Args:
            bus: Endpoint of the process "listener".
            source: Sound on a clock.
            matcher: Loaded and ready.
            next_boundary_s: (track, position) -> track time of the next section change, or None.
            router: Music, speech or nothing; omitted: by energy.
            shares: Publish the sound as AUDIO_CHUNK, for the speech process.
            unknown: Listens to music that the catalogue lacks; omitted: nobody does.
            tracker: Follows the track; omitted: one that locks.
        """
        self._bus = bus
        self._source = source
        self._ring = Ring(RING_S)
        self._tracker: MusicTracker = tracker or Tracker(matcher)
        self._is_locking = isinstance(self._tracker, Tracker)
        self._locked_by: MatchResult | None = None
        self._router: Router = router or EnergyRouter()
        self._unknown = unknown
        self._next_boundary_s = next_boundary_s or (lambda _track, _tau: None)
        self._next_hop_utime = source.first_sample_utime + HOP_US
        self._announced = False
        self._finished = False
        self._failure = ""
        self._share = SoundShare(bus) if shares else None

    @property
    def detail(self) -> str:
        """What is wrong with the sound, for the heartbeat."""
        return f"{self._failure} {self._source.counters.text()}".strip()

    def step(self, utime: int) -> None:
        """Read what has sounded, and analyse when a hop is due."""
        self._bus.pump()
        if utime < self._source.first_sample_utime or self._finished:
            return
        if not self._announced:
            self._publish_source(audio_source_t.STARTED, utime)
            self._announced = True
        for block in self._source.read(utime):
            self._hear(block, utime)
        self._follow_failure(utime)
        if utime >= self._next_hop_utime:
            late_hops = (utime - self._next_hop_utime) // HOP_US
            self._next_hop_utime += (late_hops + 1) * HOP_US
            self._analyse(utime)
        if self._source.is_finished:
            self._finished = True
            self._publish_source(audio_source_t.FINISHED, utime)

    def _hear(self, block: Block, utime: int) -> None:
        """Take a piece of sound, 16 kHz; nothing is missing inside it."""
        gaps = self._ring.num_gaps
        self._ring.append(block.samples, block.utime, block.follows)
        if self._ring.num_gaps != gaps:
            self._forget()
        self._router.hear(block.samples, block.utime)
        if self._unknown is not None:
            is_known = self._tracker.state.lock != Lock.LOST
            self._unknown.hear(block.samples, block.utime, is_known)
        if self._share is not None:
            self._share.send(block, utime)

    def _forget(self) -> None:
        """Samples are missing: what follows may be anything."""
        self._router.reset()
        if self._unknown is not None:
            self._unknown.reset()

    def _follow_failure(self, utime: int) -> None:
        """Say once that the source is gone, and once that it is back."""
        failure = self._source.failure
        if bool(failure) == bool(self._failure):
            return
        self._failure = failure
        if failure:
            log.error("%s", failure)
            self._ring.mark_gap()  # what was heard before is no longer what is heard now
            self._forget()
            self._publish_source(audio_source_t.FAILED, utime)
        else:
            log.warning("The %s is heard again.", self._source.name)
            self._publish_source(audio_source_t.STARTED, utime)

    def _analyse(self, utime: int) -> None:
        # Without sound since a gap, time goes on all the same: a lock must not outlive it.
        now = self._ring.last_utime if self._ring.seconds else self._source.heard_utime
        recent = self._ring.last(CLASS_WINDOW_S)
        rms_dbfs = level_dbfs(recent)
        before = self._tracker.state
        # Less than a whole window, as after a gap, speaks neither for nor against a lock.
        audible = rms_dbfs > PAUSE_DBFS and self._ring.seconds >= CLASS_WINDOW_S
        if self._is_locking:
            after = self._tracker.update(self._ring, now, audible)
            verdict = self._router.judge(evidence(after))
        else:  # the paper's order: only what was routed to the music branch is looked up
            verdict = self._router.judge(0.0)
            after = self._tracker.update(self._ring, now, audible and verdict.label == MUSIC)
        start = now - round(len(recent) / self._ring.sample_rate_hz * 1e6)
        self._publish_class(utime, start, now, verdict, rms_dbfs)
        if verdict.label == MUSIC or after.lock != Lock.LOST or after.lock != before.lock:
            self._publish_match(utime, start, now, after)
        self._publish_unknown(utime, now, verdict, after)

    def _publish_unknown(self, utime: int, now: int, verdict: Verdict, state: TrackState) -> None:
        """Publish the beat, and what the music resembles where nothing is locked."""
        if self._unknown is None:
            return
        beat = self._unknown.beat_message(utime, verdict.label == MUSIC)
        beat.header.utime = utime
        self._bus.publish("MUSIC_BEAT", beat)
        missed_chunk = state.result is not None and not state.result.accepted
        wanted = state.lock == Lock.LOST and (self._is_locking or missed_chunk)
        if wanted and verdict.label == MUSIC:
            match = self._unknown.resemblance(self._ring, now)
            if match is not None:
                match.header.utime = utime
                self._bus.publish("MUSIC_MATCH", match)

    def _publish_source(self, state: int, utime: int) -> None:
        msg: Any = audio_source_t()
        msg.header.utime = utime
        msg.state = state
        msg.first_sample_utime = self._source.first_sample_utime
        msg.sample_rate_hz = self._source.sample_rate_hz
        msg.duration_s = self._source.duration_s
        msg.name = self._source.name
        self._bus.publish("AUDIO_SOURCE", msg)

    def _publish_class(
        self, utime: int, start: int, now: int, verdict: Verdict, rms_dbfs: float
    ) -> None:
        msg: Any = audio_class_t()
        msg.header.utime = utime
        msg.window_end_utime = now
        msg.window_start_utime = start
        msg.label = verdict.label
        msg.p_music, msg.p_speech = verdict.p_music, verdict.p_speech
        msg.v_frac = verdict.v_frac
        msg.rms_dbfs = rms_dbfs
        msg.model = verdict.model
        self._bus.publish("AUDIO_CLASS", msg)

    def _publish_match(self, utime: int, start: int, now: int, state: TrackState) -> None:
        msg: Any = music_match_t()
        msg.header.utime = utime
        msg.lock = int(state.lock)
        msg.similarity = state.similarity
        msg.rate = state.rate
        msg.tau_std_s = state.tau_std_s
        msg.ambiguous = state.ambiguous
        msg.next_boundary_s = math.nan
        if state.place is not None:
            msg.method = music_match_t.FINGERPRINT
            msg.accepted = state.lock == Lock.LOCKED or (
                state.result is not None and state.result.accepted
            )
            msg.track = state.track
            msg.track_zero_utime = state.track_zero_utime
            msg.tau_s = state.place.at(start if self._is_locking else state.place.utime)
            boundary = self._next_boundary_s(state.track, state.place.at(now))
            msg.next_boundary_s = math.nan if boundary is None else boundary
        result = self._said_by(state)
        if result is not None:
            msg.confidence = result.confidence
            msg.votes = result.votes
            msg.runner_up = result.runner_up
            msg.runner_up_confidence = result.runner_up_confidence
        self._bus.publish("MUSIC_MATCH", msg)

    def _said_by(self, state: TrackState) -> MatchResult | None:
        """Return the search that a state stands on: of this hop, or the one that locked."""
        if state.lock == Lock.LOST:
            self._locked_by = None
        elif state.result is not None and state.result.accepted:
            self._locked_by = state.result
        return state.result or self._locked_by

    def close(self) -> None:
        """Release the source."""
        self._source.close()


def evidence(state: TrackState) -> float:
    """Return how well a locked track still fits what sounds; 0 without a lock."""
    return state.similarity if state.lock == Lock.LOCKED else 0.0
