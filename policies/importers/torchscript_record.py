"""Write down what a PyTorch module computes, operation by operation, as an ONNX graph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from onnx import helper

from downbeat.policies.errors import PolicyError
from downbeat.policies.importers.torchscript_ops import OPS, SHAPE_ONLY, VIEWS
from downbeat.runtime.errors import one_of

MAX_OPERATIONS = 20_000


@dataclass
class Graph:
    """The ONNX graph under construction.

    Attributes:
        nodes: In order.
        constants: Initializers, by name.
        names: id of a tensor that depends on the inputs -> its name.
        alive: Those tensors; an id is only unique as long as its object lives.
    """

    nodes: list[Any] = field(default_factory=list)
    constants: dict[str, Any] = field(default_factory=dict)
    names: dict[int, str] = field(default_factory=dict)
    alive: list[Any] = field(default_factory=list)

    def bind(self, tensor: Any, name: str) -> None:
        """Say which name a tensor has from now on."""
        self.names[id(tensor)] = name
        self.alive.append(tensor)

    def name_of(self, value: Any) -> str:
        """Return the name of a tensor or number; what depends on no input becomes a constant."""
        if id(value) in self.names:
            return self.names[id(value)]
        array = np.asarray(value.detach().cpu().numpy() if hasattr(value, "detach") else value)
        return self.constant(array.astype(np.float32) if array.dtype != np.int64 else array)

    def constant(self, array: Any) -> str:
        """Add a constant."""
        name = f"c{len(self.constants)}"
        self.constants[name] = np.array(array, order="C")
        return name

    def add(self, op: str, inputs: Sequence[str], outputs: int = 1, **attributes: Any) -> list[str]:
        """Add a node and return the names of its outputs."""
        names = [f"v{len(self.nodes)}_{i}" for i in range(outputs)]
        self.nodes.append(helper.make_node(op, list(inputs), names, **attributes))
        return names


def recorder(graph: Graph, buffers: dict[str, Any], path: Path) -> Any:
    """Return a context that writes every tensor operation into `graph`.

    Args:
        graph: Knows the inputs already.
        buffers: The module's buffers by name; a whole one that is written becomes state.
        path: For errors.
    """
    import torch
    from torch.utils._python_dispatch import TorchDispatchMode

    stores = {b.untyped_storage().data_ptr(): n for n, b in buffers.items() if b.numel()}

    class Recorder(TorchDispatchMode):
        """Sees every operation below autograd, with its real tensors."""

        written: dict[str, str]
        refused: PolicyError | None = None
        """TorchScript turns every exception into one of its own; the sentence is kept here."""

        def __torch_dispatch__(
            self, func: Any, types: Any, args: Any = (), kwargs: Any = None
        ) -> Any:
            result = func(*args, **(kwargs or {}))
            tensors = [t for t in _flat((args, kwargs or {})) if isinstance(t, torch.Tensor)]
            op = func.overloadpacket.__name__
            if op not in SHAPE_ONLY and any(id(t) in graph.names for t in tensors):
                try:
                    self._record(op, args, kwargs or {}, result)
                except PolicyError as error:
                    self.refused = error
                    raise
            return result

        def _record(self, op: str, args: Any, kwargs: Any, result: Any) -> None:
            if len(graph.nodes) > MAX_OPERATIONS:
                raise PolicyError(f"{path} takes more than {MAX_OPERATIONS} operations.")
            in_place = op.endswith("_") and op[:-1] in OPS
            op = op[:-1] if in_place else op
            if op == "copy_":
                self._write(args[0], args[1])
            elif op in VIEWS:
                shape = graph.constant(np.asarray(result.shape, np.int64))
                graph.bind(result, graph.add("Reshape", [graph.name_of(args[0]), shape])[0])
            elif op in OPS:
                names = OPS[op](graph, args, kwargs, result)
                results = result if isinstance(result, tuple | list) else [result]
                for tensor, name in zip(results, names, strict=False):
                    graph.bind(tensor, name)
            else:
                raise PolicyError(
                    f"{path} uses the operation '{op}', which is not supported; supported are "
                    f"{one_of([*OPS, *VIEWS, 'copy_'], 100)}."
                )
            if in_place and args[0].untyped_storage().data_ptr() in stores:
                self._write(args[0], args[0])

        def _write(self, target: Any, source: Any) -> None:
            name = stores.get(target.untyped_storage().data_ptr())
            if name is None or target.numel() != buffers[name].numel():
                raise PolicyError(f"{path} writes into a part of a tensor, which is not supported.")
            shape = graph.constant(np.asarray(buffers[name].shape, np.int64))
            value = graph.add("Reshape", [graph.name_of(source), shape])[0]
            graph.bind(target, value)
            graph.bind(buffers[name], value)
            self.written[name] = value

    recording = Recorder()
    recording.written = {}
    return recording


def _flat(value: Any) -> list[Any]:
    if isinstance(value, dict):
        return _flat(list(value.values()))
    if isinstance(value, tuple | list):
        return [item for part in value for item in _flat(part)]
    return [value]
