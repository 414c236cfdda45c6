"""Simulated traffic: messages that are lost, late, doubled, out of order, frozen, broken or forged.

Pure and deterministic: what happens to a message follows from the scenario, the seed and the
message's number on its channel. `MemqHub.impair` puts an `Impairer` between publishers and
subscribers; `Injector` makes the messages of further publishers.
"""

from __future__ import annotations

import heapq
import math
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from downbeat.lcm_types.channels import CHANNELS
from downbeat.runtime.bus_types import BusError
from downbeat.runtime.codec import codec_for
from downbeat.runtime.endpoint import channel_named

Damage = Literal["", "flip", "truncate", "extend", "fingerprint", "noise", "empty"]
Delivery = tuple[int, str, bytes]
"""(utime, channel, payload)."""
FOREIGN_EPOCH = 4_242
MAX_RATE_HZ = 5_000.0


@dataclass(frozen=True, slots=True)
class Impairment:
    """What happens to the messages of a channel for a while.

    Attributes:
        channel: Channel name.
        from_s: Start, scenario time [s].
        to_s: End [s].
        drop: Share that is lost, 0..1.
        delay_ms: Added to every message [ms].
        jitter_ms: Further delay, uniform from 0 [ms].
        duplicate: Share that arrives twice.
        reorder: Share that is overtaken by its successor.
        freeze: Only the first message of the window arrives, again and again.
        damage: What is done to the payload.
        damage_share: Share that is damaged.
        set_fields: Field path -> value, e.g. {"imu_pelvis.gyro": nan}; arrays are filled.
        clock_step_s: Added to header.utime [s].
    """

    channel: str
    from_s: float = 0.0
    to_s: float = math.inf
    drop: float = 0.0
    delay_ms: float = 0.0
    jitter_ms: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    freeze: bool = False
    damage: Damage = ""
    damage_share: float = 1.0
    set_fields: dict[str, Any] = field(default_factory=dict)
    clock_step_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Injection:
    """Messages of one more publisher.

    Attributes:
        channel: Channel name.
        at_s: First message, scenario time [s].
        to_s: Last one [s]; with a rate.
        rate_hz: 0: a single message.
        fields: Field path -> value; the rest keeps the type's defaults.
        damage: What is done to the payload.
        epoch: header.epoch; publishers differ by it.
        stamp_s: Added to header.utime [s].
    """

    channel: str
    at_s: float
    to_s: float = 0.0
    rate_hz: float = 0.0
    fields: dict[str, Any] = field(default_factory=dict)
    damage: Damage = ""
    epoch: int = FOREIGN_EPOCH
    stamp_s: float = 0.0


def set_path(msg: Any, path: str, value: Any, where: str) -> None:
    """Set a field of a message; a number fills an array.

    Raises:
        BusError: There is no such field.
    """
    *parents, last = path.split(".")
    for name in parents:
        msg = getattr(msg, name, None)
    if msg is None or last not in getattr(type(msg), "__slots__", ()):
        raise BusError(f"There is no field '{path}' ({where}).")
    old = getattr(msg, last)
    if isinstance(old, str | bytes) or isinstance(value, str):
        setattr(msg, last, value)
    elif isinstance(old, np.ndarray):
        setattr(msg, last, np.full_like(old, value) if np.isscalar(value) else np.asarray(value))
    elif isinstance(old, list | tuple) and not isinstance(value, list | tuple):
        setattr(msg, last, [value] * len(old))
    else:
        setattr(msg, last, value)


def damaged(payload: bytes, damage: Damage, rng: random.Random) -> bytes:
    """Return a payload as a bad network or a bad program would deliver it."""
    if damage == "flip":
        data = bytearray(payload)
        for _ in range(3):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        return bytes(data)
    if damage == "truncate":
        return payload[: rng.randrange(len(payload))]
    if damage == "extend":
        return payload + rng.randbytes(rng.randrange(1, 64))
    if damage == "fingerprint":
        return rng.randbytes(8) + payload[8:]
    if damage == "noise":
        return rng.randbytes(rng.randrange(1, 2000))
    return b"" if damage == "empty" else payload


