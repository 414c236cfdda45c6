"""Write a skill as ONNX: tables over the phase, interpolated in the graph, and one matrix product.

`actions = (u + clip(K (obs - obs_ref)) - default_joint_pos) / action_scale`; u, obs_ref and K are
interpolated between the two table rows around `time_step` (and, for locomotion, between the gaits
around `command`). The last row repeats the first, so the loop closes without a seam. Gains are
stored as float16 (the same survival and error as float32, half the size) and cast after Gather.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from downbeat.catalog.robot import Robot, load_g1
from downbeat.policies.manifest import OBSERVATION_NAMES, OBSERVATION_SIZE

F64 = NDArray[np.float64]
OPSET = 13
IR_VERSION = 8
NUM_JOINTS = 29
ROW = NUM_JOINTS + OBSERVATION_SIZE
"""Columns of the small table: u (29), obs_ref (64)."""
GAIN = NUM_JOINTS * OBSERVATION_SIZE
MAX_CORRECTION_RAD = 0.5
"""The feedback may move a target this far. It was built for feet on the floor: in a hop, which one
kick of sensor noise can start, it would wind itself up to 20 rad and throw the robot. With it, 0 of
64 runs of four skills fall under half of BeyondMimic's noise (without it 3), and under all of it
they last 11 to 22 s instead of 1 s."""


@dataclass(frozen=True, slots=True)
class Tables:
    """A skill's tables in the units of the graph, one entry per gait G (1 for dances).

    Attributes:
        rows: (N, G, 93) float32: u as actions (29), obs_ref (64).
        gains: (N, G, 29 * 64) float16 or float32: actions per observation.
    """

    rows: NDArray[np.float32]
    gains: NDArray[np.floating]


@dataclass(frozen=True, slots=True)
class CommandGrid:
    """Commands at which gaits were built; the gaits lie in row-major order of (vx, yaw rate)."""

    vx: tuple[float, ...]
    yaw_rate: tuple[float, ...]


def make_tables(
    targets: Sequence[F64],
    obs_refs: Sequence[F64],
    gains: Sequence[F64],
    dtype: type = np.float16,
) -> Tables:
    """Turn every gait's targets (N, 29) [rad], obs_ref (N, 64), gains (N, 29, 64) into tables."""
    robot = load_g1()
    rows, scaled = [], []
    for target, obs_ref, gain in zip(targets, obs_refs, gains):
        action = (target - robot.default_joint_pos) / robot.action_scale
        rows.append(np.concatenate([action, obs_ref], axis=1))
        scaled.append((gain / robot.action_scale[:, None]).reshape(len(gain), GAIN))
    return Tables(np.stack(rows, axis=1).astype(np.float32), np.stack(scaled, axis=1).astype(dtype))


class _Graph:
    """Collects nodes and constants."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []

    def op(self, kind: str, inputs: Sequence[str], output: str, **attributes: object) -> str:
        self.nodes.append(helper.make_node(kind, list(inputs), [output], **attributes))
        return output

    def constant(self, name: str, value: object, dtype: type = np.float32) -> str:
        self.constants.append(numpy_helper.from_array(np.asarray(value, dtype), name))
        return name


def _phase_weights(graph: _Graph, ticks: int) -> tuple[str, str]:
    """Add nodes for the two row indices (2,) and their weights (1, 2) at `time_step`."""
    graph.constant("ticks", [[float(ticks)]])
    graph.op("Mod", ["time_step", "ticks"], "phase", fmod=1)
    graph.op("Floor", ["phase"], "phase_floor")
    graph.op("Sub", ["phase", "phase_floor"], "later_weight")
    graph.op("Sub", [graph.constant("one", [[1.0]]), "later_weight"], "earlier_weight")
    graph.op("Concat", ["earlier_weight", "later_weight"], "time_weights", axis=1)
    graph.op("Cast", ["phase_floor"], "row_float", to=TensorProto.INT64)
    graph.op("Reshape", ["row_float", graph.constant("flat", [-1], np.int64)], "row")
    graph.op("Add", ["row", graph.constant("both", [0, 1], np.int64)], "row_pair")
    return "row_pair", "time_weights"


def _hat_weights(graph: _Graph, name: str, column: int, grid: Sequence[float]) -> str:
    """Add nodes for the linear interpolation weights (1, len(grid)) of one command component."""
    points = np.asarray(grid, float)
    left = np.diff(points, prepend=points[0] - 1.0)
    right = np.diff(points, append=points[-1] + 1.0)
    low = graph.constant(f"{name}_low", points[0])
    high = graph.constant(f"{name}_high", points[-1])
    bounds = [graph.constant(f"{name}_{end}", [column + k], np.int64) for k, end in enumerate("ab")]
    axis = graph.constant(f"{name}_axis", [1], np.int64)
    graph.op("Slice", ["command", *bounds, axis], f"{name}_asked")
    graph.op("Clip", [f"{name}_asked", low, high], f"{name}_value")
    before = graph.constant(f"{name}_before", [points - left])
    after = graph.constant(f"{name}_after", [points + right])
    graph.op("Sub", [f"{name}_value", before], f"{name}_up")
    graph.op("Sub", [after, f"{name}_value"], f"{name}_down")
    graph.op("Div", [f"{name}_up", graph.constant(f"{name}_left", [left])], f"{name}_rise")
    graph.op("Div", [f"{name}_down", graph.constant(f"{name}_right", [right])], f"{name}_fall")
    graph.op("Min", [f"{name}_rise", f"{name}_fall"], f"{name}_hat")
    zero = graph.constant(f"{name}_zero", 0.0)
    return graph.op("Max", [f"{name}_hat", zero], f"{name}_weights")


def _gait_weights(graph: _Graph, time_weights: str, grid: CommandGrid) -> str:
    """Add nodes for the weights (1, 2 G) of all gathered rows: time x vx x yaw rate."""
    vx = _hat_weights(graph, "vx", 0, grid.vx)
    yaw_rate = _hat_weights(graph, "yaw_rate", 2, grid.yaw_rate)
    column = graph.constant("as_column", [-1, 1], np.int64)
    row = graph.constant("as_row", [1, -1], np.int64)
    graph.op("Reshape", [vx, column], "vx_column")
    graph.op("Mul", ["vx_column", yaw_rate], "gait_square")
    graph.op("Reshape", ["gait_square", row], "gait_weights")
    graph.op("Reshape", [time_weights, column], "time_column")
    graph.op("Mul", ["time_column", "gait_weights"], "weight_square")
    return graph.op("Reshape", ["weight_square", row], "weights")


def _interpolate(graph: _Graph, name: str, table: NDArray, rows: str, weights: str) -> str:
    """Add nodes for the weighted sum (1, W) of the table's gathered rows."""
    looped = np.concatenate([table, table[:1]])  # (N + 1, G, W)
    graph.constant(f"{name}_table", looped, looped.dtype.type)
    found = graph.op("Gather", [f"{name}_table", rows], f"{name}_found")
    if looped.dtype == np.float16:
        found = graph.op("Cast", [found], f"{name}_float", to=TensorProto.FLOAT)
    shape = graph.constant(f"{name}_shape", [-1, table.shape[2]], np.int64)
    graph.op("Reshape", [found, shape], f"{name}_rows")
    return graph.op("MatMul", [weights, f"{name}_rows"], f"{name}_mix")


