"""The listener's ears for others: AUDIO_CHUNK, mono at 16 kHz."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import soxr

from downbeat.lcm_types import audio_chunk_t
from downbeat.perception.features import F32
from downbeat.runtime.bus import Bus

RATE_HZ = 16_000
MAX_SAMPLES = 8_000
"""Half a second a message: more is split, for a datagram must hold it."""


class Sounding(Protocol):
    """What the stamps come from."""

    sample_rate_hz: int
    first_sample_utime: int


class SoundShare:
    """Resamples a stream and publishes it, stamped by the time at which it sounded."""

    def __init__(self, bus: Bus, source: Sounding) -> None:
        """Begin before the first sample.

        Args:
            bus: Endpoint of the listener.
            source: Where the sound comes from.
        """
        self._bus = bus
        self._source = source
        self._stream = (
            None
            if source.sample_rate_hz == RATE_HZ
            else soxr.ResampleStream(source.sample_rate_hz, RATE_HZ, 1, dtype="float32")
        )
        self._sent = 0

    def send(self, heard: F32, utime: int, is_last: bool) -> None:
        """Publish what was heard.

        Args:
            heard: (n,) samples at the source's rate.
            utime: Now [us].
            is_last: Nothing follows.
        """
        sound = heard
        if self._stream is not None:
            sound = self._stream.resample_chunk(heard, last=is_last)
        pcm = (np.clip(sound, -1.0, 1.0) * 32767.0).astype(np.int16)
        for at in range(0, len(pcm), MAX_SAMPLES):
            self._publish(pcm[at : at + MAX_SAMPLES], utime)

    def _publish(self, pcm: Any, utime: int) -> None:
        msg: Any = audio_chunk_t()
        msg.header.utime = utime
        msg.first_sample = self._sent
        first_us = self._sent * 1_000_000 // RATE_HZ
        msg.first_sample_utime = self._source.first_sample_utime + first_us
        msg.sample_rate_hz = RATE_HZ
        msg.num_samples = len(pcm)
        msg.samples = pcm
        self._sent += len(pcm)
        self._bus.publish("AUDIO_CHUNK", msg)