class Impairer:
    """Turns what is published into what arrives."""

    def __init__(self, impairments: Sequence[Impairment], start_utime: int, seed: int = 0) -> None:
        """Prepare.

        Args:
            impairments: What happens; several may apply to one message, in this order.
            start_utime: Scenario time 0 [us].
            seed: Of everything random.

        Raises:
            BusError: A channel is not in the table.
        """
        for one in impairments:
            channel_named(one.channel)
        self._impairments = tuple(impairments)
        self._start = start_utime
        self._seed = seed
        self._counts: dict[str, int] = {}
        self._frozen: dict[int, bytes] = {}
        self._waiting: list[tuple[int, int, str, bytes]] = []
        self._number = 0

    def feed(self, utime: int, channel: str, payload: bytes) -> None:
        """Take one published message."""
        count = self._counts[channel] = self._counts.get(channel, 0) + 1
        now_us = utime - self._start
        due, copies = float(utime), 1
        for index, one in enumerate(self._impairments):
            if one.channel != channel or not one.from_s * 1e6 <= now_us < one.to_s * 1e6:
                continue
            rng = random.Random(f"{self._seed}/{index}/{channel}/{count}")
            if rng.random() < one.drop:
                return
            if one.freeze:
                payload = self._frozen.setdefault(index, payload)
            payload = self._changed(one, payload, rng)
            due += 1e3 * (one.delay_ms + one.jitter_ms * rng.random())
            if rng.random() < one.reorder:
                rate = CHANNELS[channel].rate_hz or 50.0
                due += 1.5e6 / rate
            copies += rng.random() < one.duplicate
        for _ in range(copies):
            self._number += 1
            heapq.heappush(self._waiting, (math.ceil(due), self._number, channel, payload))

    def _changed(self, one: Impairment, payload: bytes, rng: random.Random) -> bytes:
        if one.set_fields or one.clock_step_s:
            codec = codec_for(CHANNELS[one.channel].type)
            msg = CHANNELS[one.channel].type.decode(payload)  # lcm-gen's own: checks nothing
            for path, value in one.set_fields.items():
                set_path(msg, path, value, f"{one.channel}: set_fields")
            msg.header.utime += round(one.clock_step_s * 1e6)
            payload = codec.encode(msg)
        if one.damage and rng.random() < one.damage_share:
            payload = damaged(payload, one.damage, rng)
        return payload

    def take(self, utime: int) -> Iterator[tuple[str, bytes]]:
        """Return what has arrived by now, in order of arrival."""
        while self._waiting and self._waiting[0][0] <= utime:
            _, _, channel, payload = heapq.heappop(self._waiting)
            yield channel, payload


class Injector:
    """Makes the messages of injections, in order of time."""

    def __init__(self, injections: Sequence[Injection], start_utime: int, seed: int = 0) -> None:
        """Prepare all messages.

        Raises:
            BusError: A channel, a field or a rate is not possible.
        """
        self._messages = sorted(
            (
                message
                for index, one in enumerate(injections)
                for message in _messages(one, index, start_utime, seed)
            ),
            key=lambda message: message[0],
        )
        self._next = 0

    def take(self, utime: int) -> Iterator[Delivery]:
        """Return what is due by now."""
        while self._next < len(self._messages) and self._messages[self._next][0] <= utime:
            yield self._messages[self._next]
            self._next += 1

    @property
    def next_utime(self) -> int | None:
        """When the next message is due [us]; None at the end."""
        if self._next >= len(self._messages):
            return None
        return self._messages[self._next][0]


def _messages(one: Injection, index: int, start_utime: int, seed: int) -> Iterator[Delivery]:
    row = channel_named(one.channel)
    where = f"{one.channel}: fields"
    if not 0.0 <= one.rate_hz <= MAX_RATE_HZ:
        raise BusError(
            f"A rate of {one.rate_hz:g} Hz is not possible; valid are 0 to {MAX_RATE_HZ:g} "
            f"({one.channel}: rate_hz)."
        )
    codec = codec_for(row.type)
    rng = random.Random(f"{seed}/inject/{index}")
    count = 1 if not one.rate_hz else max(1, round((one.to_s - one.at_s) * one.rate_hz))
    for number in range(count):
        utime = start_utime + round(1e6 * (one.at_s + (number / one.rate_hz if number else 0.0)))
        msg = row.type()
        msg.header.utime = utime + round(one.stamp_s * 1e6)
        msg.header.seq = number
        msg.header.epoch = one.epoch
        for path, value in one.fields.items():
            set_path(msg, path, _timed(path, value, start_utime), where)
        yield utime, one.channel, damaged(codec.encode(msg), one.damage, rng)


def _timed(path: str, value: Any, start_utime: int) -> Any:
    """Times of a scenario are seconds from its start: `start_utime = 3.5` means so many us."""
    if path.endswith("_utime") and isinstance(value, int | float) and value:
        return start_utime + round(float(value) * 1e6)
    return value
