"""The ONNX graph of a BERT sentence encoder (post-norm, exact GELU, mean pooling) from its weights.

Source: Devlin et al. 2019, BERT; Reimers and Gurevych 2019, Sentence-BERT (mean pooling).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from onnx import TensorProto, helper, numpy_helper

HEAD_DIM = 32
LAYER_NORM_EPS = 1e-12
OPSET = 20
"""The first one with GELU."""
MASKED = np.float32(1e9)


class _Graph:
    """Nodes and constants in the making."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def const(self, value: npt.ArrayLike, dtype: Any = np.float32) -> str:
        name = f"c{len(self.constants)}"
        array = np.ascontiguousarray(np.asarray(value, dtype))
        self.constants.append(numpy_helper.from_array(array, name))
        return name

    def op(self, kind: str, *inputs: str, **attributes: Any) -> str:
        name = f"n{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, list(inputs), [name], **attributes))
        return name


def bert_graph(weights: Mapping[str, npt.NDArray[np.float32]], head_dim: int = HEAD_DIM) -> bytes:
    """Return the serialised model: `ids` int64 (n, t), `mask` float32 (n, t) -> units (n, dim).

    Args:
        weights: Names as in Hugging Face's BertModel.
        head_dim: Size of an attention head.
    """
    g = _Graph()
    words = g.op("Gather", g.const(weights["embeddings.word_embeddings.weight"]), "ids")
    # Every token is of type 0: its row is the same for all and goes into the positions.
    positions = (
        weights["embeddings.position_embeddings.weight"]
        + weights["embeddings.token_type_embeddings.weight"][0]
    )
    length = g.op("Shape", "ids", start=1, end=2)
    start, axis = g.const([0], np.int64), g.const([0], np.int64)
    x = g.op("Add", words, g.op("Slice", g.const(positions), start, length, axis))
    x = _norm(g, x, weights, "embeddings.LayerNorm")
    hidden = g.op("Mul", g.op("Sub", g.const(1.0), "mask"), g.const(-MASKED))
    bias = g.op("Unsqueeze", hidden, g.const([1, 2], np.int64))  # (n, 1, 1, t)
    layer = 0
    while f"encoder.layer.{layer}.output.dense.weight" in weights:
        x = _layer(g, x, bias, weights, f"encoder.layer.{layer}.", head_dim)
        layer += 1
    weight = g.op("Unsqueeze", "mask", g.const([2], np.int64))  # (n, t, 1)
    total = g.op("ReduceSum", g.op("Mul", x, weight), g.const([1], np.int64), keepdims=0)
    g.nodes.append(
        helper.make_node("LpNormalization", [total], ["vectors"], axis=1, p=2)
    )  # a mean and a sum point the same way
    graph = helper.make_graph(
        g.nodes,
        "sentence",
        [
            helper.make_tensor_value_info("ids", TensorProto.INT64, ["n", "t"]),
            helper.make_tensor_value_info("mask", TensorProto.FLOAT, ["n", "t"]),
        ],
        [helper.make_tensor_value_info("vectors", TensorProto.FLOAT, ["n", "dim"])],
        g.constants,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=10)
    serialised: bytes = model.SerializeToString()
    return serialised


def _linear(g: _Graph, x: str, weights: Mapping[str, Any], name: str) -> str:
    return g.op(
        "Add",
        g.op("MatMul", x, g.const(weights[name + ".weight"].T)),
        g.const(weights[name + ".bias"]),
    )


def _norm(g: _Graph, x: str, weights: Mapping[str, Any], name: str) -> str:
    gain, shift = g.const(weights[name + ".weight"]), g.const(weights[name + ".bias"])
    return g.op("LayerNormalization", x, gain, shift, epsilon=LAYER_NORM_EPS)


def _layer(g: _Graph, x: str, bias: str, weights: Mapping[str, Any], at: str, head_dim: int) -> str:
    split = g.const([0, 0, -1, head_dim], np.int64)

    def heads(name: str, perm: list[int]) -> str:
        value = _linear(g, x, weights, f"{at}attention.self.{name}")
        return g.op("Transpose", g.op("Reshape", value, split), perm=perm)

    query, key = heads("query", [0, 2, 1, 3]), heads("key", [0, 2, 3, 1])
    scores = g.op("Mul", g.op("MatMul", query, key), g.const(1.0 / math.sqrt(head_dim)))
    attention = g.op("Softmax", g.op("Add", scores, bias), axis=-1)
    mixed = g.op("MatMul", attention, heads("value", [0, 2, 1, 3]))
    joined = g.op(
        "Reshape", g.op("Transpose", mixed, perm=[0, 2, 1, 3]), g.const([0, 0, -1], np.int64)
    )
    out = _linear(g, joined, weights, at + "attention.output.dense")
    x = _norm(g, g.op("Add", x, out), weights, at + "attention.output.LayerNorm")
    wide = g.op("Gelu", _linear(g, x, weights, at + "intermediate.dense"))
    out = _linear(g, wide, weights, at + "output.dense")
    return _norm(g, g.op("Add", x, out), weights, at + "output.LayerNorm")
