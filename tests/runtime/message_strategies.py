"""Hypothesis strategies: valid messages of every generated type."""

import numpy as np
from hypothesis import strategies as st

from downbeat.runtime.codec_layout import DTYPES, Layout, Leaf

BITS = {"b": 8, "B": 8, "h": 16, "i": 32, "q": 64}
QUATERNIONS = ([1.0, 0.0, 0.0, 0.0], [0.5, -0.5, 0.5, 0.5], [0.0, 0.6, 0.8, 0.0])


def numbers(leaf: Leaf):
    rule = leaf.rule
    if rule.constants is not None:
        return st.sampled_from(rule.constants)
    if leaf.primitive == "boolean":
        return st.booleans()
    if leaf.code in "fd":
        width = 32 if leaf.code == "f" else 64
        low = None if rule.low is None else float(rule.low)
        high = None if rule.high is None else float(rule.high)
        if width == 32:
            low, high = inside_float32(low, high)
        unbounded_nan = rule.nan_ok and low is None and high is None
        finite = st.floats(low, high, allow_nan=unbounded_nan, allow_infinity=False, width=width)
        return st.one_of(finite, st.just(float("nan"))) if rule.nan_ok else finite
    half = 2 ** (BITS[leaf.code] - 1)
    low = -half if rule.low is None else int(rule.low)
    high = half - 1 if rule.high is None else int(rule.high)
    return st.integers(low, high)


def inside_float32(low, high):
    """Move limits that no float32 holds to the next one inside."""
    if low is not None and float(np.float32(low)) != low:
        low = float(np.nextafter(np.float32(low), np.float32(np.inf)))
    if high is not None and float(np.float32(high)) != high:
        high = float(np.nextafter(np.float32(high), np.float32(-np.inf)))
    return low, high


def leaf_values(leaf: Leaf, count: int, as_array: bool):
    if leaf.kind == "string":
        return st.text(st.characters(exclude_categories=("Cs",)), max_size=20)
    if leaf.kind in ("bytes", "vbytes"):
        return st.binary(min_size=count, max_size=count)
    if leaf.kind == "scalar":
        return numbers(leaf)
    if leaf.rule.unit_norm:
        items = st.sampled_from(QUATERNIONS)
    else:
        items = st.lists(numbers(leaf), min_size=count, max_size=count)
    if as_array:
        return items.map(lambda values: np.array(values, DTYPES[leaf.code]))
    return items


@st.composite
def messages(draw, layout: Layout, as_array: bool | None = None):
    """Draw a valid message; arrays are numpy arrays, or lists, or either."""
    if as_array is None:
        as_array = draw(st.booleans())
    msg = layout.type()
    lengths = {leaf.length_path: draw(st.integers(0, 9)) for leaf in layout.leaves}
    for leaf in layout.leaves:
        owner = msg
        for name in leaf.path[:-1]:
            owner = getattr(owner, name)
        if leaf.path in lengths:
            value = lengths[leaf.path]
        else:
            count = lengths[leaf.length_path] if leaf.length_path else leaf.count
            value = draw(leaf_values(leaf, count, as_array))
        setattr(owner, leaf.path[-1], value)
    return msg
