"""The paper's conductor: one decision per chunk of sound, at once, nothing known ahead.

To compare with (`mode = "chunks"`): what this gives away is what prediction is worth.
"""

from __future__ import annotations

from collections.abc import Mapping

from downbeat.catalog.tracks import Track
from downbeat.lcm_types import (
    audio_class_t,
    music_beat_t,
    music_match_t,
    skill_request_t,
    skill_status_t,
    speech_intent_t,
    speech_t,
)
from downbeat.perception.conductor import SILENCE_US, passes
from downbeat.perception.conductor_config import ConductorConfig
from downbeat.perception.music_requests import MusicRequests
from downbeat.perception.timeline import PhaseFit, SkillInfo, Span


class ChunkConductor:
    """Has the conductor's methods; hears only music. `update` returns the messages to send."""

    def __init__(
        self,
        tracks: Mapping[str, Track],
        skills: Mapping[str, SkillInfo],
        config: ConductorConfig | None = None,
    ) -> None:
        """Begin without any music.

        Args:
            tracks: With their timed rules.
            skills: By name.
            config: Gates and cool-down.
        """
        self._tracks = tracks
        self._config = config or ConductorConfig(mode="chunks")
        self._next_id = 1
        self._asks = MusicRequests(skills, self._new_id)
        self._decided = ""
        self._track = ""
        self._sounding_utime = 0

    def hear(self, match: music_match_t) -> None:
        """Take the MUSIC_MATCH of one chunk: its skill is that of the place where it began."""
        if match.track not in self._tracks:
            return
        track = self._tracks[match.track]
        if match.method == music_match_t.EMBEDDING:
            self._decided, self._track = track.default_skill, track.name
        elif match.accepted and passes(match, self._config):
            self._decided, self._track = track.skill_at(match.tau_s), track.name

    def sound(self, label: int, utime: int) -> None:
        """Take an AUDIO_CLASS."""
        if label != audio_class_t.SKIP:
            self._sounding_utime = utime

    def update(self, now: int, finished: bool = False) -> list[skill_request_t]:
        """Return the request of this decision, if any, at `now` [us]."""
        out: list[skill_request_t] = []
        silent = now - self._sounding_utime > SILENCE_US
        decided, self._decided = self._decided, ""
        if finished or (silent and self._sounding_utime > 0):
            if not self._asks.is_standing:
                self._asks.stand(out, now, "the music ended")
            return out
        current = self._asks.current
        if not decided or (current is not None and current.span.skill == decided):
            return out
        if self._asks.is_cooling(decided, now, round(self._config.cool_down_s * 1e6)):
            return out
        span = Span(self._track, decided, now, 0)
        self._asks.begin(out, span, PhaseFit(now, 0.0, 1.0), now, f"a chunk of {self._track}")
        return out

    def beat(self, msg: music_beat_t) -> None:
        """No beat is followed."""

    def listen(self, msg: speech_intent_t, now: int) -> list[skill_request_t]:
        """Nobody listens to words."""
        return []

    def speak(self, msg: speech_t, now: int) -> list[skill_request_t]:
        """Nobody speaks."""
        return []

    def follow(self, msg: skill_status_t, now: int) -> list[skill_request_t]:
        """No request of speech is followed."""
        return []

    def _new_id(self) -> int:
        self._next_id += 1
        return self._next_id - 1
