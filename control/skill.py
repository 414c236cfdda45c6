"""What control plays: the Skill protocol, its memory and its output."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from downbeat.control.motion import Alignment
from downbeat.control.observation import Histories, RobotState
from downbeat.policies.manifest import SkillManifest

F32 = npt.NDArray[np.float32]
NUM_JOINTS = 29


@dataclass(frozen=True, slots=True)
class JointTargets:
    """What a skill wants from the motors, Unitree motor order.

    Attributes:
        joint_pos: (29,) [rad] position target.
        joint_stiffness: (29,) [N m/rad].
        joint_damping: (29,) [N m s/rad].
    """

    joint_pos: F32
    joint_stiffness: F32
    joint_damping: F32


@dataclass(slots=True)
class SkillMemory:
    """What a skill remembers from tick to tick.

    Born at the switch, so nothing of another skill can leak in; plain arrays, so that a snapshot
    restores it exactly.

    Attributes:
        last_action: (n,) raw action of the previous tick, policy order; zeros at the start.
        histories: Per network input: one array per term, oldest frame first; empty at the start.
        recurrent: Per recurrent input: its state.
        alignment: Where the motion lies; None without a motion.
        gait_phase: Of the left foot, 0..1.
        is_still: The gait clock rests because no motion is commanded.
    """

    last_action: F32
    histories: dict[str, Histories] = field(default_factory=dict)
    recurrent: dict[str, F32] = field(default_factory=dict)
    alignment: Alignment | None = None
    gait_phase: float = 0.0
    is_still: bool = False


@dataclass(frozen=True, slots=True)
class SkillOutput:
    """What a skill computed in one tick.

    Attributes:
        obs: The observation, all inputs side by side.
        action: (n,) raw action.
        targets: For the motors.
    """

    obs: F32
    action: F32
    targets: JointTargets


class Skill(Protocol):
    """Anything control can play."""

    manifest: SkillManifest

    def begin(self, state: RobotState, phase_s: float) -> SkillMemory:
        """Return the memory with which the skill starts at `phase_s`, from where the robot is."""
        ...

    def step(
        self, memory: SkillMemory, state: RobotState, phase_s: float, command: F32
    ) -> SkillOutput:
        """Compute one tick and update `memory`.

        Args:
            memory: Of this playing of the skill.
            state: The robot, as measured and estimated.
            phase_s: [s] of skill time.
            command: (3,) vx, vy [m/s], yaw rate [rad/s]; only locomotion skills read it.
        """
        ...
