"""The robot's mouth: asks for the gesture, begins to speak with it, and says when it is done."""

from __future__ import annotations

from collections import deque
from typing import Any

from downbeat.lcm_types import skill_request_t, skill_status_t, speech_t
from downbeat.perception.speaker import Speaker
from downbeat.perception.tts import Spoken
from downbeat.runtime.bus import Bus

GESTURE_WAIT_US = 2_500_000
"""Footwork has to find its exit; after so long it is spoken without the gesture."""
GIVE_UP_STATES = {
    skill_status_t.REFUSED,
    skill_status_t.EXPIRED,
    skill_status_t.CANCELLED,
    skill_status_t.ABORTED,
}
MAX_WAITING = 2


class Mouth:
    """Plays one utterance at a time, together with a gesture."""

    def __init__(self, bus: Bus, speaker: Speaker | None, gesture: str = "talk") -> None:
        """Be silent.

        Args:
            bus: Endpoint of the process "speech".
            speaker: Where it sounds; None: nowhere, the time passes all the same.
            gesture: Skill that accompanies it; empty: none.
        """
        self._bus = bus
        self._speaker = speaker
        self._gesture = gesture
        self._waiting: deque[Spoken] = deque(maxlen=MAX_WAITING)
        self._now: Spoken | None = None
        self._id = 0
        self._asked_utime = 0
        self._begin_utime = 0
        self._end_utime = 0
        self.is_held = False
        """Somebody said stop: speak without a gesture."""

    @property
    def is_speaking(self) -> bool:
        """Whether something sounds or is about to."""
        return self._now is not None

    def say(self, spoken: Spoken, utime: int) -> None:
        """Speak after what is being said."""
        self._waiting.append(spoken)
        self._next(utime)

    def _next(self, utime: int) -> None:
        if self._now is not None or not self._waiting:
            return
        self._now = self._waiting.popleft()
        self._id += 1
        self._asked_utime, self._begin_utime, self._end_utime = utime, 0, 0
        if not self._gesture or self.is_held:
            self._begin_utime = utime
        self._publish(speech_t.REQUESTED, utime)

    def follow(self, msg: skill_status_t) -> None:
        """Take a SKILL_STATUS: the sound begins when the gesture does."""
        own = msg.source == skill_request_t.SOURCE_SPEECH and msg.skill == self._gesture
        if self._now is None or self._begin_utime or not own or not self._asked_utime:
            return
        if msg.state in (skill_status_t.BLENDING, skill_status_t.RUNNING):
            self._begin_utime = int(msg.onset_utime or msg.planned_start_utime)
        elif msg.state in GIVE_UP_STATES:
            self._begin_utime = int(msg.header.utime)

    def update(self, utime: int) -> Spoken | None:
        """Do what is due; return what begins to sound now."""
        begun = None
        if self._speaker is not None:
            self._speaker.update(utime)
        if self._now is None:
            return None
        if not self._end_utime:
            late = utime - self._asked_utime >= GESTURE_WAIT_US
            if late or (self._begin_utime and utime >= self._begin_utime - 10_000):
                begun = self._begin(utime)
        elif utime >= self._end_utime:
            self._publish(speech_t.FINISHED, utime)
            self._now = None
            if self._speaker is not None:
                self._speaker.show("listening")
            self._next(utime)
        return begun

    def _begin(self, utime: int) -> Spoken | None:
        spoken = self._now
        if spoken is None:
            return None
        self._end_utime = utime + round(spoken.duration_s * 1e6)
        self._begin_utime = utime
        if self._speaker is not None:
            self._speaker.show("speaking")
            if len(spoken.samples):
                self._speaker.play(spoken.samples, utime)
        self._publish(speech_t.STARTED, utime)
        return spoken

    def stop(self, utime: int) -> None:
        """Be silent at once."""
        self._waiting.clear()
        if self._now is None:
            return
        if self._speaker is not None:
            self._speaker.stop()
            self._speaker.show("listening")
        self._publish(speech_t.FINISHED, utime)
        self._now = None

    def _publish(self, state: int, utime: int) -> None:
        spoken = self._now
        if spoken is None:
            return
        msg: Any = speech_t()
        msg.header.utime = utime
        msg.utterance_id = self._id
        msg.state = state
        msg.text = spoken.text
        msg.duration_s = spoken.duration_s
        msg.start_utime = self._begin_utime if state != speech_t.REQUESTED else 0
        msg.gesture = "" if self.is_held else self._gesture
        self._bus.publish("SPEECH", msg)

    def close(self) -> None:
        """Finish the file, or release the device."""
        if self._speaker is not None:
            self._speaker.close()
