"""Skills for many robots at once, over numpy or jax.numpy.

The observation terms are control's own (`control/observation.py`); what is written again here is
only the bookkeeping around them, with a leading batch dimension and without branches on data, so
that the same lines run in a loop over numpy arrays and inside a jitted scan. Tests hold every
skill against control's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Protocol

import numpy as np

from downbeat.control.observation import RobotState
from downbeat.policies.manifest import SkillManifest

Array = Any
Memory = Mapping[str, Any]
"""A tree of arrays with N rows; what `SkillMemory` is to one robot."""
Network = Callable[[Mapping[str, Array]], list[Array]]
"""Inputs by name, each (N, ...) -> the outputs that were asked for."""
OpenNetwork = Callable[[SkillManifest, tuple[str, ...]], Network]
"""Opens the network of a manifest for some outputs: ONNX Runtime or our JAX evaluator."""


@dataclass(frozen=True, slots=True)
class BatchOutput:
    """What a skill wants in one tick.

    Attributes:
        joint_pos: (N, 29) [rad] position targets, motor order.
        reference: (N, 29) [rad] where the joints should be now.
    """

    joint_pos: Array
    reference: Array


class BatchSkill(Protocol):
    """A skill that N robots play."""

    manifest: SkillManifest
    joint_stiffness: np.ndarray
    """(29,) [N m/rad]."""
    joint_damping: np.ndarray
    """(29,) [N m s/rad]."""

    def begin(
        self, state: RobotState, phase_s: Array, command: Array, xp: ModuleType
    ) -> dict[str, Any]:
        """Return the memory with which the skill starts in a tick.

        Args:
            state: The robots as measured in that tick, N rows.
            phase_s: (N,) or (1,) [s] of skill time.
            command: (N, 3) vx, vy [m/s], yaw rate [rad/s].
            xp: `numpy` or `jax.numpy`.
        """
        ...

    def step(
        self, memory: Memory, state: RobotState, phase_s: Array, command: Array, xp: ModuleType
    ) -> tuple[dict[str, Any], BatchOutput]:
        """Compute one tick; return the new memory and the targets."""
        ...


def batch_skill(manifest: SkillManifest, open_network: OpenNetwork) -> BatchSkill:
    """Return a skill of our own format or an imported one.

    Raises:
        SimError: The network cannot be run in batch.
    """
    from downbeat.sim.batch.learned import LearnedBatch
    from downbeat.sim.batch.table import TableBatch

    if manifest.policy is None:
        return TableBatch(manifest)
    return LearnedBatch(manifest, open_network)
