"""Changes to single messages: fields by path, and what bad networks do to payloads."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from downbeat.runtime.bus_types import BusError
from downbeat.runtime.errors import one_of

Damage = Literal["", "flip", "truncate", "extend", "fingerprint", "noise", "empty"]
FLIPPED_BITS = 3
MAX_NOISE_BYTES = 2000
MAX_EXTRA_BYTES = 64
_STEP = re.compile(r"(?P<name>\w+)(?:\[(?P<index>\d+)\])?")


def set_path(msg: Any, path: str, value: Any, where: str) -> None:
    """Set a field of a message.

    Args:
        msg: Message of any generated type.
        path: `field`, `struct.field`, or `field[3]` for one element of an array.
        value: What it becomes; a single number fills an array or the bytes.
        where: For messages.

    Raises:
        BusError: There is no such field or element, or it cannot hold the value.
    """
    *parents, last = path.split(".")
    for name in parents:
        msg = getattr(msg, _known(msg, name, path, where), None)
    found = _STEP.fullmatch(last)
    if found is None:
        raise BusError(f"'{path}' is not a path; valid is e.g. 'joint_pos[3]' ({where}).")
    name = _known(msg, found["name"], path, where)
    old = getattr(msg, name)
    try:
        index = None if found["index"] is None else int(found["index"])
        new = _converted(old, value) if index is None else _with_element(old, index, value)
    except (TypeError, ValueError, IndexError, OverflowError) as error:
        raise BusError(f"Field '{path}' cannot be {value!r}: {error} ({where}).") from error
    setattr(msg, name, new)


def _known(msg: Any, name: str, path: str, where: str) -> str:
    """Return the name of a field, if the message has it."""
    fields = getattr(type(msg), "__slots__", ())
    if name not in fields:
        has = f"{type(msg).__name__} has {one_of(fields)}" if fields else "it is no struct"
        raise BusError(f"There is no field '{path}'; {has} ({where}).")
    return name


def _converted(old: Any, value: Any) -> Any:
    """Return a value in the shape of the field's old one."""
    if isinstance(old, bytes):
        return bytes(_number(0, octet) for octet in _elements(old, value))
    if isinstance(old, str):
        if not isinstance(value, str):
            raise TypeError("it is text")
        return value
    if isinstance(old, np.ndarray | list | tuple):
        values = _elements(old, value)
        if isinstance(old, np.ndarray):
            return np.asarray([_number(old.dtype.type(0).item(), v) for v in values], old.dtype)
        return [_number(first, v) for first, v in zip(list(old) or values, values, strict=True)]
    return _number(old, value)


def _number(old: Any, value: Any) -> Any:
    """Return a value as the field's kind of number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError("it holds numbers")
    if not isinstance(old, int):
        return float(value)
    if value != int(value):
        raise ValueError("it holds integers")
    return int(value)


def _elements(old: Any, value: Any) -> list[Any]:
    """Return as many elements as the array has; one of variable length may be empty still."""
    if not isinstance(value, list | tuple):
        return [value] * len(old)
    if len(old) not in (0, len(value)):
        raise ValueError(f"it has {len(old)} elements")
    return list(value)


def _with_element(old: Any, index: int, value: Any) -> Any:
    """Return an array with one element changed."""
    if isinstance(old, str) or not isinstance(old, bytes | np.ndarray | list | tuple):
        raise TypeError("it is no array")
    if not index < len(old):
        raise IndexError(f"it has {len(old)} elements")
    values = list(old)
    values[index] = value
    return _converted(old, values)


def damaged(payload: bytes, damage: Damage, rng: random.Random) -> bytes:
    """Return a payload as a bad network or a bad program would deliver it.

    Args:
        payload: An encoded message.
        damage: "flip": a few bits are wrong; "truncate": the end is missing; "extend": bytes
            follow; "fingerprint": another type's; "noise": random bytes; "empty": nothing.
        rng: Chooses the details.
    """
    return _DAMAGES[damage](payload, rng) if damage else payload


def _flipped(payload: bytes, rng: random.Random) -> bytes:
    data = bytearray(payload)
    for _ in range(FLIPPED_BITS if data else 0):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(data)


_DAMAGES: dict[str, Callable[[bytes, random.Random], bytes]] = {
    "flip": _flipped,
    "truncate": lambda payload, rng: payload[: rng.randrange(max(1, len(payload)))],
    "extend": lambda payload, rng: payload + rng.randbytes(rng.randrange(1, MAX_EXTRA_BYTES)),
    "fingerprint": lambda payload, rng: rng.randbytes(8) + payload[8:],
    "noise": lambda payload, rng: rng.randbytes(rng.randrange(1, MAX_NOISE_BYTES)),
    "empty": lambda payload, rng: b"",
}
