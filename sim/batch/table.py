"""Our own skills in batch: the tables are cut out of the ONNX graph.

u = u_ff[t] + clip(K[t] (obs - obs_ref[t])), tables interpolated at a fractional tick; a walk mixes
the tables of its gaits. In the graph this is one robot's row; here it is N robots with N phases.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import onnx
from onnx import numpy_helper

from downbeat.catalog.robot import NUM_JOINTS, load_g1
from downbeat.control.observation import RobotState, observe
from downbeat.policies.manifest import SkillManifest
from downbeat.sim.batch.skills import Array, BatchOutput, Memory
from downbeat.sim.errors import SimError

OBS = 64
AXES = ("vx", "yaw_rate")
"""Axes of a walk's gait grid; the command's columns are 0 and 2."""


class TableBatch:
    """One skill of our own format."""

    def __init__(self, manifest: SkillManifest) -> None:
        """Read the tables.

        Raises:
            SimError: The file is not a skill that our generator wrote.
        """
        self.manifest = manifest
        robot = load_g1()
        self.joint_stiffness = np.asarray(robot.joint_stiffness, np.float32)
        self.joint_damping = np.asarray(robot.joint_damping, np.float32)
        self._default = np.asarray(robot.default_joint_pos, np.float32)
        self._scale = np.asarray(robot.action_scale, np.float32)
        graph = onnx.load(manifest.onnx_path).graph
        parts = {t.name: numpy_helper.to_array(t) for t in graph.initializer}
        try:
            rows, gains = parts["row_table"], parts["gain_table"]
            self._low, self._high = parts["low"][0], parts["high"][0]
            self._ticks = float(parts["ticks"].item())
        except KeyError as error:
            raise SimError(
                f"{manifest.onnx_path} has no {error}; only skills that "
                "`downbeat policy generate` wrote can be cut into tables."
            ) from error
        self._rows = np.ascontiguousarray(rows, np.float32)  # (T + 1, G, 93)
        self._gains = np.ascontiguousarray(gains, np.float32)  # (T + 1, G, 29 * 64)
        self._grid = None if manifest.command is None else self._read_grid(parts)

    @staticmethod
    def _read_grid(parts: dict[str, Any]) -> list[tuple[np.ndarray, ...]]:
        names = ("low", "high", "before", "after", "left", "right")
        return [
            tuple(np.asarray(parts[f"{axis}_{name}"], np.float32) for name in names)
            for axis in AXES
        ]

    def begin(
        self, state: RobotState, phase_s: Array, command: Array, xp: ModuleType
    ) -> dict[str, Any]:
        """Return nothing: our skills are functions of state and phase."""
        return {}

    def step(
        self, memory: Memory, state: RobotState, phase_s: Array, command: Array, xp: ModuleType
    ) -> tuple[dict[str, Any], BatchOutput]:
        """Compute one tick."""
        weights = self._gait_weights(command, xp)  # (N or 1, G)
        row, gain = self._tables(phase_s, weights, xp)
        obs = observe(state, self.manifest.observation_names, xp)  # (N, 64)
        error = obs - row[..., NUM_JOINTS:]
        if xp is np and gain.shape[0] == 1:
            wanted = np.einsum("nk,jk->nj", error, gain[0])
        else:
            gain = xp.broadcast_to(gain, (len(obs), NUM_JOINTS, OBS))
            wanted = xp.einsum("nk,njk->nj", error, gain)
        action = row[..., :NUM_JOINTS] + xp.clip(wanted, self._low, self._high)
        target = self._default + self._scale * action
        reference = xp.broadcast_to(row[..., NUM_JOINTS + 6 : NUM_JOINTS + 35], target.shape)
        return {}, BatchOutput(target, reference)

    def _tables(self, phase_s: Array, weights: Array, xp: ModuleType) -> tuple[Array, Array]:
        """Return the mixed rows (M, 93) and gains (M, 29, 64); M is 1 if all robots share them."""
        ticks_per_s = self.manifest.ticks / self.manifest.duration_s
        tick = xp.mod(phase_s * ticks_per_s, self._ticks)
        low = xp.floor(tick)
        later = xp.asarray(tick - low, np.float32)[:, None]  # (M, 1)
        index = xp.clip(low.astype(np.int32), 0, self._rows.shape[0] - 2)
        count = max(index.shape[0], weights.shape[0])
        row = xp.zeros((count, self._rows.shape[2]), np.float32)
        gain = xp.zeros((count, self._gains.shape[2]), np.float32)
        rows, gains = xp.asarray(self._rows), xp.asarray(self._gains)
        for gait in range(self._rows.shape[1]):
            share = weights[:, gait : gait + 1]  # (N or 1, 1)
            if xp is np and not share.any():
                continue
            for offset, weight in ((0, 1.0 - later), (1, later)):
                row = row + (share * weight) * rows[index + offset, gait]
                gain = gain + (share * weight) * gains[index + offset, gait]
        return row, gain.reshape((count, NUM_JOINTS, OBS))

    def _gait_weights(self, command: Array, xp: ModuleType) -> Array:
        """Return the share of each gait of the grid, (N, G); (1, 1) for anything but a walk."""
        if self._grid is None:
            return xp.ones((1, 1), np.float32)
        hats = []
        for column, (low, high, before, after, left, right) in zip((0, 2), self._grid, strict=True):
            value = xp.clip(command[:, column : column + 1], low, high)  # (N, 1)
            hat = xp.minimum((value - before) / left, (after - value) / right)
            hats.append(xp.maximum(hat, 0.0))
        square = hats[0][:, :, None] * hats[1][:, None, :]  # (N, vx, yaw rate)
        return square.reshape((len(command), -1)).astype(np.float32)
