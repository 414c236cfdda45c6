"""Run one ONNX skill: observation and phase in, joint targets out.

ONNX Runtime with one thread and a fixed optimisation level: bit-identical across processes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import onnxruntime as ort

from downbeat.catalog.robot import load_g1
from downbeat.control.errors import ControlError
from downbeat.control.observation import check_terms
from downbeat.policies.manifest import SkillManifest, load_skills

F32 = npt.NDArray[np.float32]
NUM_JOINTS = 29
WARM_UP_CALLS = 10
"""The first calls of a session allocate; they must not happen inside a tick."""


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


class Skill(Protocol):
    """Anything control can play. Importers of other formats implement this."""

    manifest: SkillManifest

    def act(self, obs: F32, phase_s: float, command: F32) -> JointTargets:
        """Return the targets for one tick; `obs` holds the manifest's terms in order."""
        ...


def session(path: Path) -> ort.InferenceSession:
    """Open an ONNX file the one way that Downbeat runs policies.

    Raises:
        ControlError: The file is missing or is not a valid ONNX model.
    """
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_ENABLE_ALL
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    try:
        return ort.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime raises a dozen types of its own
        raise ControlError(f"Policy {path} cannot be loaded: {error}") from error


class OnnxSkill:
    """A skill of our own format: `obs`, `time_step` (and `command`) -> `actions`."""

    def __init__(self, manifest: SkillManifest) -> None:
        check_terms(manifest.observation_names, f"{manifest.onnx_path}:observation_names")
        self.manifest = manifest
        self._session = session(manifest.onnx_path)
        robot = load_g1()
        self._default = np.asarray(robot.default_joint_pos, np.float32)  # (29,)
        self._scale = np.asarray(robot.action_scale, np.float32)  # (29,)
        self._stiffness = np.asarray(robot.joint_stiffness, np.float32)  # (29,)
        self._damping = np.asarray(robot.joint_damping, np.float32)  # (29,)
        inputs = {node.name: node.shape for node in self._session.get_inputs()}
        self._takes_command = "command" in inputs
        self._ticks_per_s = manifest.ticks / manifest.duration_s
        self._check_interface(inputs)
        width = int(inputs["obs"][1])
        for _ in range(WARM_UP_CALLS):
            self.act(np.zeros(width, np.float32), 0.0, np.zeros(3, np.float32))

    def _check_interface(self, inputs: Mapping[str, Any]) -> None:
        outputs = {node.name for node in self._session.get_outputs()}
        missing = ({"obs", "time_step"} - set(inputs)) | ({"actions"} - outputs)
        if missing:
            raise ControlError(
                f"Policy {self.manifest.onnx_path} lacks {', '.join(sorted(missing))}; "
                f"it has inputs {', '.join(inputs)} and outputs {', '.join(sorted(outputs))}."
            )

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
        actions: F32 = self._session.run(["actions"], feeds)[0][0]  # (29,)
        target = self._default + self._scale * actions
        return JointTargets(target, self._stiffness, self._damping)


class SkillLibrary:
    """All skills that control may play, loaded and warmed before the first tick."""

    def __init__(self, skills: Mapping[str, Skill]) -> None:
        if "stand" not in skills:
            raise ControlError(
                "The skill library has no 'stand'; control needs it to start and to end skills."
            )
        self._skills = dict(skills)

    @classmethod
    def load(cls, folder: Path | None = None, only: frozenset[str] | None = None) -> SkillLibrary:
        """Load the bundled skills, or those of `folder`; `only` limits the names."""
        manifests = load_skills(folder)
        return cls({n: OnnxSkill(m) for n, m in manifests.items() if only is None or n in only})

    def __contains__(self, name: str) -> bool:
        return name in self._skills

    def __getitem__(self, name: str) -> Skill:
        return self._skills[name]

    @property
    def names(self) -> tuple[str, ...]:
        """Skill names, sorted."""
        return tuple(sorted(self._skills))
