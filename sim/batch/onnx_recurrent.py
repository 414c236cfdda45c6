"""LSTM and GRU as ONNX defines them, one layer, one direction, in JAX."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

Array = Any


def _check(a: Mapping[str, Any], known: str) -> None:
    direction = a.get("direction", b"forward")
    if direction not in (b"forward", "forward"):
        raise ValueError(f"direction {direction!r} is not supported; forward is")
    if "activations" in a and [v.decode() for v in a["activations"]] != known.split():
        raise ValueError(f"activations other than {known} are not supported")
    if a.get("layout", 0):
        raise ValueError("layout 1 is not supported; 0 is")


def lstm(
    a: Mapping[str, Any],
    x: Array,
    w: Array,
    r: Array,
    bias: Array = None,
    lengths: Array = None,
    h0: Array = None,
    c0: Array = None,
    peephole: Array = None,
) -> list[Array]:
    """Return Y (T, 1, N, H), Y_h (1, N, H), Y_c (1, N, H).

    Args:
        a: Attributes.
        x: (T, N, in).
        w: (1, 4 H, in), gates in the order input, output, forget, cell.
        r: (1, 4 H, H).
        bias: (1, 8 H); None: zeros.
        lengths: Not supported.
        h0: (1, N, H); None: zeros.
        c0: (1, N, H); None: zeros.
        peephole: Not supported.
    """
    _check(a, "Sigmoid Tanh Tanh")
    if peephole is not None:
        raise ValueError("peepholes are not supported")
    hidden = a["hidden_size"]
    both = 0.0 if bias is None else bias[0][: 4 * hidden] + bias[0][4 * hidden :]
    zeros = jnp.zeros((x.shape[1], hidden), x.dtype)
    start = (zeros if h0 is None else h0[0], zeros if c0 is None else c0[0])

    def step(state: tuple[Array, Array], row: Array) -> tuple[tuple[Array, Array], Array]:
        h, c = state
        gates = row @ w[0].T + h @ r[0].T + both
        i, o, f, g = jnp.split(gates, 4, axis=-1)
        c = jax.nn.sigmoid(f) * c + jax.nn.sigmoid(i) * jnp.tanh(g)
        h = jax.nn.sigmoid(o) * jnp.tanh(c)
        return (h, c), h

    (h, c), every = jax.lax.scan(step, start, x)
    return [every[:, None], h[None], c[None]]


def gru(
    a: Mapping[str, Any],
    x: Array,
    w: Array,
    r: Array,
    bias: Array = None,
    lengths: Array = None,
    h0: Array = None,
) -> list[Array]:
    """Return Y (T, 1, N, H), Y_h (1, N, H).

    Args:
        a: Attributes.
        x: (T, N, in).
        w: (1, 3 H, in), gates in the order update, reset, hidden.
        r: (1, 3 H, H).
        bias: (1, 6 H); None: zeros.
        lengths: Not supported.
        h0: (1, N, H); None: zeros.
    """
    _check(a, "Sigmoid Tanh")
    hidden = a["hidden_size"]
    zero = jnp.zeros(6 * hidden, x.dtype)
    wb, rb = jnp.split(zero if bias is None else bias[0], 2)
    start = jnp.zeros((x.shape[1], hidden), x.dtype) if h0 is None else h0[0]
    linear_first = a.get("linear_before_reset", 0)

    def step(h: Array, row: Array) -> tuple[Array, Array]:
        wz, wr, wh = jnp.split(row @ w[0].T + wb, 3, axis=-1)
        rz, rr, rh = jnp.split(h @ r[0].T + rb, 3, axis=-1)
        z, reset = jax.nn.sigmoid(wz + rz), jax.nn.sigmoid(wr + rr)
        if linear_first:
            new = jnp.tanh(wh + reset * rh)
        else:
            new = jnp.tanh(wh + (reset * h) @ r[0][2 * hidden :].T + rb[2 * hidden :])
        h = (1.0 - z) * new + z * h
        return h, h

    h, every = jax.lax.scan(step, start, x)
    return [every[:, None], h[None]]
