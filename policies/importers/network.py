"""Look at an ONNX file without running it: inputs, outputs, metadata, where its weights lie."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import onnx
from google.protobuf.message import DecodeError

from downbeat.policies.errors import PolicyError
from downbeat.runtime.errors import one_of

MAX_BYTES = 200_000_000
"""No policy that runs at 50 Hz on a robot is larger."""


@dataclass(frozen=True)
class Network:
    """What an ONNX file says about itself.

    Attributes:
        path: The file.
        inputs: Name -> shape; dynamic axes are 0.
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


def read_network(path: Path) -> Network:
    """Read an ONNX file.

    Raises:
        PolicyError: Missing, too large, not ONNX, or its weights lie outside its folder.
    """
    if not path.is_file():
        raise PolicyError(f"There is no file {path}.")
    if path.stat().st_size > MAX_BYTES:
        raise PolicyError(f"{path} has {path.stat().st_size} bytes; at most {MAX_BYTES} are valid.")
    try:
        model = onnx.load(str(path), load_external_data=False)
    except (DecodeError, OSError, ValueError) as error:
        raise PolicyError(f"{path} is not an ONNX model: {error}.") from error
    if not model.graph.output or not model.graph.node:
        raise PolicyError(f"{path} is not an ONNX model: it has no graph.")
    external = _external_files(path, model)
    initial = {tensor.name for tensor in model.graph.initializer}
    inputs = {v.name: _shape(v) for v in model.graph.input if v.name not in initial}
    return Network(
        path,
        inputs,
        {v.name: _shape(v) for v in model.graph.output},
        {p.key: p.value for p in model.metadata_props},
        external,
        model,
    )


def _shape(value: Any) -> tuple[int, ...]:
    return tuple(int(d.dim_value) for d in value.type.tensor_type.shape.dim)


def _external_files(path: Path, model: Any) -> tuple[str, ...]:
    folder, names = path.parent.resolve(), set()
    for tensor in model.graph.initializer:
        for entry in tensor.external_data:
            if entry.key == "location":
                names.add(entry.value)
    for name in sorted(names):
        file = (folder / name).resolve()
        if Path(name).is_absolute() or not file.is_relative_to(folder):
            raise PolicyError(f"{path} wants weights from {name}, outside its folder.")
        if Path(name).name != name:
            raise PolicyError(f"{path} wants weights from {name}; a plain file name is valid.")
        if not file.is_file():
            raise PolicyError(f"{path} wants weights from {name}, which is not beside it.")
        if file.stat().st_size > MAX_BYTES:
            raise PolicyError(f"{file} is larger than {MAX_BYTES} bytes.")
    return tuple(sorted(names))
