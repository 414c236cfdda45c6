"""Motions that are baked into a network: read back row by row, through the network itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from downbeat.policies.errors import PolicyError
from downbeat.policies.importers.build import TIME_STEP
from downbeat.policies.importers.motion import F32, MAX_ROWS, Tables
from downbeat.policies.importers.network import Network
from downbeat.runtime.errors import one_of

CONSTANT_ROWS = 250
"""Where the graph does not show its length: a motion that holds its last row this long is over."""


def read_baked(network: Network, outputs: Sequence[str]) -> dict[str, F32]:
    """Return the whole tables (T, ...) behind outputs that depend on `time_step` alone.

    Args:
        network: The file.
        outputs: Their names.

    Raises:
        PolicyError: An output is missing, the network does not run, or the motion does not end.
    """
    missing = [name for name in outputs if name not in network.outputs]
    if missing:
        raise PolicyError(
            f"{network.path} takes a time_step but has no output '{missing[0]}' with the motion; "
            f"its outputs are {one_of(network.outputs)}."
        )
    reader = _Reader(network, outputs)
    length = _length(network, outputs)
    rows = reader.until_constant() if length is None else [reader.row(k) for k in range(length)]
    if not 2 <= len(rows) <= MAX_ROWS:
        raise PolicyError(
            f"The motion in {network.path} has {len(rows)} rows; 2..{MAX_ROWS} are valid."
        )
    tables = {name: np.stack([row[i] for row in rows]) for i, name in enumerate(outputs)}
    broken = [name for name, table in tables.items() if not np.isfinite(table).all()]
    if broken:
        raise PolicyError(f"The motion in {network.path} has '{broken[0]}' that is not finite.")
    return {name: table.astype(np.float32) for name, table in tables.items()}


def anchored(tables: Mapping[str, F32], place: F32, quat_wxyz: F32, where: str) -> Tables:
    """Return our tables for joints and the pose of an anchor.

    Raises:
        PolicyError: A quaternion is none.
    """
    norm = np.linalg.norm(quat_wxyz, axis=1, keepdims=True)
    if (np.abs(norm - 1.0) > 0.05).any():
        raise PolicyError(f"The motion in {where} has orientations that are no unit quaternions.")
    return {
        "joint_pos": tables["joint_pos"],
        "joint_vel": tables["joint_vel"],
        "anchor_pos": place,
        "anchor_quat": (quat_wxyz / norm).astype(np.float32),
    }


def _length(network: Network, outputs: Sequence[str]) -> int | None:
    """Return the length that the constants behind all outputs share; None if that is not clear."""
    constants = [tuple(t.dims) for t in network.model.graph.initializer]
    for node in network.model.graph.node:
        constants += [tuple(a.t.dims) for a in node.attribute if a.name == "value"]
    shared: set[int] | None = None
    for name in outputs:
        inner = network.outputs[name][1:]
        lengths = {dims[0] for dims in constants if len(dims) > 1 and dims[1:] == inner}
        shared = lengths if shared is None else shared & lengths
    lengths = {length for length in shared or () if length > 1}
    return lengths.pop() if len(lengths) == 1 and max(lengths) <= MAX_ROWS else None


class _Reader:
    """Runs the network for one row after the other."""

    def __init__(self, network: Network, outputs: Sequence[str]) -> None:
        import onnxruntime as ort

        self._path = network.path
        self._outputs = list(outputs)
        self._feeds: dict[str, Any] = {
            name: np.zeros(shape, np.float32) for name, shape in network.inputs.items()
        }
        options = ort.SessionOptions()
        options.intra_op_num_threads = 1
        options.log_severity_level = 4
        try:
            self._session = ort.InferenceSession(
                str(network.path), options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # onnxruntime raises a dozen types of its own
            raise PolicyError(f"{network.path} cannot be loaded: {_line(error)}.") from error

    def row(self, step: float) -> list[F32]:
        self._feeds[TIME_STEP][...] = step
        try:
            return [output[0] for output in self._session.run(self._outputs, self._feeds)]
        except Exception as error:  # onnxruntime raises a dozen types of its own
            raise PolicyError(
                f"{self._path} does not run at time_step {step:g}: {_line(error)}."
            ) from error

    def until_constant(self) -> list[list[F32]]:
        last = self.row(10.0 * MAX_ROWS)
        rows: list[list[F32]] = []
        constant = 0
        while constant < CONSTANT_ROWS and len(rows) <= MAX_ROWS:
            rows.append(self.row(len(rows)))
            same = all(np.array_equal(a, b) for a, b in zip(rows[-1], last, strict=True))
            constant = constant + 1 if same else 0
        return rows[: len(rows) - constant + 1]


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:200].rstrip(".")
