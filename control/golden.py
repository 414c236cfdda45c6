"""Golden vectors: states in, observations and actions out, recorded when a policy is imported.

They run through the same lines as the robot's tick. Who changes an observation term, a joint order
or a runtime version learns from them before a robot does.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from downbeat.catalog.robot import load_g1
from downbeat.control.errors import ControlError
from downbeat.control.observation import RobotState
from downbeat.control.skill import F32, Skill

GOLDEN_NAME = "golden.npz"
TICKS = 16
TOLERANCE = 1e-4
"""Other CPUs and runtime versions may round differently; a wrong joint order is far above this."""

Table = dict[str, npt.NDArray[np.float32]]


def states(seed: int = 0, ticks: int = TICKS) -> list[RobotState]:
    """Return plausible robot states: around the stand pose, leaning and turning a little."""
    rng = np.random.default_rng(seed)
    default = np.asarray(load_g1().default_joint_pos)
    found = []
    for _ in range(ticks):
        axis = rng.normal(size=3) * 0.1
        angle = float(np.sqrt((axis * axis).sum()))
        quat = np.array([np.cos(angle / 2), *(np.sin(angle / 2) * axis / angle)])
        found.append(
            RobotState(
                quat.astype(np.float32),
                rng.normal(scale=0.3, size=3).astype(np.float32),
                (default + rng.normal(scale=0.1, size=29)).astype(np.float32),
                rng.normal(scale=0.5, size=29).astype(np.float32),
                rng.normal(scale=0.2, size=3).astype(np.float32),
                np.array([0.0, 0.0, 0.75], np.float32) + rng.normal(scale=0.02, size=3),
            )
        )
    return found


def record(skill: Skill) -> Table:
    """Play `TICKS` ticks and return what was seen and done.

    Raises:
        ControlError: The network does not run, or its actions are not finite.
    """
    memory = skill.begin(states()[0], 0.0)
    command = np.array([0.3, 0.1, -0.2], np.float32)
    rows: dict[str, list[F32]] = {"obs": [], "action": [], "target": []}
    for tick, state in enumerate(states()):
        try:
            output = skill.step(memory, state, tick * 0.02, command)
        except Exception as error:  # onnxruntime raises a dozen types of its own
            raise ControlError(f"'{skill.manifest.name}' does not run: {error}.") from error
        if not (np.isfinite(output.action).all() and np.isfinite(output.targets.joint_pos).all()):
            raise ControlError(
                f"'{skill.manifest.name}' answers plausible states with actions that are not "
                f"finite, at tick {tick}."
            )
        rows["obs"].append(output.obs.copy())
        rows["action"].append(output.action.copy())
        rows["target"].append(output.targets.joint_pos.copy())
    return {name: np.stack(values) for name, values in rows.items()}


def write_golden(skill: Skill) -> Path:
    """Record and store the vectors in the skill's folder; returns the file."""
    path = skill.manifest.folder / GOLDEN_NAME
    table = record(skill)
    np.savez(path, obs=table["obs"], action=table["action"], target=table["target"])
    return path


def verify_golden(skill: Skill) -> float:
    """Return the largest deviation from the stored vectors.

    Raises:
        ControlError: There are none, or the skill behaves differently from when it was imported.
    """
    path = skill.manifest.folder / GOLDEN_NAME
    try:
        with np.load(path, allow_pickle=False) as file:
            stored = {name: file[name] for name in ("obs", "action", "target")}
    except (OSError, KeyError, ValueError) as error:
        raise ControlError(f"{path} holds no golden vectors: {error}.") from error
    worst = 0.0
    for name, now in record(skill).items():
        if stored[name].shape != now.shape:
            raise ControlError(
                f"'{name}' of {skill.manifest.name} has shape {now.shape}, it was imported with "
                f"{stored[name].shape} ({path})."
            )
        worst = max(worst, float(np.abs(stored[name] - now).max()))
    if not worst <= TOLERANCE:
        raise ControlError(
            f"'{skill.manifest.name}' deviates by {worst:.2g} from what it did when it was "
            f"imported; import it again if that is wanted ({path})."
        )
    return worst
