"""The conductor process: the conductor's logic on the bus, 50 times a second."""

from __future__ import annotations

from downbeat.lcm_types import audio_source_t, music_match_t
from downbeat.perception.conductor import Conductor
from downbeat.runtime.bus import Bus


class ConductorNode:
    """Node "conductor", 50 Hz."""

    name = "conductor"
    period_us = 20_000

    def __init__(self, bus: Bus, conductor: Conductor, known_tracks: frozenset[str]) -> None:
        """Wire the process.

        Args:
            bus: Endpoint of the process "conductor".
            conductor: The logic.
            known_tracks: Tracks that have rules; a lock on any other is ignored.
        """
        self._bus = bus
        self._conductor = conductor
        self._known = known_tracks
        self._finished = False
        bus.subscribe("MUSIC_MATCH", "MUSIC_BEAT", "AUDIO_CLASS", "AUDIO_SOURCE")
        bus.subscribe("SPEECH_INTENT", "SPEECH", "SKILL_STATUS")

    def step(self, utime: int) -> None:
        """Decide at `utime` [us]."""
        self._bus.pump()
        for received in self._bus.take("AUDIO_SOURCE"):
            self._finished = received.msg.state != audio_source_t.STARTED
        for received in self._bus.take("AUDIO_CLASS"):
            self._conductor.sound(received.msg.label, received.msg.header.utime)
        for received in self._bus.take("MUSIC_BEAT"):
            self._conductor.beat(received.msg)
        for received in self._bus.take("MUSIC_MATCH"):
            if received.msg.lock != music_match_t.LOCKED or received.msg.track in self._known:
                self._conductor.hear(received.msg)
        for channel, take in (
            ("SKILL_STATUS", self._conductor.follow),
            ("SPEECH", self._conductor.speak),
            ("SPEECH_INTENT", self._conductor.listen),
        ):
            for received in self._bus.take(channel):
                for request in take(received.msg, utime):
                    self._bus.publish("SKILL_REQUEST", request)
        for request in self._conductor.update(utime, self._finished):
            self._bus.publish("SKILL_REQUEST", request)

    def close(self) -> None:
        """Nothing to release."""
