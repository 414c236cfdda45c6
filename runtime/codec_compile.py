"""Compile a layout into two straight-line Python functions, `encode` and `decode`.

As `dataclasses` does, the source is written as text and executed: no loop over fields is left at
run time. For g1_low_state_t that is several times faster than the generated class. Whatever does
not fit (a list instead of an array, a bad value) is handed to `codec_slow`, which decides.
The source of a codec can be read: `print(codec_for(type).source)`.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from downbeat.runtime.codec_layout import DTYPES, ITEM_SIZES, Layout, Leaf
from downbeat.runtime.codec_runs import Block, Run, runs_of
from downbeat.runtime.field_rules import (
    MAX_FLOAT32,
    MAX_FLOAT64,
    UNIT_NORM_TOLERANCE,
    FieldRule,
)

# The gather tables swap bytes: native items must be little-endian.
IS_SUPPORTED_MACHINE = sys.byteorder == "little"

Encode = Callable[[Any], bytes]
Decode = Callable[[Any], Any]


class Source:
    """Lines of a function and the constants that they name."""

    def __init__(self, layout: Layout) -> None:
        self.lines: list[str] = []
        self.constants: dict[str, Any] = {
            "CLASS": layout.type,
            "FINGERPRINT": layout.fingerprint,
            "U1": np.uint8,
            "join": b"".join,
            "frombuffer": np.frombuffer,
            "greater_equal": np.greater_equal,
            "less_equal": np.less_equal,
            "less": np.less,
            "greater": np.greater,
        }
        self._leaf_names = {leaf.path: f"v{i}" for i, leaf in enumerate(layout.leaves)}
        self._struct_names = {path: f"m{i}" for i, path in enumerate(layout.structs)}

    def local(self, leaf: Leaf) -> str:
        """Local variable of a leaf."""
        return self._leaf_names[leaf.path]

    def owner(self, path: tuple[str, ...]) -> str:
        """Local variable of the struct at `path`."""
        return self._struct_names[path]

    def constant(self, name: str, value: Any) -> str:
        """Bind a constant and return its name."""
        self.constants[name] = value
        return name

    def dtype(self, code: str) -> str:
        """Name of the native dtype of a struct code."""
        return self.constant("DTYPE_" + code, DTYPES[code])

    def add(self, *lines: str) -> None:
        """Append lines of the function's body."""
        self.lines.extend("    " + line for line in lines)

    def compile(self, signature: str) -> tuple[Callable[..., Any], str]:
        """Return the function and its text."""
        text = f"def {signature}:\n" + "\n".join(self.lines) + "\n"
        namespace = dict(self.constants)
        exec(compile(text, f"<codec {signature}>", "exec"), namespace)
        function: Callable[..., Any] = namespace[signature.split("(")[0]]
        return function, text


def compile_encode(layout: Layout, slow: Callable[[Any], bytes]) -> tuple[Encode, str]:
    """Build `encode(msg) -> bytes`; `slow` takes what the fast lines cannot."""
    source = Source(layout)
    source.constant("slow", slow)
    source.add("if msg.__class__ is not CLASS: return slow(msg)")
    for path in layout.structs:
        if path:
            source.add(f"{source.owner(path)} = {source.owner(path[:-1])}.{path[-1]}")
            class_name = source.constant(f"CLASS_{source.owner(path)}", layout.structs[path])
            source.add(f"if {source.owner(path)}.__class__ is not {class_name}: return slow(msg)")
        else:
            source.add(f"{source.owner(path)} = msg")
    parts: list[str] = []
    for index, run in enumerate(runs_of(layout)):
        parts.extend(_encode_run(source, run, index))
    source.add(f"return join(({', '.join(parts)},))" if len(parts) > 1 else f"return {parts[0]}")
    return source.compile("encode(msg)")


