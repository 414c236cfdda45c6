"""What each recorded PyTorch operation is in ONNX; shapes are fixed, the batch is one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from downbeat.policies.errors import PolicyError

Writer = Callable[[Any, Any, Any, Any], list[str]]
"""(graph, args, kwargs, result) -> names of the results."""

VIEWS = frozenset(
    {
        "view",
        "_unsafe_view",
        "reshape",
        "flatten",
        "squeeze",
        "unsqueeze",
        "alias",
        "detach",
        "clone",
        "contiguous",
        "_to_copy",
        "lift_fresh",
    }
)
"""Operations that change at most the shape."""

SHAPE_ONLY = frozenset(
    {"zeros_like", "ones_like", "full_like", "new_zeros", "new_ones", "new_full", "empty_like"}
)
"""Operations whose result is a constant, because every shape is one."""


def _plain(op: str) -> Writer:
    def write(graph: Any, args: Any, kwargs: Any, result: Any) -> list[str]:
        return graph.add(op, [graph.name_of(args[0])])

    return write


def _pair(op: str, swapped: bool = False) -> Writer:
    """Two operands; `alpha` scales the second."""

    def write(graph: Any, args: Any, kwargs: Any, result: Any) -> list[str]:
        left, right = graph.name_of(args[0]), graph.name_of(args[1])
        alpha = kwargs.get("alpha", args[2] if len(args) > 2 else 1)
        if alpha != 1:
            right = graph.add("Mul", [right, graph.constant(np.float32(alpha))])[0]
        return graph.add(op, [right, left] if swapped else [left, right])

    return write


def _addmm(graph: Any, args: Any, kwargs: Any, result: Any) -> list[str]:
    names = [graph.name_of(args[1]), graph.name_of(args[2]), graph.name_of(args[0])]
    scales = {"alpha": float(kwargs.get("alpha", 1)), "beta": float(kwargs.get("beta", 1))}
    return graph.add("Gemm", names, **scales)


def _elu(graph: Any, args: Any, kwargs: Any, result: Any) -> list[str]:
    alpha, scale, inner = (*args[1:], 1, 1, 1)[:3] if len(args) < 4 else args[1:4]
    if scale != 1 or inner != 1:
        raise PolicyError("A scaled ELU is not supported; scale 1 is valid.")
    return graph.add("Elu", [graph.name_of(args[0])], alpha=float(alpha))


def _leaky_relu(graph: Any, args: Any, kwargs: Any, result: Any) -> list[str]:
    alpha = float(args[1]) if len(args) > 1 else 0.01
    return graph.add("LeakyRelu", [graph.name_of(args[0])], alpha=alpha)


def _silu(graph: Any, args: Any, kwargs: Any, result: Any) -> list[str]:
    name = graph.name_of(args[0])
    return graph.add("Mul", [name, graph.add("Sigmoid", [name])[0]])


def _rsqrt(graph: Any, args: Any, kwargs: Any, result: Any) -> list[str]:
    return graph.add("Reciprocal", graph.add("Sqrt", [graph.name_of(args[0])]))


def _clamp(graph: Any, args: Any, kwargs: Any, result: Any) -> list[str]:
    low, high = (*args[1:3], None, None)[:2]
    bounds = (kwargs.get("min", low), kwargs.get("max", high))
    names = [
        "" if b is None else graph.constant(np.float32(b.item() if hasattr(b, "item") else b))
        for b in bounds
    ]
    return graph.add("Clip", [graph.name_of(args[0]), *names])


def _transposed(order: Callable[[Any, int], list[int]]) -> Writer:
    def write(graph: Any, args: Any, kwargs: Any, result: Any) -> list[str]:
        perm = order(args, args[0].dim())
        return graph.add("Transpose", [graph.name_of(args[0])], perm=perm)

    return write


def _swap(args: Any, rank: int) -> list[int]:
    a, b = (args[1] % rank, args[2] % rank) if len(args) > 2 else (0, rank - 1)
    perm = list(range(rank))
    perm[a], perm[b] = b, a
    return perm


def _cat(graph: Any, args: Any, kwargs: Any, result: Any) -> list[str]:
    axis = int(kwargs.get("dim", args[1] if len(args) > 1 else 0))
    names = [graph.name_of(part) for part in args[0] if part.numel()]
    return graph.add("Concat", names, axis=axis % result.dim())


def _split(graph: Any, args: Any, kwargs: Any, result: Any) -> list[str]:
    axis = int(kwargs.get("dim", args[2] if len(args) > 2 else 0)) % args[0].dim()
    sizes = graph.constant(np.asarray([part.shape[axis] for part in result], np.int64))
    return graph.add("Split", [graph.name_of(args[0]), sizes], outputs=len(result), axis=axis)


def _unbind(graph: Any, args: Any, kwargs: Any, result: Any) -> list[str]:
    axis = int(kwargs.get("dim", args[1] if len(args) > 1 else 0)) % args[0].dim()
    name = graph.name_of(args[0])
    positions = [graph.constant(np.asarray(k, np.int64)) for k in range(len(result))]
    return [graph.add("Gather", [name, k], axis=axis)[0] for k in positions]


def _stack(graph: Any, args: Any, kwargs: Any, result: Any) -> list[str]:
    axis = int(kwargs.get("dim", args[1] if len(args) > 1 else 0)) % result.dim()
    axes = graph.constant(np.asarray([axis], np.int64))
    parts = [graph.add("Unsqueeze", [graph.name_of(part), axes])[0] for part in args[0]]
    return graph.add("Concat", parts, axis=axis)


def _slice(graph: Any, args: Any, kwargs: Any, result: Any) -> list[str]:
    tensor, axis, start, end, step = (*args, *(0, None, None, 1)[len(args) - 1 :])
    axis, step = axis % tensor.dim(), step or 1
    size = tensor.shape[axis]
    first, last, _ = slice(start, end).indices(size)
    values = ([first], [max(first, last)], [axis], [step])
    names = [graph.constant(np.asarray(value, np.int64)) for value in values]
    return graph.add("Slice", [graph.name_of(tensor), *names])


def _select(graph: Any, args: Any, kwargs: Any, result: Any) -> list[str]:
    tensor, axis, index = args[:3]
    axis %= tensor.dim()
    position = graph.constant(np.asarray(index % tensor.shape[axis], np.int64))
    return graph.add("Gather", [graph.name_of(tensor), position], axis=axis)


def _expand(graph: Any, args: Any, kwargs: Any, result: Any) -> list[str]:
    shape = graph.constant(np.asarray(result.shape, np.int64))
    return graph.add("Expand", [graph.name_of(args[0]), shape])


def _reduce(op: str) -> Writer:
    def write(graph: Any, args: Any, kwargs: Any, result: Any) -> list[str]:
        axes = args[1] if len(args) > 1 and args[1] is not None else list(range(args[0].dim()))
        axes = [axes] if isinstance(axes, int) else list(axes)
        keep = bool(args[2] if len(args) > 2 else kwargs.get("keepdim", False))
        name = graph.name_of(args[0])
        total = graph.add(
            "ReduceSum", [name, graph.constant(np.asarray(axes, np.int64))], keepdims=int(keep)
        )
        if op == "sum":
            return total
        count = np.prod([args[0].shape[axis] for axis in axes])
        return graph.add("Div", [total[0], graph.constant(np.float32(count))])

    return write


def _softmax(graph: Any, args: Any, kwargs: Any, result: Any) -> list[str]:
    return graph.add("Softmax", [graph.name_of(args[0])], axis=int(args[1]) % args[0].dim())


def _layer_norm(graph: Any, args: Any, kwargs: Any, result: Any) -> list[str]:
    tensor, shape, weight, bias, epsilon = args[:5]
    ones = np.ones(tuple(shape), np.float32)
    names = [
        graph.name_of(tensor),
        graph.constant(ones) if weight is None else graph.name_of(weight),
        graph.constant(0.0 * ones) if bias is None else graph.name_of(bias),
    ]
    axis = tensor.dim() - len(shape)
    return graph.add("LayerNormalization", names, axis=axis, epsilon=float(epsilon))


def _batch_norm(graph: Any, args: Any, kwargs: Any, result: Any) -> list[str]:
    tensor, weight, bias, mean, variance = args[:5]
    if len(args) == 8 and args[5]:
        raise PolicyError("Batch normalisation in training mode is not supported.")
    names = [graph.name_of(part) for part in (tensor, weight, bias, mean, variance)]
    return graph.add("BatchNormalization", names, epsilon=float(args[-1]))


def _convolution(graph: Any, args: Any, kwargs: Any, result: Any) -> list[str]:
    tensor, weight, bias, stride, padding, dilation, transposed, _, groups = args[:9]
    if transposed:
        raise PolicyError("A transposed convolution is not supported.")
    names = [graph.name_of(part) for part in (tensor, weight, bias) if part is not None]
    return graph.add(
        "Conv",
        names,
        strides=list(stride),
        pads=[*padding, *padding],
        dilations=list(dilation),
        group=int(groups),
    )


OPS: Mapping[str, Writer] = {
    "add": _pair("Add"),
    "sub": _pair("Sub"),
    "rsub": _pair("Sub", swapped=True),
    "mul": _pair("Mul"),
    "div": _pair("Div"),
    "pow": _pair("Pow"),
    "maximum": _pair("Max"),
    "minimum": _pair("Min"),
    "mm": _pair("MatMul"),
    "bmm": _pair("MatMul"),
    "matmul": _pair("MatMul"),
    "addmm": _addmm,
    "elu": _elu,
    "leaky_relu": _leaky_relu,
    "silu": _silu,
    "relu": _plain("Relu"),
    "tanh": _plain("Tanh"),
    "sigmoid": _plain("Sigmoid"),
    "exp": _plain("Exp"),
    "sqrt": _plain("Sqrt"),
    "abs": _plain("Abs"),
    "neg": _plain("Neg"),
    "sin": _plain("Sin"),
    "cos": _plain("Cos"),
    "rsqrt": _rsqrt,
    "clamp": _clamp,
    "hardtanh": _clamp,
    "t": _transposed(_swap),
    "transpose": _transposed(_swap),
    "permute": _transposed(lambda args, rank: [axis % rank for axis in args[1]]),
    "cat": _cat,
    "split": _split,
    "split_with_sizes": _split,
    "unsafe_split": _split,
    "chunk": _split,
    "unsafe_chunk": _split,
    "unbind": _unbind,
    "stack": _stack,
    "slice": _slice,
    "select": _select,
    "expand": _expand,
    "sum": _reduce("sum"),
    "mean": _reduce("mean"),
    "_softmax": _softmax,
    "native_layer_norm": _layer_norm,
    "native_batch_norm": _batch_norm,
    "_native_batch_norm_legit_no_training": _batch_norm,
    "convolution": _convolution,
    "_convolution": _convolution,
}
