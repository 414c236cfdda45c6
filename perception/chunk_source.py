"""AUDIO_CHUNK as a source: sound that another process, or another machine, sends over LCM.

Chunks carry the number and the time of their first sample, so that nothing has to be guessed: what
is missing is a gap, what came twice is dropped. Only the clock may be another one: a sender whose
stamps cannot be true here is stamped by when its chunks arrive.
"""

from __future__ import annotations

import logging
import math

import numpy as np

from downbeat.lcm_types import audio_chunk_t
from downbeat.perception.ring import RATE_HZ, Block, Resampler
from downbeat.perception.source import MIN_SAMPLE_RATE_HZ, SourceCounters
from downbeat.runtime.bus import Bus

log = logging.getLogger("downbeat.listener")

CHANNEL = "AUDIO_CHUNK"
OUTAGE_US = 1_000_000
"""After so long without a chunk the sender counts as gone, until the next one."""
MAX_AGE_US = 2_000_000
"""A chunk that is stamped older than this when it arrives, or later than now by EARLY_US, comes
from another clock."""
EARLY_US = 50_000


class ChunkReader:
    """Puts chunks in a row; pure."""

    def __init__(self) -> None:
        self.counters = SourceCounters()
        self.heard_utime = 0
        """When the last sample had sounded [us]; 0 before the first."""
        self.offset_us: int | None = None
        """What is added to the sender's stamps; None before the first chunk."""
        self._resampler = Resampler(RATE_HZ)
        self._warned = False
        self._epoch = 0
        self._next_sample = 0

    def add(self, msg: audio_chunk_t, recv_utime: int) -> list[Block]:
        """Return the sound of a chunk that arrived at `recv_utime` [us]; may be none."""
        counters, rate = self.counters, int(msg.sample_rate_hz)
        if rate < MIN_SAMPLE_RATE_HZ or msg.num_samples == 0:
            counters.bad += 1
            counters.last_bad = 2 * int(msg.num_samples)
            return []
        blocks: list[Block] = []
        is_new = msg.header.epoch != self._epoch
        if is_new or rate != self._resampler.sample_rate_hz:
            blocks, is_new = self._restart(msg, rate), True
        first, samples = int(msg.first_sample), np.asarray(msg.samples, "<i2")
        behind = self._next_sample - first
        if not is_new and behind > 0:  # twice, or overtaken
            if behind >= len(samples):
                counters.surplus += 1
                return blocks
            samples, first = samples[behind:], self._next_sample
        skipped_us = (first - int(msg.first_sample)) * 1_000_000 // rate
        sent_utime = int(msg.first_sample_utime) + skipped_us
        end_us = len(samples) * 1_000_000 // rate
        moved = self._follow_clock(sent_utime + end_us, recv_utime)
        missing = 0 if is_new else first - self._next_sample
        counters.lost_samples += missing * RATE_HZ // rate
        counters.good += 1
        self._next_sample = first + len(samples)
        assert self.offset_us is not None
        start = sent_utime + self.offset_us
        self.heard_utime = start + end_us
        follows = missing == 0 and not is_new and not moved
        sound = samples.astype(np.float32) / np.float32(32768.0)
        return blocks + self._resampler.push(Block(sound, start, follows))

    def _restart(self, msg: audio_chunk_t, rate: int) -> list[Block]:
        """Begin a new run; what the old one has left comes first."""
        blocks = self._resampler.flush()
        self._resampler = Resampler(rate)
        self._epoch = msg.header.epoch
        self.offset_us = None
        return blocks

    def _follow_clock(self, end_utime: int, recv_utime: int) -> bool:
        """Judge the sender's clock by a chunk's last sample; returns whether the offset moved."""
        if self.offset_us is not None:
            age_us = recv_utime - (end_utime + self.offset_us)
            if -EARLY_US <= age_us <= MAX_AGE_US:
                return False
        is_true = -EARLY_US <= recv_utime - end_utime <= MAX_AGE_US
        self.offset_us = 0 if is_true else recv_utime - end_utime
        if not is_true and not self._warned:
            self._warned = True
            log.warning(
                "%s comes from a clock that is %.1f s off; it is stamped by when it arrives.",
                CHANNEL,
                self.offset_us * 1e-6,
            )
        return True


class ChunkSource:
    """A `perception.source.Source` that reads AUDIO_CHUNK."""

    sample_rate_hz = RATE_HZ
    duration_s = math.nan
    is_finished = False
    name = f"chunks on {CHANNEL}"

    def __init__(self, bus: Bus, first_sample_utime: int = 0) -> None:
        """Subscribe.

        Args:
            bus: Endpoint of the listener, which pumps it.
            first_sample_utime: What came before is not heard [us].
        """
        self._bus = bus
        self._reader = ChunkReader()
        self.first_sample_utime = first_sample_utime
        self.failure = ""
        self._heard_utime = first_sample_utime
        self._last_came: int | None = None
        bus.subscribe(CHANNEL)

    @property
    def counters(self) -> SourceCounters:
        """What came."""
        return self._reader.counters

    @property
    def heard_utime(self) -> int:
        """When the last sample that was read had sounded; during an outage: the last read [us]."""
        return self._heard_utime

    def read(self, utime: int) -> list[Block]:
        """Return what has arrived on the bus since the last read."""
        blocks: list[Block] = []
        if self._last_came is None:
            self._last_came = self._heard_utime = max(utime, self.first_sample_utime)
        for received in self._bus.take(CHANNEL):
            if received.recv_utime < self.first_sample_utime:
                continue
            blocks += self._reader.add(received.msg, received.recv_utime)
            self._last_came = utime
        if blocks:
            self.failure = ""
            self._heard_utime = self._reader.heard_utime
        elif utime - self._last_came > OUTAGE_US:
            self._heard_utime = utime
            if not self.failure:
                self.counters.outages += 1
                self.failure = (
                    f"No {CHANNEL} has come for {OUTAGE_US / 1e6:.0f} s; it is heard again as soon "
                    "as somebody publishes it (downbeat source)."
                )
        return blocks

    def close(self) -> None:
        """The bus is the listener's."""
