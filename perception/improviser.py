"""Music that nobody knows: which skill fits it, and how it falls on the beat that is heard.

The skill is that of the most similar track of the catalogue; at each section change that is heard,
it is the next of that track's skills. A dance that the tempo forbids gives way to another.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

from downbeat.catalog.tracks import Track
from downbeat.lcm_types import music_beat_t, music_match_t
from downbeat.perception.timeline import PhaseFit, SkillInfo, tempo_octave

MEMORY = 8
"""So many looks at what the music resembles are remembered: a rival must win all of them."""
FIRST_LOOKS = 2
BEAT_STALE_US = 3_000_000
"""A beat line older than this is no longer extrapolated."""
TEMPO_SLACK = 1.03
"""A dance may be played this much outside its certified tempos: a tracker's tempo is not exact."""
OCTAVES = (0.5, 1.0, 2.0)
LEAD_US = 250_000
"""A dance begins on the first beat after this."""


@dataclass(frozen=True, slots=True)
class Pulse:
    """A beat line.

    Attributes:
        beat_utime: A beat [us].
        period_s: From beat to beat [s].
    """

    beat_utime: int
    period_s: float

    @property
    def bpm(self) -> float:
        """Beats per minute."""
        return 60.0 / self.period_s

    def beats_at(self, utime: int) -> float:
        """Return how many beats after `beat_utime` a time is."""
        return (utime - self.beat_utime) * 1e-6 / self.period_s

    def next_beat(self, utime: int) -> int:
        """Return the first beat at or after a time [us]."""
        ahead = -int(-self.beats_at(utime) // 1)  # rounded up
        return self.beat_utime + round(ahead * self.period_s * 1e6)


class Improviser:
    """Chooses skill and phase from likeness and beat; pure logic."""

    def __init__(self, tracks: Mapping[str, Track], skills: Mapping[str, SkillInfo]) -> None:
        """Begin without music.

        Args:
            tracks: The catalogue: its tracks' skills are what may be danced.
            skills: By name.
        """
        self._tracks = tracks
        self._skills = skills
        names = [track.default_skill for track in tracks.values()]
        names += [rule.skill for track in tracks.values() for rule in track.rules]
        self._dances = [n for n in dict.fromkeys(names) if skills[n].bpm > 0.0]
        self.forget()

    def forget(self) -> None:
        """Another piece of music may play."""
        self._looks: deque[str] = deque(maxlen=MEMORY)
        self._pulse: Pulse | None = None
        self._heard_utime = 0
        self._resembled = ""
        self._section_utime = 0
        self._turn = 0

    @property
    def resembled(self) -> str:
        """The track that the music is like; empty: not known yet."""
        return self._resembled

    def resemble(self, msg: music_match_t) -> None:
        """Take a MUSIC_MATCH of the embedding: the most similar track just now."""
        if msg.track not in self._tracks:
            return
        self._looks.append(msg.track)
        if not self._resembled:
            if len(self._looks) >= FIRST_LOOKS:
                self._resembled = max(self._looks, key=lambda name: self._looks.count(name))
        elif len(self._looks) == MEMORY and set(self._looks) == {msg.track}:
            self._resembled = msg.track

    def beat(self, msg: music_beat_t) -> None:
        """Take a MUSIC_BEAT."""
        if msg.state == music_beat_t.FOLLOWING and msg.period_s > 0.0:
            self._pulse = Pulse(int(msg.beat_utime), float(msg.period_s))
            self._heard_utime = int(msg.header.utime)
        if msg.section_utime > self._section_utime:
            if self._section_utime or self._turn == 0:
                self._turn += 1
            self._section_utime = int(msg.section_utime)

    def pulse(self, now: int) -> Pulse | None:
        """Return the beat line at `now` [us]; None: there is none."""
        return self._pulse if now - self._heard_utime <= BEAT_STALE_US else None

    def skill(self, now: int) -> str:
        """Return the skill that the music asks for; empty: nothing to go by yet."""
        pulse = self.pulse(now)
        if pulse is None or not self._dances:
            return ""
        wanted = self._of_track(self._resembled)
        turned = wanted[self._turn % len(wanted) :] + wanted[: self._turn % len(wanted)]
        fitting = [name for name in turned if self._fits(name, pulse.bpm)]
        if fitting:
            return fitting[0]
        others = [name for name in self._dances if self._fits(name, pulse.bpm)]
        return min(others, key=lambda name: abs(self._rate(name, pulse.bpm) - 1.0), default="")

    def _of_track(self, name: str) -> list[str]:
        """Return the dances of a track, its default first; all dances for no track."""
        if name not in self._tracks:
            return self._dances
        track = self._tracks[name]
        own = dict.fromkeys([track.default_skill, *(rule.skill for rule in track.rules)])
        return [n for n in own if self._skills[n].bpm > 0.0] or self._dances

    def _fits(self, name: str, bpm: float) -> bool:
        low, high = self._skills[name].tempo_range_bpm
        tempo = bpm * tempo_octave(bpm, (low, high))
        return low / TEMPO_SLACK <= tempo <= high * TEMPO_SLACK

    def _rate(self, name: str, bpm: float) -> float:
        skill = self._skills[name]
        return bpm * tempo_octave(bpm, skill.tempo_range_bpm) / skill.bpm

    def begin(self, name: str, now: int) -> PhaseFit | None:
        """Return the phase line of a dance that begins on a beat soon; None: there is no beat."""
        pulse = self.pulse(now)
        if pulse is None:
            return None
        return PhaseFit(pulse.next_beat(now + LEAD_US), 0.0, self._rate(name, pulse.bpm))

    def follow(self, name: str, line: PhaseFit, now: int) -> PhaseFit | None:
        """Return the line that puts a running dance on the beat, nearest to where it is.

        Args:
            name: The dance.
            line: The line that it is danced by.
            now: [us].
        """
        pulse = self.pulse(now)
        if pulse is None:
            return None
        skill = self._skills[name]
        octave = self._octave(name, pulse.bpm, line.rate)
        beat_s = 60.0 / skill.bpm
        # The music's beats are the dance's beats, or every second one, or every half.
        step_s = beat_s * min(octave, 1.0)
        running_s = line.phase_s + line.rate * (now - line.utime) * 1e-6
        heard_s = octave * beat_s * pulse.beats_at(now)
        error_s = (heard_s - running_s + 0.5 * step_s) % step_s - 0.5 * step_s
        phase_s = (running_s + error_s) % skill.duration_s
        return PhaseFit(now, phase_s, octave * pulse.bpm / skill.bpm)

    def _octave(self, name: str, bpm: float, rate: float) -> float:
        """Return skill beats per beat heard, as near to the dance's tempo as the skill can dance.

        Where both octaves of a beat are in range, the follower may go from one to the other; a
        dance that went along would change its speed for nothing.
        """
        skill = self._skills[name]
        low, high = skill.tempo_range_bpm
        able = [o for o in OCTAVES if low / TEMPO_SLACK <= bpm * o <= high * TEMPO_SLACK]
        if not able:
            return tempo_octave(bpm, (low, high))
        return min(able, key=lambda o: abs(math.log(bpm * o / (skill.bpm * rate))))
