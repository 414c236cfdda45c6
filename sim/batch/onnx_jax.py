"""Evaluate ONNX graphs in JAX: the operators of policies, jit-, vmap- and scan-able.

What is constant in a graph stays numpy until it meets an input, so that shapes, axes and indices
are known when JAX traces. Needs jax, numpy and onnx, and no runtime.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import onnx
from onnx import helper, numpy_helper

from downbeat.sim.batch.onnx_recurrent import gru, lstm
from downbeat.sim.errors import SimError

Array = Any
Attributes = Mapping[str, Any]
Operator = Callable[..., Any]


class JaxGraph:
    """One ONNX graph as a function of its inputs; pure, so JAX may transform it."""

    def __init__(self, path: Path, outputs: Sequence[str] = ()) -> None:
        """Read the graph; only what the outputs need is kept.

        Args:
            path: The ONNX file.
            outputs: Names; none: all.

        Raises:
            SimError: An output does not exist, or an operator is not supported.
        """
        graph = onnx.load(path).graph
        self.path = path
        known = [value.name for value in graph.output]
        self.outputs = tuple(outputs) or tuple(known)
        for name in self.outputs:
            if name not in known:
                raise SimError(f"{path} has no output '{name}'; outputs are {', '.join(known)}.")
        self._constants = {t.name: numpy_helper.to_array(t) for t in graph.initializer}
        maker = {name: node for node in graph.node for name in node.output}
        needed = _needed(self.outputs, maker)
        self._nodes = [_Node(node, path) for node in graph.node if set(node.output) & needed]
        self.inputs = tuple(
            value.name
            for value in graph.input
            if value.name in needed and value.name not in self._constants
        )
        self.shapes = {
            value.name: tuple(d.dim_value for d in value.type.tensor_type.shape.dim)
            for value in graph.input
        }

    def __call__(self, feeds: Mapping[str, Array]) -> list[Array]:
        """Return the outputs; inputs that they do not need may be missing."""
        values: dict[str, Any] = dict(self._constants)
        values.update({name: feeds[name] for name in self.inputs})
        values[""] = None
        for node in self._nodes:
            results = node.run([values[name] for name in node.inputs])
            values.update(zip(node.outputs, results, strict=False))
        return [values[name] for name in self.outputs]


def _needed(outputs: Sequence[str], maker: Mapping[str, Any]) -> set[str]:
    needed: set[str] = set()
    todo = list(outputs)
    while todo:
        name = todo.pop()
        if name in needed:
            continue
        needed.add(name)
        if name in maker:
            todo.extend(maker[name].input)
    return needed


class _Node:
    """One operator with its attributes."""

    def __init__(self, node: Any, path: Path) -> None:
        self.inputs, self.outputs = tuple(node.input), tuple(node.output)
        self._attributes = {a.name: helper.get_attribute_value(a) for a in node.attribute}
        self._where = f"{path}, node '{node.name or node.output[0]}' ({node.op_type})"
        if node.op_type not in OPERATORS or node.domain not in ("", "ai.onnx"):
            raise SimError(
                f"The JAX engine cannot evaluate the operator {node.op_type} ({self._where}); "
                f"supported are {', '.join(sorted(OPERATORS))}."
            )
        self._operator = OPERATORS[node.op_type]

    def run(self, inputs: Sequence[Any]) -> Sequence[Any]:
        try:
            result = self._operator(self._attributes, *inputs)
        except (jax.errors.TracerArrayConversionError, TypeError, ValueError) as error:
            raise SimError(
                f"The JAX engine cannot evaluate {self._where}: {str(error).splitlines()[0]}"
            ) from error
        return result if isinstance(result, list | tuple) else [result]


# ---------------------------------------------------------------------- operators


def _static(value: Any) -> tuple[int, ...]:
    """Return integers that must be known before anything runs."""
    return tuple(int(v) for v in np.asarray(value).reshape(-1))


def _xp(*values: Any) -> Any:
    """Return numpy while everything is constant, else jax.numpy."""
    return np if all(isinstance(v, np.ndarray | np.generic) for v in values) else jnp


def _gemm(a: Attributes, x: Array, w: Array, c: Array = None) -> Array:
    left = x.T if a.get("transA", 0) else x
    right = w.T if a.get("transB", 0) else w
    result = left @ right
    if a.get("alpha", 1.0) != 1.0:
        result = a["alpha"] * result
    return result if c is None else result + a.get("beta", 1.0) * c


def _reshape(a: Attributes, x: Array, shape: Array) -> Array:
    wanted = list(_static(shape))
    if not a.get("allowzero", 0):
        wanted = [x.shape[i] if s == 0 else s for i, s in enumerate(wanted)]
    return x.reshape(wanted)


def _split(a: Attributes, x: Array, sizes: Array = None) -> list[Array]:
    axis = a.get("axis", 0)
    given = sizes if sizes is not None else a.get("split")
    if given is None:
        count = a.get("num_outputs", 2)
        return list(_xp(x).array_split(x, count, axis=axis))
    cuts = np.cumsum(_static(given))[:-1].tolist()
    return list(_xp(x).split(x, cuts, axis=axis))


def _slice(
    a: Attributes,
    x: Array,
    starts: Array = None,
    ends: Array = None,
    axes: Array = None,
    steps: Array = None,
) -> Array:
    begin = _static(a["starts"] if starts is None else starts)
    end = _static(a["ends"] if ends is None else ends)
    given = a.get("axes") if axes is None else axes
    over = tuple(range(len(begin))) if given is None else _static(given)
    step = (1,) * len(begin) if steps is None else _static(steps)
    cut = [slice(None)] * x.ndim
    for axis, b, e, s in zip(over, begin, end, step, strict=True):
        cut[axis] = slice(b, None if abs(e) > 2**31 else e, s)
    return x[tuple(cut)]


def _axes_of(a: Attributes, axes: Array) -> tuple[int, ...] | None:
    given = a.get("axes") if axes is None else axes
    return None if given is None else _static(given)


def _unsqueeze(a: Attributes, x: Array, axes: Array = None) -> Array:
    found = _axes_of(a, axes)
    return _xp(x).expand_dims(x, found)


def _squeeze(a: Attributes, x: Array, axes: Array = None) -> Array:
    return _xp(x).squeeze(x, _axes_of(a, axes))


def _clip(a: Attributes, x: Array, low: Array = None, high: Array = None) -> Array:
    low = a.get("min") if low is None else low
    high = a.get("max") if high is None else high
    return _xp(x).clip(x, low, high)


def _cast(a: Attributes, x: Array) -> Array:
    dtype = np.dtype(helper.tensor_dtype_to_np_dtype(a["to"]))
    if dtype == np.float64 and not isinstance(x, np.ndarray):
        dtype = np.dtype(np.float32)
    if dtype == np.int64 and not isinstance(x, np.ndarray):
        dtype = np.dtype(np.int32)
    return x.astype(dtype)


def _gather(a: Attributes, x: Array, indices: Array) -> Array:
    axis = a.get("axis", 0)
    xp = _xp(x, indices)
    wrapped = xp.where(indices < 0, indices + x.shape[axis], indices)
    return xp.take(x, wrapped, axis=axis)


def _reduce(name: str) -> Operator:
    def run(a: Attributes, x: Array, axes: Array = None) -> Array:
        keep = bool(a.get("keepdims", 1))
        return getattr(_xp(x), name)(x, axis=_axes_of(a, axes), keepdims=keep)

    return run


def _layer_norm(a: Attributes, x: Array, scale: Array, bias: Array = None) -> Array:
    axes = tuple(range(a.get("axis", -1) % x.ndim, x.ndim))
    mean = jnp.mean(x, axis=axes, keepdims=True)
    off = x - mean
    variance = jnp.mean(off * off, axis=axes, keepdims=True)
    result = off / jnp.sqrt(variance + a.get("epsilon", 1e-5)) * scale
    return result if bias is None else result + bias


def _many(name: str) -> Operator:
    def run(a: Attributes, first: Array, *others: Array) -> Array:
        for other in others:
            first = getattr(_xp(first, other), name)(first, other)
        return first

    return run


def _mod(a: Attributes, x: Array, y: Array) -> Array:
    xp = _xp(x, y)
    return xp.fmod(x, y) if a.get("fmod", 0) else xp.mod(x, y)


def _constant(a: Attributes) -> Array:
    for key in ("value", "value_float", "value_int", "value_floats", "value_ints"):
        if key in a:
            value = a[key]
            if key == "value":
                return numpy_helper.to_array(value)
            dtype = np.float32 if "float" in key else np.int64
            return np.asarray(value, dtype)
    raise SimError(f"A Constant with {', '.join(a) or 'no attribute'} is not supported.")


def _unary(function: str) -> Operator:
    return lambda a, x: getattr(_xp(x), function)(x)


OPERATORS: Mapping[str, Operator] = {
    "Add": lambda a, x, y: x + y,
    "Sub": lambda a, x, y: x - y,
    "Mul": lambda a, x, y: x * y,
    "Div": lambda a, x, y: x / y,
    "Pow": lambda a, x, y: x**y,
    "Mod": _mod,
    "Neg": lambda a, x: -x,
    "MatMul": lambda a, x, y: x @ y,
    "Gemm": _gemm,
    "Identity": lambda a, x: x,
    "Relu": lambda a, x: jax.nn.relu(x),
    "LeakyRelu": lambda a, x: jax.nn.leaky_relu(x, a.get("alpha", 0.01)),
    "Elu": lambda a, x: jax.nn.elu(x, a.get("alpha", 1.0)),
    "Selu": lambda a, x: jax.nn.selu(x),
    "Gelu": lambda a, x: jax.nn.gelu(x, approximate=a.get("approximate", b"none") == b"tanh"),
    "Sigmoid": lambda a, x: jax.nn.sigmoid(x),
    "Softplus": lambda a, x: jax.nn.softplus(x),
    "Softsign": lambda a, x: jax.nn.soft_sign(x),
    "Tanh": _unary("tanh"),
    "Exp": _unary("exp"),
    "Sqrt": _unary("sqrt"),
    "Abs": _unary("abs"),
    "Sin": _unary("sin"),
    "Cos": _unary("cos"),
    "Floor": _unary("floor"),
    "Min": _many("minimum"),
    "Max": _many("maximum"),
    "Where": lambda a, c, x, y: jnp.where(c, x, y),
    "Clip": _clip,
    "Cast": _cast,
    "Concat": lambda a, *x: _xp(*x).concatenate(x, axis=a["axis"]),
    "Split": _split,
    "Slice": _slice,
    "Gather": _gather,
    "Reshape": _reshape,
    "Flatten": lambda a, x: x.reshape((int(np.prod(x.shape[: a.get("axis", 1)])), -1)),
    "Transpose": lambda a, x: _xp(x).transpose(x, a.get("perm")),
    "Squeeze": _squeeze,
    "Unsqueeze": _unsqueeze,
    "Shape": lambda a, x: np.asarray(x.shape, np.int64),
    "Constant": _constant,
    "ReduceMean": _reduce("mean"),
    "ReduceSum": _reduce("sum"),
    "ReduceMax": _reduce("max"),
    "LayerNormalization": _layer_norm,
    "LSTM": lstm,
    "GRU": gru,
}
"""Operator name -> function of its attributes and inputs."""
