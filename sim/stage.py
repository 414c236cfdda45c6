"""A robot on a floor that plays skills through ONNX Runtime: what certificates and surveys run on.

Lean on purpose: no bus, no planner. Blends are control's own (`mix`), observations are control's
terms with the plant's noise, the physics is that of the generator.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from downbeat.catalog.mjcf import ModelOptions, g1_mjcf
from downbeat.catalog.robot import load_g1
from downbeat.control.player import mix, smoothstep
from downbeat.control.policy import F32, JointTargets, OnnxSkill
from downbeat.control.session import open_session
from downbeat.control.transitions import Hop, Style
from downbeat.policies.manifest import SkillManifest
from downbeat.sim.noise import NO_NOISE, NoiseConfig

F64 = NDArray[np.float64]
TICK_S = 0.02
TICKS_PER_S = 50
FALLEN_BELOW_M = 0.5
HALF_BEYONDMIMIC_NOISE = NoiseConfig(0.025, 0.1, 0.005, 0.25, 0.2)
SOLE_PRESS_M = 0.0006
"""The soles start this far inside the floor, where the contact carries about the weight."""


@dataclass(frozen=True, slots=True)
class Variation:
    """What differs from the model that the skills were built on.

    Attributes:
        mass_scale: Factor on all masses and inertias.
        friction: Of soles and floor.
        timestep_s: Physics step.
        delay_ticks: Targets reach the motors this many control ticks late.
        noise: Of the sensors.
    """

    mass_scale: float = 1.0
    friction: float = 0.6
    timestep_s: float = 0.005
    delay_ticks: int = 0
    noise: NoiseConfig = field(default_factory=NoiseConfig)


NOMINAL = Variation()
HEAVY = Variation(mass_scale=1.05, friction=0.57)
LIGHT = Variation(mass_scale=0.95, friction=0.63)
LATE = Variation(delay_ticks=1)
NOISY = Variation(noise=HALF_BEYONDMIMIC_NOISE)
FINE = Variation(timestep_s=0.002)
QUIET = Variation(noise=NO_NOISE)


@cache
def _model(mass_scale: float, friction: float, timestep_s: float) -> mujoco.MjModel:
    options = ModelOptions(timestep_s=timestep_s, friction=friction, visual=False)
    model = mujoco.MjModel.from_xml_string(g1_mjcf(options))
    model.body_mass[:] *= mass_scale
    model.body_inertia[:] *= mass_scale
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


class StageSkill:
    """A skill on stage: control's own policy, and its reference for scoring."""

    def __init__(self, manifest: SkillManifest) -> None:
        self.manifest = manifest
        self._policy = OnnxSkill(manifest)
        self._session = open_session(manifest.onnx_path)
        self._table = None
        if manifest.kind != "locomotion":
            times = np.arange(manifest.ticks + 1) / manifest.ticks * manifest.duration_s
            zero = np.zeros(3, np.float32)
            self._table = np.stack([self._ask(time, zero) for time in times])  # (N + 1, 29)

    def act(self, obs: F32, phase_s: float, command: F32) -> JointTargets:
        """Return the policy's targets."""
        return self._policy.act(obs, phase_s, command)

    def reference(self, phase_s: float, command: F32) -> F64:
        """Return the reference joint positions (29,) [rad] at a phase."""
        if self._table is None:
            return self._ask(phase_s, command)
        tick = phase_s / self.manifest.duration_s * self.manifest.ticks % self.manifest.ticks
        row, share = int(tick), tick - int(tick)
        return (1.0 - share) * self._table[row] + share * self._table[row + 1]

    def _ask(self, phase_s: float, command: F32) -> F64:
        step = phase_s / self.manifest.duration_s * self.manifest.ticks
        feeds = {"obs": np.zeros((1, 64), np.float32), "time_step": np.float32([[step]])}
        if self.manifest.command is not None:
            feeds["command"] = command[None, :]
        return np.asarray(self._session.run(["joint_pos"], feeds)[0][0], float)


Steering = Callable[[float], F32]
"""Measured heading [rad] -> command (3,) for this tick."""


def no_command(_: float) -> F32:
    """Steer nothing."""
    return np.zeros(3, np.float32)


@dataclass(slots=True)
class Act:
    """A skill in play.

    Attributes:
        skill: What is played.
        phase_s: Where it is [s of skill time].
        rate: Skill seconds per second.
        steer: For locomotion.
        command: (3,) that was used last.
    """

    skill: StageSkill
    phase_s: float
    rate: float = 1.0
    steer: Steering = no_command
    command: F32 = field(default_factory=lambda: np.zeros(3, np.float32))

    def targets(self, obs: F32, heading: float) -> JointTargets:
        """Return the targets of this tick."""
        self.command = self.steer(heading)
        return self.skill.act(obs, self.phase_s, self.command)

    def advance(self) -> None:
        """Go on by one tick."""
        self.phase_s = (self.phase_s + self.rate * TICK_S) % self.skill.manifest.duration_s


