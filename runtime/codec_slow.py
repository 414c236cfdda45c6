"""The codec field by field: slow, and able to say which field is wrong.

The compiled functions of `codec_compile` do the same a few times faster; whatever they cannot take
in one go comes here, so this module decides what is an error and how it reads.
"""

from __future__ import annotations

import struct
from operator import attrgetter
from typing import Any, NoReturn

import numpy as np

from downbeat.runtime.codec_layout import DTYPES, ITEM_SIZES, Layout, Leaf
from downbeat.runtime.errors import DownbeatError
from downbeat.runtime.field_rules import UNIT_NORM_TOLERANCE, FieldRule

FINGERPRINT_BYTES = 8


class CodecError(DownbeatError):
    """A message that cannot be encoded, or a payload that is not a valid message.

    Attributes:
        channel: Channel or type name.
        field: Dotted field name; "" when the payload as a whole is wrong.
        value: What was found.
        valid: What would have been valid.
    """

    def __init__(self, channel: str, field: str, value: object, valid: str) -> None:
        self.channel = channel
        self.field = field
        self.value = value
        self.valid = valid
        where = f"{channel}.{field}" if field else channel
        super().__init__(f"{where} is {_short(value)}, valid is {valid}.")


def _short(value: object, limit: int = 60) -> str:
    text = repr(value)
    return text if len(text) <= limit else text[: limit - 3] + "..."


def encode_slow(layout: Layout, msg: Any) -> bytes:
    """Encode like lcm-gen, field by field; lists, tuples and arrays of any dtype are accepted.

    Raises:
        CodecError: A field has the wrong type or length.
    """
    if msg.__class__ is not layout.type:
        raise CodecError(layout.name, "", type(msg).__name__, f"an instance of {layout.name}")
    parts = [layout.fingerprint]
    for leaf in layout.leaves:
        try:
            value = attrgetter(leaf.name)(msg)
        except AttributeError:
            raise CodecError(layout.name, leaf.name, "missing", "a field of that name") from None
        try:
            parts.append(_encode_leaf(layout, leaf, value, msg))
        except (struct.error, TypeError, ValueError, OverflowError, AttributeError):
            raise CodecError(layout.name, leaf.name, value, _valid_type(leaf)) from None
    return b"".join(parts)


def _valid_type(leaf: Leaf) -> str:
    if leaf.kind in ("array", "varray"):
        return f"{leaf.primitive} numbers"
    if leaf.kind in ("bytes", "vbytes"):
        return "bytes"
    return f"a {leaf.primitive}"


def _encode_leaf(layout: Layout, leaf: Leaf, value: Any, msg: Any) -> bytes:
    if leaf.kind == "scalar":
        return struct.pack(">" + leaf.code, value)
    if leaf.kind == "string":
        text: bytes = value.encode("utf-8")
        return struct.pack(">I", len(text) + 1) + text + b"\0"
    count = leaf.count
    if leaf.length_path:
        count = attrgetter(".".join(leaf.length_path))(msg)
    if leaf.kind in ("bytes", "vbytes"):
        data = bytes(memoryview(value))
        if leaf.kind == "bytes" and not data:
            # An unset byte[N] is b"" in the generated class and would encode N bytes short.
            return bytes(count)
    else:
        numbers = value.tolist() if isinstance(value, np.ndarray) else list(value)
        if len(numbers) == count:
            return struct.pack(f">{count}{leaf.code}", *numbers)
        data = bytes(len(numbers))
    if len(data) != count:
        raise CodecError(layout.name, leaf.name, f"{len(data)} items long", f"{count} items")
    return data


def decode_slow(layout: Layout, payload: Any, channel: str) -> dict[tuple[str, ...], Any]:
    """Decode and check field by field.

    Returns:
        Path of every leaf -> its value.

    Raises:
        CodecError: The first thing that is wrong with the payload.
    """
    try:
        data = bytes(memoryview(payload))
    except TypeError:
        raise CodecError(channel, "", type(payload).__name__, "bytes") from None
    if data[:FINGERPRINT_BYTES] != layout.fingerprint:
        raise CodecError(
            channel,
            "fingerprint",
            data[:FINGERPRINT_BYTES].hex(),
            f"{layout.fingerprint.hex()} ({layout.name})",
        )
    values: dict[tuple[str, ...], Any] = {}
    offset = FINGERPRINT_BYTES
    for leaf in layout.leaves:
        values[leaf.path], offset = _decode_leaf(leaf, data, offset, values, channel)
        _check_value(leaf, values[leaf.path], channel)
    if offset != len(data):
        raise CodecError(channel, "", f"{len(data)} bytes long", f"{offset} bytes")
    return values


def _decode_leaf(
    leaf: Leaf, data: bytes, offset: int, values: dict[tuple[str, ...], Any], channel: str
) -> tuple[Any, int]:
    count = leaf.count
    start = offset
    if leaf.length_path:
        count = values[leaf.length_path]
    elif leaf.kind == "string":
        if offset + 4 > len(data):
            _too_short(leaf, data, offset + 5, channel)
        (count,) = struct.unpack_from(">I", data, offset)
        start = offset + 4
    if count < (1 if leaf.kind == "string" else 0):
        raise CodecError(channel, leaf.name, f"{count} items long", "0 items or more")
    end = start + count * (ITEM_SIZES[leaf.code] if leaf.code else 1)
    if end > len(data):
        _too_short(leaf, data, end, channel)
    if leaf.kind == "scalar":
        return struct.unpack_from(">" + leaf.code, data, start)[0], end
    if leaf.kind == "string":
        return _decode_text(leaf, data[start:end], channel), end
    if leaf.kind in ("bytes", "vbytes"):
        return data[start:end], end
    dtype = DTYPES[leaf.code]
    return np.frombuffer(data, dtype.newbyteorder(">"), count, start).astype(dtype), end


def _too_short(leaf: Leaf, data: bytes, end: int, channel: str) -> NoReturn:
    raise CodecError(channel, leaf.name, f"cut off after {len(data)} bytes", f"{end} bytes or more")


def _decode_text(leaf: Leaf, data: bytes, channel: str) -> str:
    if data[-1] != 0:
        raise CodecError(channel, leaf.name, data, "text that ends with a zero byte")
    try:
        return data[:-1].decode("utf-8")
    except UnicodeDecodeError:
        raise CodecError(channel, leaf.name, data, "UTF-8 text") from None


def _check_value(leaf: Leaf, value: Any, channel: str) -> None:
    if leaf.primitive == "boolean" and value not in (0, 1):
        raise CodecError(channel, leaf.name, value, "0 or 1")
    if leaf.kind in ("string", "bytes", "vbytes"):
        return
    if leaf.kind == "scalar":
        if not _number_ok(leaf, value):
            raise CodecError(channel, leaf.name, value, leaf.rule.describe())
        return
    for index, number in enumerate(value.tolist()):
        if not _number_ok(leaf, number):
            raise CodecError(channel, f"{leaf.name}[{index}]", number, leaf.rule.describe())
    if leaf.rule.unit_norm:
        norm = sum(number * number for number in value.tolist())
        if abs(norm - 1.0) > UNIT_NORM_TOLERANCE:
            raise CodecError(channel, leaf.name, value.tolist(), leaf.rule.describe())


def _number_ok(leaf: Leaf, number: float) -> bool:
    rule: FieldRule = leaf.rule
    if rule.constants is not None:
        return number in rule.constants
    if number != number:
        return rule.nan_ok
    is_float = leaf.code in "fd"
    if is_float and abs(number) == float("inf"):
        return False
    return rule.low_value <= number <= rule.high_value
