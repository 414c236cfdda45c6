"""Plays skills: one alone, or two during a cross-fade."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from downbeat.control.observation import RobotState, yaw
from downbeat.control.phase import TICK_S, TICK_US, PhaseFollower, PhaseLine, wrap
from downbeat.control.skill import F32, JointTargets, Skill, SkillMemory, SkillOutput
from downbeat.control.transitions import Hop, beat_s, half_us

LEG_JOINTS = slice(0, 12)


def smoothstep(x: float) -> float:
    """Return 3x^2 - 2x^3, the weight of a cross-fade."""
    return x * x * (3.0 - 2.0 * x)


@dataclass(slots=True)
class Velocity:
    """A locomotion command that is slewed, with the heading held while no turn is asked.

    The gait drifts in yaw; feedback on joint angles cannot see it, the IMU's heading can:
    yaw_rate = clip(gain * (target - low-passed heading)).
    """

    wanted: F32
    current: F32
    slew: F32
    low: F32
    high: F32
    heading_gain: float
    heading_filter_s: float
    heading: float | None = None
    target_heading: float | None = None

    def update(self, heading: float) -> F32:
        """Move the command one tick towards what is wanted, (3,) vx, vy [m/s], yaw rate [rad/s]."""
        if self.heading is None:
            self.heading = heading
        blend = TICK_S / self.heading_filter_s  # the torso sways with every step
        self.heading += blend * wrap(heading - self.heading, 2.0 * np.pi)
        goal = self.wanted.copy()  # (3,)
        turning = abs(float(self.wanted[2])) > 1e-6
        if turning:
            self.target_heading = None
        elif float(np.abs(self.wanted).max()) > 1e-6:
            if self.target_heading is None:
                self.target_heading = self.heading
            goal[2] = self.heading_gain * wrap(self.target_heading - self.heading, 2.0 * np.pi)
        goal = np.clip(goal, self.low, self.high)
        step = self.slew * np.float32(TICK_S)
        self.current = self.current + np.clip(goal - self.current, -step, step)
        return self.current

    @property
    def is_still(self) -> bool:
        """Whether the robot marches on the spot and wants to."""
        return bool(np.abs(self.current).max() < 0.02) and bool(np.abs(self.wanted).max() < 1e-6)


@dataclass(slots=True)
class Playback:
    """A skill in play: its phase and, for locomotion, its command."""

    skill: Skill
    follower: PhaseFollower
    request_id: int
    memory: SkillMemory
    hold_until_utime: int = 0
    """Footwork stands at its phase 0 until here."""
    velocity: Velocity | None = None

    @property
    def name(self) -> str:
        """Name of the skill."""
        return self.skill.manifest.name

    def step(self, state: RobotState, heading: float) -> SkillOutput:
        """Compute this tick."""
        command = np.zeros(3, np.float32)
        if self.velocity is not None:
            command = self.velocity.update(heading)
        return self.skill.step(self.memory, state, self.follower.wrapped_s, command)

    def advance(self, utime: int) -> None:
        """Move the phase on by one tick."""
        if utime + TICK_US <= self.hold_until_utime:
            return
        self.follower.advance(utime)


@dataclass(slots=True)
class Blend:
    """A cross-fade under way."""

    outgoing: Playback
    hop: Hop
    tick: int = 0

    @property
    def weight(self) -> float:
        """Weight of the incoming skill, 0..1."""
        return smoothstep((self.tick + 1) / (self.hop.blend_ticks + 1))

    @property
    def is_over(self) -> bool:
        """Whether the incoming skill is alone."""
        return self.tick >= self.hop.blend_ticks


def mix(a: JointTargets, b: JointTargets, weight: float, hop: Hop, tick: int) -> JointTargets:
    """Cross-fade targets and gains from `a` to `b`.

    With style "legs_hard" the legs change over in the middle at once: two contact plans mixed make
    a third that nobody planned.
    """
    w = np.full(a.joint_pos.shape, weight, np.float32)  # (29,)
    if hop.style == "legs_hard":
        w[LEG_JOINTS] = 1.0 if tick >= hop.blend_ticks // 2 else 0.0
    keep = np.float32(1.0) - w
    return JointTargets(
        keep * a.joint_pos + w * b.joint_pos,
        keep * a.joint_stiffness + w * b.joint_stiffness,
        keep * a.joint_damping + w * b.joint_damping,
    )


def start_playback(
    skill: Skill, hop: Hop, line: PhaseLine, state: RobotState, utime: int, request_id: int
) -> Playback:
    """Begin to play `skill` with the blend of `hop` that starts at `utime`, from `state`."""
    manifest = skill.manifest
    entry = 0.0 if hop.entry == "zero" else line.at(utime) + hop.shift_s
    follower = PhaseFollower(
        line, utime, manifest.duration_s, beat_s(manifest), entry, loop=manifest.loop
    )
    playback = Playback(skill, follower, request_id, skill.begin(state, follower.wrapped_s))
    if hop.entry == "zero":
        playback.hold_until_utime = utime + half_us(hop.blend_ticks)
    if manifest.command is not None:
        command = manifest.command
        playback.velocity = Velocity(
            wanted=np.zeros(3, np.float32),
            current=np.zeros(3, np.float32),
            slew=np.array([command.slew_linear, command.slew_linear, command.slew_yaw], np.float32),
            low=np.array([command.vx[0], command.vy[0], command.yaw_rate[0]], np.float32),
            high=np.array([command.vx[1], command.vy[1], command.yaw_rate[1]], np.float32),
            heading_gain=command.heading_gain,
            heading_filter_s=command.heading_filter_s,
        )
    return playback


def heading_of(state: RobotState) -> float:
    """Return the IMU's heading [rad]."""
    return float(yaw(state.base_quat_wxyz))
