"""The plan of simulated traffic: what goes wrong and what is injected, checked beforehand."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from downbeat.runtime.bus_types import BusError
from downbeat.runtime.endpoint import channel_named
from downbeat.runtime.traffic_edit import Damage, set_path

FOREIGN_EPOCH = 4_242
MAX_RATE_HZ = 5_000.0
MAX_MESSAGES = 100_000
"""Of one injection; all are made beforehand."""


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
        hold: Messages wait until the window ends, then arrive all at once.
        freeze: Only the first message of the window arrives, again and again.
        freeze_content: The same under live headers: a publisher whose source has died.
        damage: What is done to the payload.
        damage_share: Share that is damaged.
        set_fields: Field path -> value, e.g. {"imu_pelvis.gyro[2]": nan}; a number fills an array.
        set_share: Share whose fields are set.
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
    hold: bool = False
    freeze: bool = False
    freeze_content: bool = False
    damage: Damage = ""
    damage_share: float = 1.0
    set_fields: dict[str, Any] = field(default_factory=dict)
    set_share: float = 1.0
    clock_step_s: float = 0.0

    def check(self) -> None:
        """Refuse what makes no sense.

        Raises:
            BusError: The channel is not in the table, or a value is impossible (key).
        """
        row = channel_named(self.channel)
        for name in ("drop", "duplicate", "reorder", "damage_share", "set_share"):
            _check_between(name, getattr(self, name), 0.0, 1.0)
        for name in ("delay_ms", "jitter_ms"):
            _check_between(name, getattr(self, name), 0.0, 60_000.0)
        _check_between("from_s", self.from_s, 0.0, math.inf)
        _check_between("to_s", self.to_s, self.from_s, math.inf)
        if not math.isfinite(self.clock_step_s):
            raise BusError(f"clock_step_s is {self.clock_step_s}; valid is a finite number.")
        if self.hold and math.isinf(self.to_s):
            raise BusError("hold needs to_s: messages that wait for ever are drop = 1.0.")
        for path, value in self.set_fields.items():
            set_path(row.type(), path, value, "set_fields")


@dataclass(frozen=True, slots=True)
class Injection:
    """Messages of one more publisher.

    Attributes:
        channel: Channel name.
        at_s: First message, scenario time [s].
        to_s: Last one [s]; with a rate.
        rate_hz: 0: a single message.
        fields: Field path -> value; the rest keeps the type's defaults. Times (`*_utime`) are
            scenario seconds.
        count: Field path -> added to its value with every message, e.g. {"request_id": 1}.
        vary: Field path -> [low, high]: drawn anew for every message.
        damage: What is done to the payload.
        epoch: header.epoch; publishers differ by it.
        stamp_s: Added to header.utime [s].
    """

    channel: str
    at_s: float
    to_s: float = 0.0
    rate_hz: float = 0.0
    fields: dict[str, Any] = field(default_factory=dict)
    count: dict[str, float] = field(default_factory=dict)
    vary: dict[str, tuple[float, float]] = field(default_factory=dict)
    damage: Damage = ""
    epoch: int = FOREIGN_EPOCH
    stamp_s: float = 0.0

    @property
    def number(self) -> int:
        """How many messages."""
        return 1 if not self.rate_hz else max(1, round((self.to_s - self.at_s) * self.rate_hz))

    def check(self) -> None:
        """Refuse what makes no sense.

        Raises:
            BusError: The channel is not in the table, or a value is impossible (key).
        """
        row = channel_named(self.channel)
        _check_between("at_s", self.at_s, 0.0, 1e6)
        _check_between("rate_hz", self.rate_hz, 0.0, MAX_RATE_HZ)
        if self.rate_hz:
            _check_between("to_s", self.to_s, self.at_s, 1e6)
        _check_between("messages", self.number, 1, MAX_MESSAGES)
        msg = row.type()
        for path, value in self.fields.items():
            set_path(msg, path, scenario_time(path, value, 0), "fields")
        for path, step in self.count.items():
            base = self.fields.get(path, 0)
            if not isinstance(base, int | float):
                raise BusError(f"count counts numbers, '{path}' is {base!r} in fields.")
            value = scenario_time(path, type(base)(base + step), 0)
            set_path(msg, path, value, "count")
        for path, (low, high) in self.vary.items():
            _check_between(f"vary.{path}", low, -math.inf, high)
            set_path(msg, path, scenario_time(path, low, 0), "vary")


def _check_between(key: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise BusError(f"{key} is {value:g}; valid are {low:g} to {high:g}.")


def scenario_time(path: str, value: Any, start_utime: int) -> Any:
    """Return a field's value; `start_utime = 3.5` of a scenario is 3.5 s from its start, in us."""
    if path.endswith("_utime") and isinstance(value, int | float) and value:
        return start_utime + round(float(value) * 1e6)
    return value
