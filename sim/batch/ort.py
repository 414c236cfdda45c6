"""Networks of imported policies through ONNX Runtime, N robots in one call.

Published graphs have a fixed batch of one. Its dimension is made symbolic, everything that the
actions do not need is cut away (BeyondMimic carries its motion inside), and the result is held
against the original row by row; a graph that does not survive this is run robot by robot.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import onnx
import onnxruntime as ort
from numpy.typing import NDArray

from downbeat.control.session import open_session
from downbeat.policies.manifest import SkillManifest

F32 = NDArray[np.float32]
CHECK_ROWS = 3
TOLERANCE = 1e-5

log = logging.getLogger("downbeat.sim")


def open_batched(manifest: SkillManifest, outputs: tuple[str, ...]) -> BatchedNetwork:
    """Open the network of a manifest; see `skills.OpenNetwork`."""
    return BatchedNetwork(manifest.onnx_path, outputs)


class BatchedNetwork:
    """One network. Inputs are (N, k) for graph inputs (1, k), and (N, *shape) for others."""

    def __init__(self, path: Path, outputs: Sequence[str]) -> None:
        self.path = path
        self.outputs = tuple(outputs)
        self._single = open_session(path)
        self._shapes = {node.name: tuple(node.shape) for node in self._single.get_inputs()}
        self._session: ort.InferenceSession | None = None
        self._used: set[str] = set()
        self._axes: dict[str, int] = {}
        self._open()

    @property
    def is_batched(self) -> bool:
        """Whether all robots go through the network together."""
        return self._session is not None

    def __call__(self, feeds: Mapping[str, F32]) -> list[F32]:
        """Return the outputs, (N, *shape of the graph's output without or with its batch)."""
        if self._session is None:
            return self._one_by_one(feeds)
        given = {
            name: np.ascontiguousarray(self._pack(name, np.asarray(value, np.float32)))
            for name, value in feeds.items()
            if name in self._used
        }
        results = self._session.run(list(self.outputs), given)
        return [
            self._unpack(name, value) for name, value in zip(self.outputs, results, strict=True)
        ]

    # ------------------------------------------------------------------ layouts

    def _pack(self, name: str, value: F32) -> F32:
        """(N, *shape) -> the graph's layout with N in its batch axis."""
        if value.ndim == len(self._shapes[name]):
            return value
        axis = self._axes.get(name, 0)
        return np.moveaxis(value, 0, axis).reshape(
            [s if i != axis else value.shape[0] for i, s in enumerate(self._shapes[name])]
        )

    def _unpack(self, name: str, value: F32) -> F32:
        axis = self._axes.get(name, 0)
        if axis == 0:
            return value
        return np.expand_dims(np.moveaxis(value, axis, 0), 1 + axis)

    def _one_by_one(self, feeds: Mapping[str, F32]) -> list[F32]:
        count = len(next(iter(feeds.values())))
        rows: list[list[F32]] = []
        for index in range(count):
            given = {
                name: np.asarray(value[index], np.float32).reshape(self._shapes[name])
                for name, value in feeds.items()
            }
            rows.append(self._single.run(list(self.outputs), given))
        return [np.stack([row[i] for row in rows]) for i in range(len(self.outputs))]

    # ------------------------------------------------------------------ opening

    def _open(self) -> None:
        """Try batch axes of the recurrent inputs until one agrees with the single network."""
        others = [n for n, shape in self._shapes.items() if len(shape) > 2]
        for axis in (1, 0) if others else (0,):
            self._axes = dict.fromkeys(others, axis)
            self._axes |= {
                node.name: axis
                for node in self._single.get_outputs()
                if node.name in self.outputs and len(node.shape) > 2
            }
            try:
                self._session = self._symbolic()
                if self._agrees():
                    return
            except Exception as error:
                log.debug("%s cannot be batched: %s", self.path, error)
            self._session = None
        log.warning("%s runs robot by robot: its graph has a fixed batch", self.path)

    def _symbolic(self) -> ort.InferenceSession:
        model = onnx.load(self.path)
        graph = model.graph
        keep = _needed(graph, self.outputs)
        nodes = [node for node in graph.node if set(node.output) & keep]
        del graph.node[:]
        graph.node.extend(nodes)
        outputs = [o for o in graph.output if o.name in self.outputs]
        del graph.output[:]
        graph.output.extend(outputs)
        inputs = [i for i in graph.input if i.name in keep]
        del graph.input[:]
        graph.input.extend(inputs)
        del graph.value_info[:]
        for value in (*graph.input, *graph.output):
            dims = value.type.tensor_type.shape.dim
            if dims:
                dims[self._axes.get(value.name, 0)].dim_param = "robots"
        self._used = {i.name for i in graph.input}
        options = ort.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4
        data = model.SerializeToString()
        return ort.InferenceSession(data, options, providers=["CPUExecutionProvider"])

    def _agrees(self) -> bool:
        rng = np.random.default_rng(0)
        feeds = {}
        for name, shape in self._shapes.items():
            rows = (CHECK_ROWS, *(shape[1:] if len(shape) <= 2 else shape))
            feeds[name] = rng.normal(0.0, 0.5, rows).astype(np.float32)
        together, alone = self(feeds), self._one_by_one(feeds)
        for a, b in zip(together, alone, strict=True):
            a, b = a.reshape(CHECK_ROWS, -1), b.reshape(CHECK_ROWS, -1)
            if a.shape != b.shape or np.abs(a - b).max() > TOLERANCE * (1.0 + np.abs(b).max()):
                return False
        return True


def _needed(graph: onnx.GraphProto, outputs: Sequence[str]) -> set[str]:
    """Return the names of all values that the outputs depend on."""
    maker = {name: node for node in graph.node for name in node.output}
    needed: set[str] = set()
    todo = list(outputs)
    while todo:
        name = todo.pop()
        if name in needed or not name:
            continue
        needed.add(name)
        if name in maker:
            todo.extend(maker[name].input)
    return needed