def _encode_run(source: Source, run: Run, index: int) -> list[str]:
    """Add the lines of one run; return the expressions of its bytes."""
    for leaf in run.fixed:
        if leaf.kind == "array":
            shape = source.constant(f"SHAPE_{leaf.count}", (leaf.count,))
            name = source.local(leaf)
            source.add(
                f"{name} = {_attribute(source, leaf)}",
                f"if {name}.dtype is not {source.dtype(leaf.code)} or {name}.shape != {shape}: "
                "return slow(msg)",
            )
        elif leaf.kind == "bytes":
            name = source.local(leaf)
            source.add(
                f"{name} = {_attribute(source, leaf)}",
                f"if len({name}) != {leaf.count}: return slow(msg)",
            )
    arguments = ["FINGERPRINT"] if run.is_first else []
    for leaf in run.scalars:
        is_local = leaf.kind == "bytes"
        arguments.append(source.local(leaf) if is_local else _attribute(source, leaf))
    after: list[str] = []
    if run.variable is not None:
        after = _encode_variable(source, run.variable)
        if run.has_text:
            arguments.append(f"len({source.local(run.variable)}) + 1")
    if not arguments and not run.arrays:
        return after
    packer = struct.Struct(run.struct_format(padded=False))
    packed = f"{source.constant(f'pack{index}', packer.pack)}({', '.join(arguments)})"
    if run.arrays:
        gather = source.constant(f"GATHER{index}", run.encode_gather())
        names = ", ".join(source.local(leaf) for leaf in run.arrays)
        packed = f"frombuffer(join(({packed}, {names})), U1).take({gather}).tobytes()"
    return [packed, *after]


def _encode_variable(source: Source, leaf: Leaf) -> list[str]:
    name = source.local(leaf)
    if leaf.kind == "string":
        source.add(f"{name} = {_attribute(source, leaf)}.encode()")
        return [name, source.constant("ZERO", b"\0")]
    length = f"{source.owner(leaf.length_path[:-1])}.{leaf.length_path[-1]}"
    source.add(f"{name} = {_attribute(source, leaf)}")
    if leaf.kind == "vbytes":
        source.add(f"if len({name}) != {length}: return slow(msg)")
        return [name]
    big_endian = source.constant(f"BIG_{leaf.code}", DTYPES[leaf.code].newbyteorder(">"))
    source.add(
        f"if {name}.dtype is not {source.dtype(leaf.code)} or {name}.shape != ({length},): "
        "return slow(msg)"
    )
    return [f"{name}.astype({big_endian}).tobytes()"]


def _attribute(source: Source, leaf: Leaf) -> str:
    return f"{source.owner(leaf.path[:-1])}.{leaf.path[-1]}"


def compile_decode(layout: Layout, bad: Callable[[], Any]) -> tuple[Decode, str]:
    """Build `decode(payload) -> msg`, which calls `bad()` (and it raises) for a bad payload."""
    source = Source(layout)
    source.constant("bad", bad)
    runs = runs_of(layout)
    is_fixed = len(runs) == 1 and runs[0].variable is None
    if is_fixed:
        source.add(f"if len(payload) != {runs[0].size}: bad()")
    else:
        source.add("size = len(payload)", "offset = 0")
    for index, run in enumerate(runs):
        _decode_run(source, run, index, is_fixed)
    if not is_fixed:
        source.add("if offset != size: bad()")
    _build_message(source, layout)
    return source.compile("decode(payload)")


def _decode_run(source: Source, run: Run, index: int, is_fixed: bool) -> None:
    names = ["fingerprint"] if run.is_first else []
    names += [source.local(leaf) for leaf in run.scalars]
    names += ["length"] if run.has_text else []
    if names:
        unpacker = struct.Struct(run.struct_format(padded=True))
        unpack = source.constant(f"unpack{index}", unpacker.unpack_from)
        where = "payload" if is_fixed else "payload, offset"
        source.add(f"({', '.join(names)},) = {unpack}({where})")
    if run.is_first:
        source.add("if fingerprint != FINGERPRINT: bad()")
    if run.arrays:
        gather = source.constant(f"GATHER{index}", run.decode_gather())
        where = "payload, U1" if is_fixed else f"payload, U1, {run.size}, offset"
        source.add(f"gathered = frombuffer({where}).take({gather})")
        for block in run.blocks():
            _decode_block(source, block, f"{index}_{block.start}")
    if not is_fixed and run.size:
        source.add(f"offset += {run.size}")
    for leaf in run.scalars:
        _check_scalar(source, leaf)
    if run.variable is not None:
        _decode_variable(source, run.variable)


