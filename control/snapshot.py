"""Control's state as bytes and back, exactly: what the batch check simulates from.

The bytes are JSON with a type tag per object. Only the classes of the table below are ever built,
field by field, so bytes from the wire can do no harm; floats keep all their digits.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from downbeat.control.balance import PredictorState
from downbeat.control.errors import ControlError
from downbeat.control.estimate import EstimatorState
from downbeat.control.get_up import GetUpState
from downbeat.control.motion import Alignment
from downbeat.control.phase import FollowLimits, PhaseFollower, PhaseLine
from downbeat.control.planner import Plan
from downbeat.control.player import Blend, Playback, Velocity
from downbeat.control.policy import SkillLibrary
from downbeat.control.prover import Chosen, ProverState
from downbeat.control.requests import Request
from downbeat.control.safety import SafetyCounters
from downbeat.control.skill import SkillMemory
from downbeat.control.transitions import Hop

SNAPSHOT_VERSION = 1
MAX_BYTES = 4_000_000

_CLASSES: Mapping[str, type] = {
    cls.__name__: cls
    for cls in (
        Alignment,
        Blend,
        Chosen,
        EstimatorState,
        FollowLimits,
        GetUpState,
        Hop,
        PhaseFollower,
        PhaseLine,
        Plan,
        Playback,
        PredictorState,
        ProverState,
        Request,
        SafetyCounters,
        SkillMemory,
        Velocity,
    )
}
_DTYPES = {"f4": np.float32, "f8": np.float64, "i4": np.int32, "i8": np.int64, "b1": np.bool_}


def _names(cls: type) -> tuple[str, ...]:
    if is_dataclass(cls):
        return tuple(field.name for field in fields(cls))
    return PhaseFollower.STATE


def encode(value: Any) -> Any:
    """Return `value` as plain JSON values."""
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.ndarray):
        raw: Any = np.ascontiguousarray(value)
        text = base64.b85encode(raw.tobytes()).decode()
        return {"!a": [raw.dtype.str[1:], list(raw.shape), text]}
    if isinstance(value, np.generic):
        return encode(np.asarray(value))
    if isinstance(value, tuple):
        return {"!t": [encode(item) for item in value]}
    if isinstance(value, list):
        return [encode(item) for item in value]
    if isinstance(value, dict):
        return {"!d": [[key, encode(item)] for key, item in value.items()]}
    name = type(value).__name__
    if name in _CLASSES:
        return {
            "!": name,
            "v": [encode(getattr(value, field)) for field in _names(_CLASSES[name])],
        }
    if hasattr(value, "manifest"):
        return {"!s": value.manifest.name}
    raise ControlError(f"A snapshot cannot hold a {name}.")


def decode(data: Any, library: SkillLibrary) -> Any:
    """Build the value again; the inverse of `encode`."""
    if isinstance(data, list):
        return [decode(item, library) for item in data]
    if not isinstance(data, dict):
        return data
    if "!a" in data:
        dtype, shape, text = data["!a"]
        raw: Any = np.frombuffer(base64.b85decode(text), _DTYPES[dtype])
        return raw.reshape(shape).copy() if shape else raw[0]
    if "!t" in data:
        return tuple(decode(item, library) for item in data["!t"])
    if "!d" in data:
        return {key: decode(item, library) for key, item in data["!d"]}
    if "!s" in data:
        if data["!s"] not in library:
            raise ControlError(f"The snapshot plays '{data['!s']}', which is not loaded here.")
        return library[data["!s"]]
    cls = _CLASSES[data["!"]]
    built: Any = object.__new__(cls)
    for name, item in zip(_names(cls), data["v"], strict=True):
        object.__setattr__(built, name, decode(item, library))
    return built


def to_bytes(state: Mapping[str, Any]) -> bytes:
    """Serialise named values."""
    table = {"snapshot": SNAPSHOT_VERSION, "state": {k: encode(v) for k, v in state.items()}}
    return json.dumps(table, separators=(",", ":"), sort_keys=True).encode()


def from_bytes(data: bytes, library: SkillLibrary) -> dict[str, Any]:
    """Return the named values.

    Raises:
        ControlError: The bytes are not a snapshot, or play a skill that is not loaded.
    """
    if len(data) > MAX_BYTES:
        raise ControlError(f"A snapshot of {len(data)} bytes is too large; {MAX_BYTES} are valid.")
    try:
        table = json.loads(data)
        if table["snapshot"] != SNAPSHOT_VERSION:
            raise ControlError(
                f"The snapshot is of version {table['snapshot']}; {SNAPSHOT_VERSION} is valid."
            )
        return {key: decode(item, library) for key, item in table["state"].items()}
    except (KeyError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise ControlError(f"The bytes are not a snapshot of control: {error!r}.") from error
