"""Look at an ONNX file without running it: inputs, outputs, metadata, where its weights lie."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import onnx
from google.protobuf.message import DecodeError

from downbeat.policies.errors import PolicyError
from downbeat.policies.importers.files import checked_file
from downbeat.runtime.errors import one_of

MAX_BYTES = 200_000_000
"""No policy that runs at 50 Hz on a robot is larger."""
MAX_NUMBERS = 1_000_000
"""Of one input."""
UNBOUNDED_OPS = frozenset({"Loop", "Scan"})
"""Their number of turns is data: such a network may never return."""


@dataclass(frozen=True)
class Network:
    """What an ONNX file says about itself.

    Attributes:
        path: The file.
        inputs: Name -> shape; free axes (the batch) are 1, a free last axis is 0.
        outputs: Name -> shape.
        metadata: Custom metadata.
        external: Files with weights, relative to the folder.
        model: The parsed graph, without external weights.
    """

    path: Path
    inputs: dict[str, tuple[int, ...]]
    outputs: dict[str, tuple[int, ...]]
    metadata: dict[str, str]
    external: tuple[str, ...]
    model: Any

    def width(self, name: str) -> int:
        """Return the last axis of an input or output."""
        shape = self.inputs.get(name) or self.outputs.get(name)
        if not shape:
            raise PolicyError(
                f"{self.path} has no '{name}'; inputs are {one_of(self.inputs)}, outputs "
                f"{one_of(self.outputs)}."
            )
        return shape[-1]


def read_network(path: Path, folder: Path | None = None) -> Network:
    """Read an ONNX file.

    Args:
        path: The file.
        folder: What is imported; None: the file's own folder, and the file may be a link.

    Raises:
        PolicyError: Missing, too large, not ONNX, not runnable in bounded time, or its weights lie
            outside its folder.
    """
    root = path.resolve().parent if folder is None else folder
    checked_file(path, root, MAX_BYTES)
    if path.suffix in (".pt", ".pth", ".jit"):
        raise PolicyError(
            f"{path} is a PyTorch file; turn it into ONNX with `downbeat policy convert {path} "
            f"--out {path.with_suffix('.onnx').name}`."
        )
    try:
        model = onnx.load(str(path), load_external_data=False)
    except (DecodeError, OSError, ValueError) as error:
        raise PolicyError(f"{path} is not an ONNX model: {error}.") from error
    if not model.graph.output or not model.graph.node:
        raise PolicyError(f"{path} is not an ONNX model: it has no graph.")
    named = (*model.graph.input, *model.graph.output)
    texts = [v.name for v in named] + [t for p in model.metadata_props for t in (p.key, p.value)]
    if not all(isinstance(text, str) for text in texts):
        raise PolicyError(f"{path} is not an ONNX model: it has names that are not UTF-8.")
    graphs = list(_graphs(model))
    unbounded = {n.op_type for nodes, _ in graphs for n in nodes} & UNBOUNDED_OPS
    if unbounded:
        raise PolicyError(
            f"{path} contains the operator {one_of(unbounded)}, whose running time is not bounded; "
            "networks without it are valid."
        )
    initial = {tensor.name for tensor in model.graph.initializer}
    inputs = {v.name: v for v in model.graph.input if v.name not in initial}
    for name, value in inputs.items():
        if value.type.tensor_type.elem_type != onnx.TensorProto.FLOAT:
            raise PolicyError(f"Input '{name}' of {path} does not take float32; only that is fed.")
    shapes = {name: _shape(value) for name, value in inputs.items()}
    for name, shape in shapes.items():
        if math.prod(shape) > MAX_NUMBERS:
            raise PolicyError(f"Input '{name}' of {path} takes {list(shape)} numbers; too many.")
    return Network(
        path,
        shapes,
        {v.name: _shape(v) for v in model.graph.output},
        {p.key: p.value for p in model.metadata_props},
        _external_files(path, root, [t for _, tensors in graphs for t in tensors]),
        model,
    )


def _shape(value: Any) -> tuple[int, ...]:
    dims = [max(0, int(d.dim_value)) for d in value.type.tensor_type.shape.dim]
    return (*(size or 1 for size in dims[:-1]), *dims[-1:])


def _graphs(model: Any) -> Iterator[tuple[Any, list[Any]]]:
    """Yield (nodes, tensors) of the graph, of all graphs in its nodes, and of all functions."""
    todo = [model.graph]
    for function in model.functions:
        yield function.node, list(_node_tensors(function.node, todo))
    while todo:
        graph = todo.pop()
        tensors = list(graph.initializer)
        for sparse in graph.sparse_initializer:
            tensors += [sparse.values, sparse.indices]
        yield graph.node, [*tensors, *_node_tensors(graph.node, todo)]


def _node_tensors(nodes: Any, todo: list[Any]) -> Iterator[Any]:
    for node in nodes:
        for attribute in node.attribute:
            yield attribute.t
            yield from attribute.tensors
            for sparse in (attribute.sparse_tensor, *attribute.sparse_tensors):
                yield from (sparse.values, sparse.indices)
            if attribute.HasField("g"):
                todo.append(attribute.g)
            todo.extend(attribute.graphs)


def _external_files(path: Path, root: Path, tensors: list[Any]) -> tuple[str, ...]:
    names = {e.value for tensor in tensors for e in tensor.external_data if e.key == "location"}
    for name in sorted(names):
        if not name or Path(name).name != name:
            raise PolicyError(
                f"{path} wants weights from '{name}', outside its folder; a plain file name is "
                "valid."
            )
        try:
            checked_file(path.resolve().parent / name, root, MAX_BYTES)
        except PolicyError as error:
            raise PolicyError(f"{path} wants weights from '{name}': {error}") from error
    return tuple(sorted(names))