@dataclass(slots=True)
class Trace:
    """What happened so far.

    Attributes:
        ticks: Control ticks on the feet.
        squared_error: Sum over ticks of the mean squared joint error [rad^2].
        error_ticks: Ticks in that sum.
    """

    ticks: int = 0
    squared_error: float = 0.0
    error_ticks: int = 0

    @property
    def rmse_rad(self) -> float:
        """RMS joint error [rad]; 0 before the first."""
        return float(np.sqrt(self.squared_error / max(self.error_ticks, 1)))


class Stage:
    """One robot, one trial. Starts in the stand."""

    def __init__(self, stand: StageSkill, variation: Variation = NOMINAL, seed: int = 0) -> None:
        self.variation = variation
        self.model = _model(variation.mass_scale, variation.friction, variation.timestep_s)
        self.data = mujoco.MjData(self.model)
        self.substeps = round(TICK_S / variation.timestep_s)
        self.rng = np.random.default_rng(seed)
        self.trace = Trace()
        self.is_fallen = False
        self.act = Act(stand, 0.0)
        self.push_n: F64 | None = None
        """(2,) [N] on the torso while set."""
        self.on_tick: Callable[[Stage], None] | None = None
        self._late: deque[F32] = deque()
        self._noise = _obs_noise(variation.noise)
        self._torso = self.model.body("torso_link").id
        self._feet = [self.model.body(name).id for name in load_g1().feet.body_names]
        self._place()

    def _place(self) -> None:
        """Stand in the reference pose of the stand, soles on the floor."""
        self.data.qpos[:7] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
        self.data.qpos[7:] = self.act.skill.reference(0.0, self.act.command)
        mujoco.mj_kinematics(self.model, self.data)
        sole = load_g1().feet.sole_z
        lowest = min(self.data.xpos[foot][2] + sole for foot in self._feet)
        self.data.qpos[2] = -lowest - SOLE_PRESS_M
        mujoco.mj_forward(self.model, self.data)

    def feet_pos(self) -> F64:
        """Return the feet's places, (2, 3) [m], world."""
        return self.data.xpos[self._feet].copy()

    def heading(self) -> float:
        """Return the true heading of the base [rad]."""
        w, x, y, z = self.data.qpos[3:7]
        return float(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))

    def observe(self) -> F32:
        """Return a noisy observation (64,) in the order of our skills."""
        matrix = np.zeros(9)
        mujoco.mju_quat2Mat(matrix, self.data.qpos[3:7])
        qvel = self.data.qvel
        obs = np.concatenate([-matrix[6:9], qvel[3:6], self.data.qpos[7:], qvel[6:]])
        if self._noise is not None:
            obs += self.rng.uniform(-1.0, 1.0, 64) * self._noise
        return obs.astype(np.float32)

    def run(self, ticks: int) -> bool:
        """Play the present skill; return whether the robot is on its feet."""
        for _ in range(ticks):
            if self.is_fallen:
                break
            self._apply(self.act.targets(self.observe(), self.heading()).joint_pos)
            self.act.advance()
            self._score()
        return not self.is_fallen

    def switch(
        self, act: Act, blend_ticks: int, style: Style = "full", hold_ticks: int = 0
    ) -> bool:
        """Cross-fade to another skill; return whether the robot is on its feet.

        Args:
            act: The skill to enter, at its entry phase.
            blend_ticks: Length of the fade; 0: at once.
            style: Control's; "legs_hard" switches the legs in the middle at once.
            hold_ticks: The entered skill stands at its entry phase for this long.
        """
        hop = Hop(0, act.skill.manifest.name, blend_ticks, style)
        for tick in range(blend_ticks):
            if self.is_fallen:
                return False
            obs, heading = self.observe(), self.heading()
            weight = smoothstep((tick + 1) / (blend_ticks + 1))
            old, new = self.act.targets(obs, heading), act.targets(obs, heading)
            self._apply(mix(old, new, weight, hop, tick).joint_pos)
            self.act.advance()
            if tick + 1 > hold_ticks:
                act.advance()
        self.act = act
        return not self.is_fallen

    def _apply(self, target: F32) -> None:
        self._late.append(target)
        if len(self._late) > 1 + self.variation.delay_ticks:
            self._late.popleft()
        self.data.ctrl[:] = self._late[0]
        self.data.xfrc_applied[self._torso, :2] = 0.0 if self.push_n is None else self.push_n
        mujoco.mj_step(self.model, self.data, self.substeps)
        self.trace.ticks += 1
        if self.on_tick is not None:
            self.on_tick(self)
        # `not >` also catches a NaN.
        self.is_fallen = not self.data.qpos[2] > FALLEN_BELOW_M

    def _score(self) -> None:
        reference = self.act.skill.reference(self.act.phase_s, self.act.command)
        error = self.data.qpos[7:] - reference
        self.trace.squared_error += float(np.mean(error**2))
        self.trace.error_ticks += 1


def _obs_noise(config: NoiseConfig) -> F64 | None:
    """Return the half widths (64,) of the observation's noise; None without noise."""
    if config.is_off:
        return None
    return np.concatenate(
        [
            np.full(3, config.orientation_rad),
            np.full(3, config.gyro_rad_s),
            np.full(29, config.joint_pos_rad),
            np.full(29, config.joint_vel_rad_s),
        ]
    )