def _decode_block(source: Source, block: Block, suffix: str) -> None:
    """Slice the arrays of one block and check them all with two comparisons."""
    dtype = source.dtype(block.code)
    source.add(f"block = gathered[{block.start}:{block.end}].view({dtype})")
    start = 0
    for leaf in block.leaves:
        source.add(f"{source.local(leaf)} = block[{start}:{start + leaf.count}]")
        start += leaf.count
    is_float = block.code in "fd"
    has_rule = any(leaf.rule.low is not None or leaf.rule.high is not None for leaf in block.leaves)
    if not is_float and not has_rule:
        return
    limits = [_limits(leaf.rule, leaf.code) for leaf in block.leaves for _ in range(leaf.count)]
    low = source.constant(f"LOW{suffix}", np.array([x[0] for x in limits], DTYPES[block.code]))
    high = source.constant(f"HIGH{suffix}", np.array([x[1] for x in limits], DTYPES[block.code]))
    if block.nan_ok:
        # NaN compares false, so it is neither below nor above.
        source.add(
            f"if 1 in less(block, {low}).tobytes() or 1 in greater(block, {high}).tobytes(): bad()"
        )
    else:
        source.add(
            f"if 0 in greater_equal(block, {low}).tobytes() "
            f"or 0 in less_equal(block, {high}).tobytes(): bad()"
        )
    for leaf in block.leaves:
        if leaf.rule.unit_norm:
            source.add(
                f"a, b, c, d = {source.local(leaf)}.tolist()",
                f"if abs(a * a + b * b + c * c + d * d - 1.0) > {UNIT_NORM_TOLERANCE}: bad()",
            )


def _limits(rule: FieldRule, code: str) -> tuple[float, float]:
    if code in "fd":
        largest = MAX_FLOAT32 if code == "f" else MAX_FLOAT64
        return max(rule.low_value, -largest), min(rule.high_value, largest)
    largest_int = 2 ** (8 * ITEM_SIZES[code] - 1) - 1
    return max(rule.low_value, -largest_int - 1), min(rule.high_value, largest_int)


def _check_scalar(source: Source, leaf: Leaf) -> None:
    name, rule = source.local(leaf), leaf.rule
    if leaf.kind == "bytes":
        return
    if leaf.primitive == "boolean":
        source.add(f"if {name} != 0 and {name} != 1: bad()", f"{name} = {name} == 1")
    elif rule.constants is not None:
        source.add(f"if {name} not in {rule.constants!r}: bad()")
    elif leaf.code in "fd":
        low, high = _limits(rule, leaf.code)
        if rule.nan_ok:
            source.add(f"if {name} < {low!r} or {name} > {high!r}: bad()")
        else:
            source.add(f"if not {low!r} <= {name} <= {high!r}: bad()")
    elif rule.low is not None or rule.high is not None:
        low_text = "" if rule.low is None else f"{rule.low:.0f} <= "
        high_text = "" if rule.high is None else f" <= {rule.high:.0f}"
        source.add(f"if not {low_text}{name}{high_text}: bad()")


def _decode_variable(source: Source, leaf: Leaf) -> None:
    name = source.local(leaf)
    if leaf.kind == "string":
        source.add(
            "end = offset + length",
            "if length < 1 or end > size or payload[end - 1]: bad()",
            f"{name} = payload[offset:end - 1].decode()",
            "offset = end",
        )
        return
    length = source._leaf_names[leaf.length_path]
    source.add(
        f"end = offset + {length} * {ITEM_SIZES[leaf.code]}",
        f"if {length} < 0 or end > size: bad()",
    )
    if leaf.kind == "vbytes":
        source.add(f"{name} = payload[offset:end]")
    else:
        big_endian = source.constant(f"BIG_{leaf.code}", DTYPES[leaf.code].newbyteorder(">"))
        source.add(
            f"{name} = frombuffer(payload, {big_endian}, {length}, offset)"
            f".astype({source.dtype(leaf.code)})"
        )
    source.add("offset = end")


def _build_message(source: Source, layout: Layout) -> None:
    """Make the objects without `__init__`, which would fill every array first."""
    source.constant("new", object.__new__)
    for path, cls in layout.structs.items():
        name = source.owner(path)
        source.add(f"{name} = new({source.constant(f'CLASS_{name}', cls)})")
        if path:
            source.add(f"{source.owner(path[:-1])}.{path[-1]} = {name}")
    for leaf in layout.leaves:
        source.add(f"{_attribute(source, leaf)} = {source.local(leaf)}")
    source.add(f"return {source.owner(())}")
