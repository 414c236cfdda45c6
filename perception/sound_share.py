"""What is heard, for others: AUDIO_CHUNK, mono at 16 kHz."""

from __future__ import annotations

from typing import Any

import numpy as np

from downbeat.lcm_types import audio_chunk_t
from downbeat.perception.ring import RATE_HZ, Block
from downbeat.runtime.bus import Bus

MAX_SAMPLES = 8_000
"""Half a second a message: more is split, for a datagram must hold it."""


class SoundShare:
    """Publishes blocks, stamped by the time at which they sounded.

    The number of a chunk's first sample counts what is missing too: a gap shows in it.
    """

    def __init__(self, bus: Bus) -> None:
        """Begin before the first sample.

        Args:
            bus: Endpoint of the listener, or of a process that only hears for others.
        """
        self._bus = bus
        self._next_sample = 0
        self._next_utime: int | None = None

    def send(self, block: Block, utime: int) -> None:
        """Publish a block.

        Args:
            block: At 16 kHz.
            utime: Now [us].
        """
        if self._next_utime is not None and not self._follows(block):
            missing = round((block.utime - self._next_utime) * RATE_HZ / 1e6)
            self._next_sample += max(missing, 1)
        pcm = (np.clip(block.samples, -1.0, 1.0) * 32767.0).astype(np.int16)
        for at in range(0, len(pcm), MAX_SAMPLES):
            first_utime = block.utime + at * 1_000_000 // RATE_HZ
            self._publish(pcm[at : at + MAX_SAMPLES], first_utime, utime)
        self._next_utime = block.utime + len(pcm) * 1_000_000 // RATE_HZ

    def _follows(self, block: Block) -> bool:
        assert self._next_utime is not None
        if block.follows is not None:
            return block.follows
        return abs(block.utime - self._next_utime) <= 0.5e6 / RATE_HZ

    def _publish(self, pcm: Any, first_utime: int, utime: int) -> None:
        msg: Any = audio_chunk_t()
        msg.header.utime = utime
        msg.first_sample = self._next_sample
        msg.first_sample_utime = first_utime
        msg.sample_rate_hz = RATE_HZ
        msg.num_samples = len(pcm)
        msg.samples = pcm
        self._next_sample += len(pcm)
        self._bus.publish("AUDIO_CHUNK", msg)
