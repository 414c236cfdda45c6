"""Simulated traffic: messages that are lost, late, doubled, out of order, frozen, broken or forged.

Pure and deterministic: what happens to a message follows from the plan, the seed and the message's
number on its channel. `MemqHub.impair` puts an `Impairer` between publishers and subscribers;
`Injector` makes the messages of further publishers.
"""

from __future__ import annotations

import heapq
import math
import random
import struct
from collections.abc import Iterator, Sequence
from typing import Any

from downbeat.lcm_types.channels import CHANNELS
from downbeat.runtime.codec import codec_for
from downbeat.runtime.errors import DownbeatError
from downbeat.runtime.traffic_edit import Damage, damaged, set_path
from downbeat.runtime.traffic_plan import FOREIGN_EPOCH, Impairment, Injection, scenario_time

__all__ = [
    "FOREIGN_EPOCH",
    "Damage",
    "Delivery",
    "Impairer",
    "Impairment",
    "Injection",
    "Injector",
    "damaged",
    "set_path",
]

Delivery = tuple[int, str, bytes]
"""(utime, channel, payload)."""
EVENT_PERIOD_S = 0.02
"""How far apart the messages of an event channel are taken to be, for overtaking."""


class Impairer:
    """Turns what is published into what arrives."""

    def __init__(self, impairments: Sequence[Impairment], start_utime: int, seed: int = 0) -> None:
        """Prepare.

        Args:
            impairments: What happens; several may apply to one message, in this order.
            start_utime: Scenario time 0 [us].
            seed: Of everything random.

        Raises:
            BusError: A channel is not in the table, or a value is impossible.
        """
        for one in impairments:
            one.check()
        self._impairments = tuple(impairments)
        self._start = start_utime
        self._seed = seed
        self._counts: dict[str, int] = {}
        self.touched = [0] * len(self._impairments)
        """How many messages each impairment has had to do with."""
        self._frozen: dict[int, bytes] = {}
        self._waiting: list[tuple[int, int, str, bytes]] = []
        self._number = 0

    def feed(self, utime: int, channel: str, payload: bytes) -> None:
        """Take one published message."""
        count = self._counts[channel] = self._counts.get(channel, 0) + 1
        now_s = (utime - self._start) * 1e-6
        due, copies = float(utime), 1
        for index, one in enumerate(self._impairments):
            if one.channel != channel or not one.from_s <= now_s + 1e-9 < one.to_s:
                continue
            self.touched[index] += 1
            rng = random.Random(f"{self._seed}/{index}/{channel}/{count}")
            if rng.random() < one.drop:
                return
            payload = self._changed(index, payload, rng)
            due += 1e3 * (one.delay_ms + one.jitter_ms * rng.random())
            if rng.random() < one.reorder:
                rate_hz = CHANNELS[channel].rate_hz
                due += 1.5e6 * (1.0 / rate_hz if rate_hz else EVENT_PERIOD_S)
            if one.hold:
                due = max(due, self._start + one.to_s * 1e6)
            copies += rng.random() < one.duplicate
        for _ in range(copies):
            self._number += 1
            heapq.heappush(self._waiting, (math.ceil(due), self._number, channel, payload))

    def _changed(self, index: int, payload: bytes, rng: random.Random) -> bytes:
        """Return what one impairment makes of a payload."""
        one = self._impairments[index]
        if one.freeze or one.freeze_content:
            first = self._frozen.setdefault(index, payload)
            payload = first if one.freeze else _under_header_of(one.channel, first, payload)
        if one.clock_step_s or (one.set_fields and rng.random() < one.set_share):
            payload = self._edited(one, payload)
        if one.damage and rng.random() < one.damage_share:
            payload = damaged(payload, one.damage, rng)
        return payload

    @staticmethod
    def _edited(one: Impairment, payload: bytes) -> bytes:
        """Return a message with other fields, or as it is if an earlier impairment broke it."""
        try:
            msg = CHANNELS[one.channel].type.decode(payload)  # lcm-gen's own: checks nothing
        except (ValueError, struct.error):
            return payload
        for path, value in one.set_fields.items():
            set_path(msg, path, value, f"{one.channel}: set_fields")
        msg.header.utime += round(one.clock_step_s * 1e6)
        try:
            return codec_for(CHANNELS[one.channel].type).encode(msg)
        except DownbeatError:  # cut inside a byte field: decoded short, cannot be written again
            return payload

    def take(self, utime: int) -> Iterator[tuple[str, bytes]]:
        """Return what has arrived by now, in order of arrival."""
        while self._waiting and self._waiting[0][0] <= utime:
            _, _, channel, payload = heapq.heappop(self._waiting)
            yield channel, payload

    @property
    def next_utime(self) -> int | None:
        """When the next message arrives [us]; None if none is on its way."""
        return self._waiting[0][0] if self._waiting else None


