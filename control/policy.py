"""Our own ONNX skills, and the library of everything control can play."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from downbeat.catalog.robot import load_g1
from downbeat.control.errors import ControlError
from downbeat.control.network import NetworkSkill
from downbeat.control.observation import RobotState, check_terms, observe
from downbeat.control.session import WARM_UP_CALLS, open_session
from downbeat.control.skill import F32, JointTargets, Skill, SkillMemory, SkillOutput
from downbeat.policies.manifest import SkillManifest, load_skills

__all__ = ["F32", "JointTargets", "OnnxSkill", "Skill", "SkillLibrary", "open_skill"]


class OnnxSkill:
    """A skill of our own format: `obs`, `time_step` (and `command`) -> `actions`."""

    def __init__(self, manifest: SkillManifest) -> None:
        check_terms(manifest.observation_names, f"{manifest.onnx_path}:observation_names")
        self.manifest = manifest
        self.session = open_session(manifest.onnx_path)
        robot = load_g1()
        self._default = np.asarray(robot.default_joint_pos, np.float32)  # (29,)
        self._scale = np.asarray(robot.action_scale, np.float32)  # (29,)
        self._stiffness = np.asarray(robot.joint_stiffness, np.float32)  # (29,)
        self._damping = np.asarray(robot.joint_damping, np.float32)  # (29,)
        inputs = {node.name: node.shape for node in self.session.get_inputs()}
        self._takes_command = "command" in inputs
        self._ticks_per_s = manifest.ticks / manifest.duration_s
        self._check_interface(inputs)
        width = int(inputs["obs"][1])
        for _ in range(WARM_UP_CALLS):
            self.act(np.zeros(width, np.float32), 0.0, np.zeros(3, np.float32))

    def _check_interface(self, inputs: Mapping[str, Any]) -> None:
        outputs = {node.name for node in self.session.get_outputs()}
        missing = ({"obs", "time_step"} - set(inputs)) | ({"actions"} - outputs)
        if missing:
            raise ControlError(
                f"Policy {self.manifest.onnx_path} lacks {', '.join(sorted(missing))}; "
                f"it has inputs {', '.join(inputs)} and outputs {', '.join(sorted(outputs))}."
            )

    def begin(self, state: RobotState, phase_s: float) -> SkillMemory:
        """Return an empty memory: our skills are functions of state and phase."""
        return SkillMemory(np.zeros(0, np.float32))

    def step(
        self, memory: SkillMemory, state: RobotState, phase_s: float, command: F32
    ) -> SkillOutput:
        """Compute one tick; see `Skill.step`."""
        obs = np.asarray(observe(state, self.manifest.observation_names), np.float32)
        targets = self.act(obs, phase_s, command)
        return SkillOutput(obs, targets.joint_pos, targets)

    def act(self, obs: F32, phase_s: float, command: F32) -> JointTargets:
        """Return the targets at skill time `phase_s`.

        Args:
            obs: (64,) the manifest's observation terms.
            phase_s: [s] of skill time, any value >= 0; the graph wraps it.
            command: (3,) vx, vy [m/s], yaw rate [rad/s]; only locomotion skills read it.
        """
        feeds: dict[str, F32] = {
            "obs": obs[None, :],
            "time_step": np.array([[phase_s * self._ticks_per_s]], np.float32),
        }
        if self._takes_command:
            feeds["command"] = command[None, :]
        actions: F32 = self.session.run(["actions"], feeds)[0][0]  # (29,)
        target = self._default + self._scale * actions
        return JointTargets(target, self._stiffness, self._damping)


def open_skill(manifest: SkillManifest) -> Skill:
    """Open a skill of our own format or an imported one.

    Raises:
        ControlError: The network does not fit its manifest.
    """
    return OnnxSkill(manifest) if manifest.policy is None else NetworkSkill(manifest)


class SkillLibrary:
    """All skills that control may play, loaded and warmed before the first tick."""

    def __init__(self, skills: Mapping[str, Skill]) -> None:
        if "stand" not in skills:
            raise ControlError(
                "The skill library has no 'stand'; control needs it to start and to end skills."
            )
        self._skills = dict(skills)

    @classmethod
    def load(
        cls,
        folder: Path | None = None,
        only: frozenset[str] | None = None,
        imported: Path | None = None,
    ) -> SkillLibrary:
        """Load skills.

        Args:
            folder: Our own; None: the bundled ones.
            only: Limits the names.
            imported: Folder of further skills, as `downbeat policy import` writes them; one that
                has the name of another skill takes its place.
        """
        manifests = dict(load_skills(folder))
        if imported is not None:
            manifests.update(load_skills(imported))
        return cls({n: open_skill(m) for n, m in manifests.items() if only is None or n in only})

    def __contains__(self, name: str) -> bool:
        return name in self._skills

    def __getitem__(self, name: str) -> Skill:
        return self._skills[name]

    @property
    def names(self) -> tuple[str, ...]:
        """Skill names, sorted."""
        return tuple(sorted(self._skills))
