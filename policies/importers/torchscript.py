"""TorchScript to ONNX: run the module once, write down what it computes, keep its state outside.

The module's forward is played on one observation while every tensor operation is recorded. Control
flow is thereby resolved, hidden state becomes an input and an output, and what does not depend on
them is a constant. Needs PyTorch (extra `models`).
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from downbeat.policies.errors import PolicyError
from downbeat.policies.importers.torchscript_record import Graph, recorder
from downbeat.runtime.errors import one_of

OPSET, IR_VERSION = 17, 8
STATE_NAMES = {"hidden_state": "h", "cell_state": "c"}


@dataclass(frozen=True)
class Converted:
    """A converted network.

    Attributes:
        model: ONNX model: obs, NAME_in ... -> actions, NAME_out ...
        states: Name -> shape of each recurrent state.
        buffers: Name of each state -> the buffer of the module that it was.
        width: Of the observation.
        actions: Number of actions.
    """

    model: Any
    states: dict[str, tuple[int, ...]]
    buffers: dict[str, str]
    width: int
    actions: int


def load(path: Path) -> Any:
    """Load a TorchScript file; a pickled checkpoint is never opened.

    Raises:
        PolicyError: PyTorch is not installed, or the file is not TorchScript.
    """
    try:
        import torch
    except ImportError as error:
        raise PolicyError(
            "Converting TorchScript needs PyTorch, which is not installed; it comes with the extra "
            "`models` (pip install 'downbeat[models]')."
        ) from error
    if not path.is_file():
        raise PolicyError(f"There is no file {path}.")
    try:
        module = torch.jit.load(str(path), map_location="cpu").eval()
    except Exception as error:  # torch raises what its C++ raises
        line = " ".join(str(error).split())[:200].rstrip(".")
        raise PolicyError(
            f"{path} is not a TorchScript file: {line}; a checkpoint must first be exported with "
            "torch.jit.script by the code that made it."
        ) from error
    return module.float()


def find_width(module: Any, path: Path) -> int:
    """Return the width of the observation: the only width of a layer that runs.

    Raises:
        PolicyError: None or several would.
    """
    import torch

    widths = {int(p.shape[1]) for _, p in module.named_parameters() if p.dim() == 2}
    widths |= {int(b.shape[-1]) for _, b in module.named_buffers() if b.dim() in (1, 2)}
    fitting = []
    for width in sorted(widths):
        try:
            with torch.no_grad():
                module(torch.zeros(1, width))
            fitting.append(width)
        except Exception:
            continue
    if len(fitting) != 1:
        found = f"widths {one_of(fitting)} would all run" if fitting else "no width of a layer runs"
        raise PolicyError(f"The observation of {path} has an unknown width: {found}; give --width.")
    return fitting[0]


def convert(module: Any, width: int, path: Path) -> Converted:
    """Convert a loaded module.

    Args:
        module: TorchScript module, one observation (1, width) in, actions out.
        width: Of the observation.
        path: For errors.

    Raises:
        PolicyError: It does something that has no place in a policy.
    """
    import torch

    graph = Graph()
    buffers = dict(module.named_buffers())
    short = _state_names(buffers)
    reset(module, [name for name in buffers if _leaf(name) in STATE_NAMES])
    obs = torch.zeros(1, width)
    graph.bind(obs, "obs")
    for name, tensor in buffers.items():
        graph.bind(tensor, f"{short[name]}_in")
    recording = recorder(graph, buffers, path)
    try:
        with torch.no_grad(), _elementary(), recording:
            result = module(obs)
    except Exception as error:  # torch raises what its C++ raises
        if recording.refused is not None:
            raise recording.refused from error
        line = " ".join(str(error).split())[:300].rstrip(".")
        raise PolicyError(f"{path} does not run on {width} observations: {line}.") from error
    if not isinstance(result, torch.Tensor) or result.dim() != 2 or id(result) not in graph.names:
        raise PolicyError(f"{path} does not return one table of actions (1, n).")
    after = dict(module.named_buffers())
    outputs = {n: graph.names.get(id(t), "") for n, t in after.items()}
    outputs.update(recording.written)
    changed = {short[n]: v for n, v in outputs.items() if v and v != f"{short[n]}_in"}
    for name, tensor in buffers.items():
        if short[name] not in changed:
            graph.constants[f"{short[name]}_in"] = tensor.detach().numpy().astype(np.float32)
    states = {short[n]: tuple(b.shape) for n, b in buffers.items() if short[n] in changed}
    model = _model(graph, width, graph.names[id(result)], result.shape, changed, states)
    names = {short[n]: n for n in buffers if short[n] in changed}
    return Converted(model, states, names, width, int(result.shape[1]))


@contextmanager
def _elementary() -> Iterator[None]:
    """Let a recurrent layer appear as the operations it is made of, not as one of oneDNN's."""
    import torch

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about Intel GPUs, when the flags are set
        with torch.backends.mkldnn.flags(enabled=False):
            yield


def reset(module: Any, names: Collection[str]) -> None:
    """Set buffers to zero, the way that the state starts on the robot."""
    import torch

    with torch.no_grad():
        for name, buffer in module.named_buffers():
            if name in names:
                buffer.zero_()


def _leaf(name: str) -> str:
    return name.rsplit(".", 1)[-1]


def _state_names(buffers: Collection[str]) -> dict[str, str]:
    """Return a short name for each buffer: h and c where that is not ambiguous."""
    leaves = [_leaf(name) for name in buffers]
    return {
        name: STATE_NAMES[_leaf(name)]
        if _leaf(name) in STATE_NAMES and leaves.count(_leaf(name)) == 1
        else name.replace(".", "_")
        for name in buffers
    }


def _model(
    graph: Graph,
    width: int,
    action: str,
    shape: Sequence[int],
    changed: dict[str, str],
    states: dict[str, tuple[int, ...]],
) -> Any:
    nodes = [*graph.nodes, helper.make_node("Identity", [action], ["actions"])]
    inputs, outputs = {"obs": (1, width)}, {"actions": tuple(shape)}
    for state, value in changed.items():
        nodes.append(helper.make_node("Identity", [value], [f"{state}_out"]))
        inputs[f"{state}_in"] = outputs[f"{state}_out"] = states[state]
    used = {name for node in nodes for name in node.input}
    weights = [numpy_helper.from_array(v, n) for n, v in graph.constants.items() if n in used]
    made = helper.make_graph(
        nodes,
        "policy",
        [helper.make_tensor_value_info(n, TensorProto.FLOAT, s) for n, s in inputs.items()],
        [helper.make_tensor_value_info(n, TensorProto.FLOAT, s) for n, s in outputs.items()],
        weights,
    )
    model = helper.make_model(
        made, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION
    )
    model.producer_name = "downbeat"
    onnx.checker.check_model(model)
    return model