def _under_header_of(channel: str, content: bytes, payload: bytes) -> bytes:
    """Return one message's content under the header of another."""
    kind = CHANNELS[channel].type
    msg = kind.decode(content)
    msg.header = kind.decode(payload).header
    return codec_for(kind).encode(msg)


class Injector:
    """Makes the messages of injections, in order of time.

    Injections of the same epoch on the same channel are one publisher: they share one sequence.
    """

    def __init__(
        self,
        injections: Sequence[Injection],
        start_utime: int,
        seed: int = 0,
        epoch_offset: int = 0,
    ) -> None:
        """Prepare all messages.

        Args:
            injections: What is published.
            start_utime: Scenario time 0 [us].
            seed: Of everything random.
            epoch_offset: Added to every epoch: on a running bus, each run is a new publisher.

        Raises:
            BusError: A channel, a field or a rate is not possible.
        """
        planned: list[tuple[int, int, int]] = []
        for index, one in enumerate(injections):
            one.check()
            planned += [(_utime(one, start_utime, n), index, n) for n in range(one.number)]
        planned.sort()
        rngs = [random.Random(f"{seed}/inject/{index}") for index in range(len(injections))]
        seqs: dict[tuple[str, int], int] = {}
        self._messages: list[Delivery] = []
        self._next = 0
        for utime, index, number in planned:
            one = injections[index]
            publisher = (one.channel, one.epoch)
            seqs[publisher] = seq = seqs.get(publisher, -1) + 1
            msg = _message(one, utime, number, start_utime, rngs[index])
            msg.header.epoch = one.epoch + epoch_offset
            if "header.seq" not in one.fields:
                msg.header.seq = seq
            payload = codec_for(CHANNELS[one.channel].type).encode(msg)
            payload = damaged(payload, one.damage, rngs[index])
            self._messages.append((utime, one.channel, payload))

    def take(self, utime: int) -> Iterator[Delivery]:
        """Return what is due by now."""
        while self._next < len(self._messages) and self._messages[self._next][0] <= utime:
            self._next += 1
            yield self._messages[self._next - 1]

    @property
    def next_utime(self) -> int | None:
        """When the next message is due [us]; None at the end."""
        if self._next >= len(self._messages):
            return None
        return self._messages[self._next][0]


def _utime(one: Injection, start_utime: int, number: int) -> int:
    return start_utime + round(1e6 * (one.at_s + (number / one.rate_hz if number else 0.0)))


def _message(one: Injection, utime: int, number: int, start_utime: int, rng: random.Random) -> Any:
    """Return the number-th message of an injection."""
    msg = CHANNELS[one.channel].type()
    msg.header.utime = utime + round(one.stamp_s * 1e6)
    values = dict(one.fields)
    for path, step in one.count.items():
        base = values.get(path, 0)
        values[path] = type(base)(base + step * number)
    values |= {path: rng.uniform(low, high) for path, (low, high) in one.vary.items()}
    for path, value in values.items():
        set_path(msg, path, scenario_time(path, value, start_utime), f"{one.channel}: fields")
    return msg
