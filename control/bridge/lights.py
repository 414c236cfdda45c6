"""What the robot's light says, from what is on the bus."""

from __future__ import annotations

from typing import Any

from downbeat.control.bridge.core import BridgeCore
from downbeat.control.bridge.stages import Stage
from downbeat.control.bridge.voice import RobotSpeaker
from downbeat.lcm_types import control_status_t, speech_t
from downbeat.runtime.bus import Bus

PERIOD_US = 200_000
DANCING = (control_status_t.SKILL, control_status_t.TRANSITION)


class Lights:
    """Shows stopped, speaking, dancing or listening, five times a second at most."""

    def __init__(self, bus: Bus, core: BridgeCore, speaker: RobotSpeaker) -> None:
        """Wire it.

        Args:
            bus: The bridge's endpoint.
            core: Knows whether it tripped.
            speaker: Has the light.
        """
        self._bus, self._core, self._speaker = bus, core, speaker
        self._next_utime = 0
        self._speaks_until = 0
        bus.subscribe("SPEECH")
        bus.subscribe_newest("CONTROL_STATUS")

    def __call__(self, utime: int) -> None:
        """Show what is the case at `utime` [us], if it is time to look."""
        if utime < self._next_utime:
            return
        self._next_utime = utime + PERIOD_US
        for received in self._bus.take("SPEECH"):
            self._note(received.msg, utime)
        self._speaker.show(self._what(utime))
        self._speaker.update(utime)

    def _note(self, msg: Any, utime: int) -> None:
        if msg.state == speech_t.STARTED:
            self._speaks_until = utime + round(msg.duration_s * 1e6)
        elif msg.state in (speech_t.FINISHED, speech_t.FAILED):
            self._speaks_until = 0

    def _what(self, utime: int) -> str:
        if self._core.stage in (Stage.TRIPPED, Stage.LEAVING):
            return "stopped"
        if utime < self._speaks_until:
            return "speaking"
        status = self._bus.latest("CONTROL_STATUS")
        if status is not None and status.msg.mode in DANCING and utime - status.recv_utime < 1e6:
            return "dancing"
        return "listening"
