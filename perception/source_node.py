"""The source process: only hears, for listeners elsewhere (their show says `audio = "chunks:"`)."""

from __future__ import annotations

import logging

from downbeat.perception.sound_share import SoundShare
from downbeat.perception.source import Source
from downbeat.runtime.bus import Bus

log = logging.getLogger("downbeat.source")


class SourceNode:
    """Node "source": a source in, AUDIO_CHUNK out."""

    name = "source"
    period_us = 50_000

    def __init__(self, bus: Bus, source: Source) -> None:
        """Wire the process.

        Args:
            bus: Endpoint of the process "source".
            source: Sound on a clock.
        """
        self._bus = bus
        self._source = source
        self._share = SoundShare(bus)
        self._failure = ""

    @property
    def detail(self) -> str:
        """What is wrong with the sound, for the heartbeat."""
        return f"{self._failure} {self._source.counters.text()}".strip()

    @property
    def is_finished(self) -> bool:
        """Whether everything was sent."""
        return self._source.is_finished

    def step(self, utime: int) -> None:
        """Send what has sounded."""
        self._bus.pump()
        for block in self._source.read(utime):
            self._share.send(block, utime)
        failure, self._failure = self._failure, self._source.failure
        if self._failure and not failure:
            log.error("%s", self._failure)

    def close(self) -> None:
        """Release the source."""
        self._source.close()
