"""`downbeat listen` and `downbeat source` by themselves, for whoever wants to see what is heard."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from downbeat.lcm_types import audio_class_t, audio_source_t, music_beat_t, music_match_t
from downbeat.lcm_types.channels import CHANNELS
from downbeat.perception.errors import PerceptionError
from downbeat.perception.source_node import SourceNode
from downbeat.perception.source_spec import CHUNKS, open_source
from downbeat.runtime.bus import open_udpm
from downbeat.runtime.clock import WallClock
from downbeat.runtime.node import run_node
from downbeat.tools.processes import default_url

LABELS = {
    audio_class_t.SKIP: "nothing",
    audio_class_t.MUSIC: "music",
    audio_class_t.SPEECH: "speech",
}
BPM_STEP = 2.0
"""A tempo that moves by more is told."""
JUMP_S = 0.5
"""A place that moves by more than this against the time is told."""


class Narrator:
    """Tells what a listener publishes, a line per change; a tap of its endpoint."""

    def __init__(self, say: Callable[[str], None]) -> None:
        """Begin.

        Args:
            say: Takes a line.
        """
        self.is_finished = False
        self._say = say
        self._zero_utime = 0
        self._label: int | None = None
        self._lock = (music_match_t.LOST, "")
        self._track_zero_utime = 0
        self._alike = ""
        self._bpm = 0.0
        self._section_utime = 0

    def __call__(self, channel: str, payload: bytes) -> None:
        """Look at a message."""
        tell = {
            "AUDIO_SOURCE": self._source,
            "AUDIO_CLASS": self._class,
            "MUSIC_MATCH": self._match,
            "MUSIC_BEAT": self._beat,
        }.get(channel)
        if tell is not None:
            tell(CHANNELS[channel].type.decode(payload))

    def _line(self, utime: int, text: str) -> None:
        self._say(f"{(utime - self._zero_utime) * 1e-6:8.2f} s  {text}")

    def _source(self, msg: Any) -> None:
        self.is_finished = msg.state == audio_source_t.FINISHED
        self._zero_utime = self._zero_utime or msg.first_sample_utime
        verb = {audio_source_t.STARTED: "hears", audio_source_t.FINISHED: "has heard all of"}
        self._line(msg.header.utime, f"{verb.get(msg.state, 'no longer hears')} {msg.name}")

    def _class(self, msg: Any) -> None:
        if msg.label != self._label:
            self._label = msg.label
            self._line(msg.window_end_utime, f"{LABELS[msg.label]}, {msg.rms_dbfs:.0f} dB")

    def _match(self, msg: Any) -> None:
        if msg.method == music_match_t.EMBEDDING:
            if msg.track != self._alike:
                self._alike = msg.track
                self._line(msg.header.utime, f"unknown, most like {msg.track}")
            return
        lock = (msg.lock, msg.track)
        moved_s = abs(msg.track_zero_utime - self._track_zero_utime) * 1e-6
        if lock == self._lock and (msg.lock != music_match_t.LOCKED or moved_s < JUMP_S):
            return
        was_locked = self._lock == (music_match_t.LOCKED, msg.track)
        self._lock, self._track_zero_utime = lock, msg.track_zero_utime
        if msg.lock == music_match_t.LOCKED:
            at_s = (msg.header.utime - msg.track_zero_utime) * 1e-6 * msg.rate
            self._line(msg.header.utime, f"locked on {msg.track} at {at_s:.2f} s")
        elif msg.lock == music_match_t.CANDIDATE and msg.accepted:  # the paper's way to listen
            self._line(msg.header.utime, f"this chunk is {msg.track} from {msg.tau_s:.2f} s")
        elif msg.lock == music_match_t.CANDIDATE:
            text = "doubts" if was_locked else "may be"
            self._line(msg.header.utime, f"{text} {msg.track}")
        else:
            self._line(msg.header.utime, "no track")

    def _beat(self, msg: Any) -> None:
        bpm = 60.0 / msg.period_s if msg.state == music_beat_t.FOLLOWING else 0.0
        if abs(bpm - self._bpm) > BPM_STEP:
            self._bpm = bpm
            text = f"beat at {bpm:.1f} BPM" if bpm else "no steady beat"
            self._line(msg.header.utime, text)
        if msg.section_utime > self._section_utime:
            self._section_utime = msg.section_utime
            at_s = (msg.section_utime - self._zero_utime) * 1e-6
            self._line(msg.header.utime, f"the music changed at {at_s:.2f} s")


def run_source(audio: str, url: str) -> int:
    """Hear a source and publish it as AUDIO_CHUNK until told to stop.

    Args:
        audio: As in show.toml; files relative to the working folder.
        url: LCM URL.

    Raises:
        DownbeatError: No such source, or no multicast.
    """
    if audio == CHUNKS:
        raise PerceptionError(
            f'`downbeat source "{CHUNKS}"` would send what it receives; name a file, "mic:" or '
            '"robot:INTERFACE".'
        )
    clock = WallClock()
    bus = open_udpm(default_url(url), clock, "source")
    node = SourceNode(bus, open_source(audio, Path(), bus, clock.utime()))
    run_node(node, clock, bus, should_stop=lambda: node.is_finished)
    return 0
