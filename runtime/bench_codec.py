"""Measure our codec against the generated classes, each fed what it is fast with."""

from __future__ import annotations

import timeit
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from downbeat.lcm_types import control_status_t, g1_low_cmd_t, g1_low_state_t
from downbeat.runtime.codec import codec_for


@dataclass(frozen=True, slots=True)
class CodecRow:
    """One line of the table.

    Attributes:
        name: Type and direction.
        ours_us: Best time of our codec per message [us]; its decode includes all checks.
        lcm_gen_us: Best time of the generated class [us], fed lists, checking nothing.
    """

    name: str
    ours_us: float
    lcm_gen_us: float

    @property
    def ratio(self) -> float:
        """How many times faster ours is."""
        return self.lcm_gen_us / self.ours_us


def bench_codec(number: int = 5000, repeat: int = 5) -> list[CodecRow]:
    """Time encode and checked decode of the high-rate messages.

    Args:
        number: Messages per measurement.
        repeat: Measurements, of which the best counts.
    """
    rows: list[CodecRow] = []
    messages: tuple[Any, ...] = (_low_state(), g1_low_cmd_t(), _control_status())
    for msg in messages:
        generated: Any = type(msg)
        codec = codec_for(generated)
        payload: bytes = msg.encode()
        from_arrays = partial(codec.encode, codec.decode(payload))
        checked_decode = partial(codec.decode, payload)
        generated_decode = partial(generated.decode, payload)
        rows.append(_row(f"{codec.name} encode", from_arrays, msg.encode, number, repeat))
        rows.append(_row(f"{codec.name} decode", checked_decode, generated_decode, number, repeat))
    return rows


def _row(
    name: str,
    ours: Callable[[], Any],
    generated: Callable[[], Any],
    number: int,
    repeat: int,
) -> CodecRow:
    best = [
        min(timeit.repeat(call, number=number, repeat=repeat)) / number * 1e6
        for call in (ours, generated)
    ]
    return CodecRow(name, best[0], best[1])


def _low_state() -> Any:
    msg = g1_low_state_t()
    msg.imu_pelvis.quat = [1.0, 0.0, 0.0, 0.0]
    msg.imu_torso.quat = [1.0, 0.0, 0.0, 0.0]
    msg.wireless_remote = bytes(40)
    return msg


def _control_status() -> Any:
    msg = control_status_t()
    msg.skill = "armwave"
    msg.previous_skill = "stand"
    return msg
