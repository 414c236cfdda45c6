"""The wire layout of a generated LCM class, read off its `__typenames__` and `__dimensions__`."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from downbeat import lcm_types
from downbeat.runtime.errors import DownbeatError
from downbeat.runtime.field_rules import FieldRule, rule_for


class LayoutError(DownbeatError):
    """A type that the codec does not support."""


STRUCT_CODES = MappingProxyType(
    {
        "int8_t": "b",
        "int16_t": "h",
        "int32_t": "i",
        "int64_t": "q",
        "float": "f",
        "double": "d",
        "boolean": "b",
        "byte": "B",
    }
)
"""LCM primitive -> struct format character."""

ITEM_SIZES = MappingProxyType({"b": 1, "B": 1, "h": 2, "i": 4, "q": 8, "f": 4, "d": 8})

DTYPES = MappingProxyType(
    {code: np.dtype(name) for code, name in zip("bhiqfd", ("i1", "i2", "i4", "i8", "f4", "f8"))}
)
"""struct format character -> native dtype of a decoded array."""


@dataclass(frozen=True, slots=True)
class Leaf:
    """One field of the flattened struct.

    Attributes:
        path: Attribute names from the message down, e.g. ("imu_pelvis", "quat").
        kind: "scalar", "string", "array" (fixed), "varray", "bytes" (fixed) or "vbytes".
        primitive: LCM primitive name.
        code: struct format character; "" for strings.
        count: Number of items of a fixed array or byte string; 1 otherwise.
        length_path: Path of the scalar that holds the length; varray and vbytes only.
        rule: What the field may hold.
    """

    path: tuple[str, ...]
    kind: str
    primitive: str
    code: str
    count: int
    length_path: tuple[str, ...]
    rule: FieldRule

    @property
    def name(self) -> str:
        """Dotted name for messages."""
        return ".".join(self.path)

    @property
    def is_variable(self) -> bool:
        """Whether the size on the wire depends on the value."""
        return self.kind in ("string", "varray", "vbytes")

    @property
    def size(self) -> int:
        """Bytes on the wire of a leaf of fixed size."""
        return ITEM_SIZES[self.code] * self.count


@dataclass(frozen=True)
class Layout:
    """A generated class, flattened.

    Attributes:
        type: The class.
        name: Its name.
        fingerprint: First eight bytes of every payload.
        leaves: Fields in wire order.
        structs: Path -> class of every nested struct, outer first; () is the message.
    """

    type: Any
    name: str
    fingerprint: bytes
    leaves: tuple[Leaf, ...]
    structs: dict[tuple[str, ...], Any]


def known_types() -> dict[str, Any]:
    """Return every generated class by name."""
    return {
        name: cls
        for name, cls in vars(lcm_types).items()
        if isinstance(cls, type) and hasattr(cls, "__typenames__")
    }


def layout_of(cls: Any) -> Layout:
    """Flatten a generated class.

    Raises:
        LayoutError: It uses something that Downbeat's messages do not need.
    """
    types = known_types()
    leaves: list[Leaf] = []
    structs: dict[tuple[str, ...], Any] = {}
    _flatten(cls, (), False, types, leaves, structs)
    fingerprint: bytes = cls._get_packed_fingerprint()
    return Layout(cls, cls.__name__, fingerprint, tuple(leaves), structs)


def _flatten(
    cls: Any,
    prefix: tuple[str, ...],
    nan_ok: bool,
    types: dict[str, Any],
    leaves: list[Leaf],
    structs: dict[tuple[str, ...], Any],
) -> None:
    structs[prefix] = cls
    for field, typename, dims in zip(cls.__slots__, cls.__typenames__, cls.__dimensions__):
        path = (*prefix, field)
        key = f"{cls.__name__}.{field}"
        rule = rule_for(key, nan_ok, types)
        nested = types.get(typename.rsplit(".", 1)[-1])
        if nested is None:
            leaves.append(_leaf(path, typename, dims, rule, key))
        elif dims is None:
            _flatten(nested, path, rule.nan_ok, types, leaves, structs)
        else:
            raise LayoutError(f"The codec does not support arrays of structs, as {key} is.")


def _leaf(
    path: tuple[str, ...], primitive: str, dims: list[Any] | None, rule: FieldRule, key: str
) -> Leaf:
    is_text = primitive == "string"
    if primitive not in STRUCT_CODES and not is_text:
        raise LayoutError(f"The codec knows no type {primitive!r}, as {key} is.")
    code = "" if is_text else STRUCT_CODES[primitive]
    if dims is None:
        return Leaf(path, "string" if is_text else "scalar", primitive, code, 1, (), rule)
    if len(dims) != 1 or is_text or primitive == "boolean":
        raise LayoutError(
            f"The codec supports arrays of one dimension of numbers or bytes, not {key}."
        )
    (length,) = dims
    if isinstance(length, int):
        kind = "bytes" if primitive == "byte" else "array"
        return Leaf(path, kind, primitive, code, length, (), rule)
    kind = "vbytes" if primitive == "byte" else "varray"
    return Leaf(path, kind, primitive, code, 1, (*path[:-1], str(length)), rule)
