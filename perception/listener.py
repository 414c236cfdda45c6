"""The listener process: sound in, AUDIO_CLASS and MUSIC_MATCH out, once per hop."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from downbeat.lcm_types import audio_class_t, audio_source_t, music_match_t
from downbeat.perception.features import F32
from downbeat.perception.matcher import MusicMatcher
from downbeat.perception.ring import Block, Ring
from downbeat.perception.sound_share import SoundShare
from downbeat.perception.source import Source
from downbeat.perception.tracker import Lock, Tracker, TrackState
from downbeat.runtime.bus import Bus

log = logging.getLogger("downbeat.listener")

HOP_US = 250_000
RING_S = 6.0
CLASS_WINDOW_S = 1.0
PAUSE_DBFS = -50.0
"""Below this a second of sound is a pause: too little to judge a lock by."""


class Router(Protocol):
    """Decides what a window is; learned routers implement it too."""

    name: str

    def label(self, samples: F32, rms_dbfs: float) -> int:
        """Return audio_class_t.SKIP, MUSIC or SPEECH."""
        ...


class EnergyRouter:
    """Silence is SKIP, everything else is taken for music; the matcher refuses what is not."""

    name = "energy"

    def __init__(self, silence_dbfs: float = -60.0) -> None:
        self.silence_dbfs = silence_dbfs

    def label(self, samples: F32, rms_dbfs: float) -> int:
        """Return SKIP below the silence level, else MUSIC."""
        return int(audio_class_t.MUSIC if rms_dbfs > self.silence_dbfs else audio_class_t.SKIP)


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
    ) -> None:
        """Wire the process.

        Args:
            bus: Endpoint of the process "listener".
            source: Sound on a clock.
            matcher: Loaded and ready.
            next_boundary_s: (track, position) -> track time of the next section change, or None.
            router: Music, speech or nothing; omitted: by energy.
            shares: Publish the sound as AUDIO_CHUNK, for the speech process.
        """
        self._bus = bus
        self._source = source
        self._ring = Ring(RING_S)
        self._tracker = Tracker(matcher)
        self._router = router or EnergyRouter()
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
        self._ring.append(block.samples, block.utime, block.follows)
        if self._share is not None:
            self._share.send(block, utime)

    def _follow_failure(self, utime: int) -> None:
        """Say once that the source is gone, and once that it is back."""
        failure = self._source.failure
        if bool(failure) == bool(self._failure):
            return
        self._failure = failure
        if failure:
            log.error("%s", failure)
            self._ring.mark_gap()  # what was heard before is no longer what is heard now
            self._publish_source(audio_source_t.FAILED, utime)
        else:
            log.warning("The %s is heard again.", self._source.name)
            self._publish_source(audio_source_t.STARTED, utime)

    def _analyse(self, utime: int) -> None:
        # Without sound since a gap, time goes on all the same: a lock must not outlive it.
        now = self._ring.last_utime if self._ring.seconds else self._source.heard_utime
        recent = self._ring.last(CLASS_WINDOW_S)
        rms_dbfs = level_dbfs(recent)
        label = self._router.label(recent, rms_dbfs)
        before = self._tracker.state
        # Less than a whole window, as after a gap, speaks neither for nor against a lock.
        audible = rms_dbfs > PAUSE_DBFS and self._ring.seconds >= CLASS_WINDOW_S
        after = self._tracker.update(self._ring, now, audible)
        start = now - round(len(recent) / self._ring.sample_rate_hz * 1e6)
        self._publish_class(utime, start, now, label, rms_dbfs)
        if label == audio_class_t.MUSIC or after.lock != before.lock:
            self._publish_match(utime, start, now, after)

    def _publish_source(self, state: int, utime: int) -> None:
        msg: Any = audio_source_t()
        msg.header.utime = utime
        msg.state = state
        msg.first_sample_utime = self._source.first_sample_utime
        msg.sample_rate_hz = self._source.sample_rate_hz
        msg.duration_s = self._source.duration_s
        msg.name = self._source.name
        self._bus.publish("AUDIO_SOURCE", msg)

    def _publish_class(self, utime: int, start: int, now: int, label: int, rms_dbfs: float) -> None:
        msg: Any = audio_class_t()
        msg.header.utime = utime
        msg.window_end_utime = now
        msg.window_start_utime = start
        msg.label = label
        msg.p_music = msg.p_speech = msg.v_frac = math.nan
        msg.rms_dbfs = rms_dbfs
        msg.model = self._router.name
        self._bus.publish("AUDIO_CLASS", msg)

    def _publish_match(self, utime: int, start: int, now: int, state: TrackState) -> None:
        msg: Any = music_match_t()
        msg.header.utime = utime
        msg.lock = int(state.lock)
        msg.similarity = state.similarity
        msg.rate = state.rate
        msg.tau_std_s = math.nan
        msg.next_boundary_s = math.nan
        if state.place is not None:
            msg.method = music_match_t.FINGERPRINT
            msg.accepted = state.lock == Lock.LOCKED
            msg.track = state.track
            msg.track_zero_utime = state.track_zero_utime
            msg.tau_s = state.place.at(start)
            boundary = self._next_boundary_s(state.track, state.place.at(now))
            msg.next_boundary_s = math.nan if boundary is None else boundary
        if state.result is not None:
            msg.confidence = state.result.confidence
            msg.votes = state.result.votes
            msg.runner_up = state.result.runner_up
            msg.runner_up_confidence = state.result.runner_up_confidence
        self._bus.publish("MUSIC_MATCH", msg)

    def close(self) -> None:
        """Release the source."""
        self._source.close()
