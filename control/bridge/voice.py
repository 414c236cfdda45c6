"""The robot's voice: sound out through its voice service, and its light.

A text-to-speech process plays through this on a robot, through `perception.speaker` elsewhere; both
have the same methods. Nothing here waits: `update` sends what is due.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from downbeat.control.bridge.rpc import Service
from downbeat.control.errors import ControlError

SERVICE = "voice"
START_PLAY, STOP_PLAY, GET_VOLUME, SET_VOLUME, LIGHT = 1003, 1004, 1005, 1006, 1010
SAMPLE_RATE_HZ = 16_000
CHUNK_BYTES = 96_000
"""3 s, as in the vendor's example; the next one follows after 1 s."""
CHUNK_PERIOD_US = 1_000_000
APP = "downbeat"

LIGHTS: Mapping[str, tuple[int, int, int]] = {
    "listening": (0, 0, 255),
    "speaking": (0, 255, 0),
    "dancing": (255, 0, 255),
    "stopped": (255, 0, 0),
}
"""Colours (R, G, B) by what the robot does."""


class RobotSpeaker:
    """Plays on the robot."""

    sample_rate_hz = SAMPLE_RATE_HZ

    def __init__(self, service: Service) -> None:
        """Wire it.

        Args:
            service: The voice service.
        """
        self._service = service
        self._chunks: deque[bytes] = deque()
        self._stream = 0
        self._next_utime = 0
        self._end_utime = 0
        self._light = ""
        self.errors: dict[int, int] = {}
        """Answers that were not good, by code; 3104: none came."""

    def play(self, samples: npt.NDArray[np.int16], utime: int) -> float:
        """Play a sound instead of what plays now.

        Args:
            samples: (n,) mono, 16 kHz.
            utime: Now [us].

        Returns:
            Its duration [s].

        Raises:
            ControlError: It is not mono 16-bit.
        """
        if samples.dtype != np.int16 or samples.ndim != 1:
            raise ControlError(
                f"The robot's voice cannot play {samples.dtype} of shape {samples.shape}; valid is "
                "one row of int16 at 16 kHz."
            )
        if self.is_playing(utime):
            self.stop()
        pcm = samples.astype("<i2").tobytes()
        self._chunks = deque(
            pcm[start : start + CHUNK_BYTES] for start in range(0, len(pcm), CHUNK_BYTES)
        )
        self._stream += 1
        self._next_utime = utime
        duration_s = len(samples) / SAMPLE_RATE_HZ
        self._end_utime = utime + round(duration_s * 1e6)
        self.update(utime)
        return duration_s

    def update(self, utime: int) -> None:
        """Send the chunk that is due, take answers; call it ten times a second."""
        for answer in self._service.poll():
            if answer.code != 0:
                self.errors[answer.code] = self.errors.get(answer.code, 0) + 1
        if self._chunks and utime >= self._next_utime:
            self._next_utime = utime + CHUNK_PERIOD_US
            parameter = {"app_name": APP, "stream_id": str(self._stream)}
            self._service.call(START_PLAY, parameter, self._chunks.popleft())

    def is_playing(self, utime: int) -> bool:
        """Whether something sounds."""
        return bool(self._chunks) or utime < self._end_utime

    def stop(self) -> None:
        """Be silent now."""
        self._chunks.clear()
        self._end_utime = 0
        self._service.call(STOP_PLAY, {"app_name": APP})

    def set_volume(self, volume: float) -> None:
        """Set the volume, 0..1.

        Raises:
            ControlError: It is outside.
        """
        if not 0.0 <= volume <= 1.0:
            raise ControlError(f"The volume cannot be {volume}; valid are 0 to 1.")
        self._service.call(SET_VOLUME, {"volume": round(100 * volume)})

    def show(self, what: str) -> None:
        """Show on the light what the robot does: a name in `LIGHTS`; sent once per change."""
        if what == self._light:
            return
        self._light = what
        red, green, blue = LIGHTS[what]
        self._service.call(LIGHT, {"R": red, "G": green, "B": blue})

    def close(self) -> None:
        """Nothing to release."""