def build_model(
    name: str, tables: Tables, grid: CommandGrid | None, metadata: Mapping[str, str]
) -> onnx.ModelProto:
    """Return the ONNX model of a skill.

    Inputs `obs` (1, 64), `time_step` (1, 1) and with a grid `command` (1, 3); outputs `actions`,
    `joint_pos`, `joint_vel` (1, 29), all float32.
    """
    graph = _Graph()
    rows, weights = _phase_weights(graph, len(tables.rows))
    inputs = {"obs": [1, OBSERVATION_SIZE], "time_step": [1, 1]}
    if grid is not None:
        inputs["command"] = [1, 3]
        weights = _gait_weights(graph, weights, grid)
    _interpolate(graph, "row", tables.rows, rows, weights)
    _interpolate(graph, "gain", tables.gains, rows, weights)
    parts = graph.constant("parts", [NUM_JOINTS, OBSERVATION_SIZE], np.int64)
    graph.nodes.append(helper.make_node("Split", ["row_mix", parts], ["u", "obs_ref"], axis=1))
    terms = graph.constant("terms", [6, NUM_JOINTS, NUM_JOINTS], np.int64)
    outputs = ["base_ref", "joint_pos", "joint_vel"]
    graph.nodes.append(helper.make_node("Split", ["obs_ref", terms], outputs, axis=1))
    square = graph.constant("square", [NUM_JOINTS, OBSERVATION_SIZE], np.int64)
    graph.op("Reshape", ["gain_mix", square], "gain")
    graph.op("Sub", ["obs", "obs_ref"], "error")
    graph.op("Gemm", ["error", "gain"], "wanted_correction", transB=1)
    limit = MAX_CORRECTION_RAD / load_g1().action_scale[None, :]  # (1, 29)
    graph.op("Min", ["wanted_correction", graph.constant("high", limit)], "below_high")
    graph.op("Max", ["below_high", graph.constant("low", -limit)], "correction")
    graph.op("Add", ["u", "correction"], "actions")
    return _model(name, graph, inputs, metadata)


def _model(
    name: str, graph: _Graph, inputs: Mapping[str, list[int]], metadata: Mapping[str, str]
) -> onnx.ModelProto:
    def info(key: str, shape: list[int]) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(key, TensorProto.FLOAT, shape)

    outputs = [info(key, [1, NUM_JOINTS]) for key in ("actions", "joint_pos", "joint_vel")]
    model = helper.make_model(
        helper.make_graph(
            graph.nodes,
            name,
            [info(key, shape) for key, shape in inputs.items()],
            outputs,
            graph.constants,
        ),
        opset_imports=[helper.make_opsetid("", OPSET)],
        producer_name="downbeat",
    )
    model.ir_version = IR_VERSION
    helper.set_model_props(model, dict(metadata))
    onnx.checker.check_model(model)
    return model


def metadata(robot: Robot, ticks: int, has_command: bool) -> dict[str, str]:
    """Return the metadata that BeyondMimic's exporter writes, plus the number of ticks."""

    def text(values: Sequence[float] | F64) -> str:
        return ",".join(f"{value:.9g}" for value in values)

    return {
        "joint_names": ",".join(robot.joint_names),
        "joint_stiffness": text(robot.joint_stiffness),
        "joint_damping": text(robot.joint_damping),
        "default_joint_pos": text(robot.default_joint_pos),
        "action_scale": text(robot.action_scale),
        "observation_names": ",".join(OBSERVATION_NAMES),
        "command_names": "velocity" if has_command else "motion",
        "time_step_total": str(ticks),
    }


def write_onnx(path: Path, name: str, tables: Tables, grid: CommandGrid | None = None) -> None:
    """Write the skill's ONNX file; its folder is made if needed."""
    props = metadata(load_g1(), len(tables.rows), grid is not None)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(build_model(name, tables, grid, props).SerializeToString(deterministic=True))
