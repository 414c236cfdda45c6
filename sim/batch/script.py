"""Scripts: what plays in every tick of a batch of rollouts.

A change of skill is a fixed timetable: phases follow the music, not the robot, so they are known
before anything is simulated. A script is that timetable as arrays; both engines only execute it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from downbeat.control.phase import TICK_S
from downbeat.control.player import smoothstep
from downbeat.control.transitions import Style, beat_s
from downbeat.policies.manifest import SkillManifest

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Script:
    """T ticks of S skills for N rollouts (an axis of length 1 is shared by all rollouts).

    Attributes:
        skills: (S,) names.
        phase_s: (T, S, N or 1) [s] of skill time, inside the loop.
        weight: (T, S, 2) share of each skill in the targets: of the legs, of the rest; sums to 1.
        start_tick: (S,) tick at which the skill's memory is born; -1: it comes with the start.
        velocity: (S, 3) vx, vy [m/s], yaw rate [rad/s] asked of locomotion skills.
    """

    skills: tuple[str, ...]
    phase_s: F64
    weight: F32
    start_tick: tuple[int, ...]
    velocity: F32

    @property
    def ticks(self) -> int:
        """T."""
        return int(self.phase_s.shape[0])

    def playing(self, tick: int) -> list[int]:
        """Return the skills that are asked in a tick: those with weight, or about to get some."""
        return [s for s in range(len(self.skills)) if self.weight[tick, s].any()]

    def take(self, ids: NDArray[np.int64]) -> Script:
        """Return the script of some rollouts."""
        if self.phase_s.shape[2] == 1:
            return self
        phase = self.phase_s[:, :, ids]
        return Script(self.skills, phase, self.weight, self.start_tick, self.velocity)


@dataclass(frozen=True, slots=True)
class Switch:
    """One blend of a script; phases and rates per rollout, (N,) or (1,).

    Attributes:
        skill: The skill that comes in.
        tick: First tick of the blend.
        blend_ticks: Its length; the onset (weight 0.5) is in its middle. 0: a hard switch.
        style: "full" mixes all joints; "legs_hard" switches the legs in the middle at once.
        phase_s: Skill time of the incoming skill at `tick` [s].
        rate: Skill seconds per second.
        hold: It stands at its entry phase until the middle of the blend.
    """

    skill: SkillManifest
    tick: int
    blend_ticks: int
    style: Style
    phase_s: F64
    rate: F64
    hold: bool = False


def wrap_phase(manifest: SkillManifest, phase_s: F64) -> F64:
    """Return phases inside the loop, or held at both ends of a one-shot [s]."""
    if manifest.loop:
        return np.mod(phase_s, manifest.duration_s)
    return np.clip(phase_s, 0.0, manifest.duration_s)


def script_of(
    source: SkillManifest,
    phase_s: F64,
    rate: F64,
    switches: Sequence[Switch],
    ticks: int,
    velocity: Mapping[str, Sequence[float]] | None = None,
) -> Script:
    """Return the script of a skill that plays, and of what replaces it.

    Args:
        source: What plays at tick 0, with a memory that comes with the start.
        phase_s: (N,) or (1,) its skill time at tick 0 [s].
        rate: (N,) or (1,) skill seconds per second.
        switches: In order; a blend must be over before the next one begins.
        ticks: T.
        velocity: Skill name -> vx, vy [m/s], yaw rate [rad/s].
    """
    count = len(switches) + 1
    sizes = [np.size(a) for s in switches for a in (s.phase_s, s.rate)]
    width = max(np.size(phase_s), np.size(rate), *sizes)
    phases = np.zeros((ticks, count, width))
    weight = np.zeros((ticks, count, 2), np.float32)
    weight[:, 0] = 1.0
    steps = np.arange(ticks)[:, None] * TICK_S  # (T, 1)
    phases[:, 0] = wrap_phase(source, phase_s + steps * rate)
    for index, switch in enumerate(switches, 1):
        held = switch.blend_ticks // 2 if switch.hold else 0
        played = np.maximum(np.arange(ticks) - switch.tick - held, 0)[:, None] * TICK_S
        phases[:, index] = wrap_phase(switch.skill, switch.phase_s + played * switch.rate)
        for tick in range(switch.tick, ticks):
            share = blend_weights(switch.blend_ticks, switch.style, tick - switch.tick)
            weight[tick, index - 1] = 1.0 - share
            weight[tick, index] = share
    wanted = np.zeros((count, 3), np.float32)
    names = (source.name, *(s.skill.name for s in switches))
    for index, name in enumerate(names):
        wanted[index] = (velocity or {}).get(name, (0.0, 0.0, 0.0))
    starts = (-1, *(s.tick for s in switches))
    return Script(names, phases, weight, starts, wanted)


def blend_weights(blend_ticks: int, style: Style, tick: int) -> F32:
    """Return control's weight of the incoming skill in a tick of a blend, (2,) legs and rest."""
    if tick >= blend_ticks:
        return np.ones(2, np.float32)
    rest = smoothstep((tick + 1) / (blend_ticks + 1))
    legs = rest if style == "full" else float(tick >= blend_ticks // 2)
    return np.array([legs, rest], np.float32)


MUSIC_BPM = (80.0, 160.0)
"""Tempos of music, as the bundled profile draws them."""


def rate_for(manifest: SkillManifest, tempo_bpm: F64) -> F64:
    """Return the phase rates at which a skill is in time with music, 1 without beats.

    A skill that is certified for less than `MUSIC_BPM` gets its own tempos as evenly: other music
    is given to other skills, and clipping would draw the edge too often.
    """
    if beat_s(manifest) is None:
        return np.ones_like(tempo_bpm)
    low, high = manifest.tempo_range_bpm
    if high <= 0.0:
        return tempo_bpm / manifest.bpm
    slowest = max(low, MUSIC_BPM[0])
    fastest = max(slowest, min(high, MUSIC_BPM[1]))
    return np.interp(tempo_bpm, MUSIC_BPM, (slowest, fastest)) / manifest.bpm
