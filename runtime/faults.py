"""The type of a fault table: fault -> reaction, hysteresis, message. Rows belong to their owner.

Logic raises faults by name; the table decides what they mean. It is reviewed as a table and tested
row by row.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Generic, TypeVar

from downbeat.runtime.errors import DownbeatError, one_of

ReactionT = TypeVar("ReactionT", bound=IntEnum)

MAX_FAULT_ID = 2**15 - 1
"""control_status_t.fault is an int16."""


class FaultTableError(DownbeatError):
    """A table that contradicts itself, or a fault that is not in it."""


@dataclass(frozen=True, slots=True)
class Fault(Generic[ReactionT]):
    """One row.

    Attributes:
        id: Number on the wire, > 0.
        name: Short name, lower_snake.
        reaction: What its owner does; harder is larger.
        message: One sentence; at most one `{}` takes the measured value.
        raise_after_ticks: The condition must hold for this many ticks in a row.
        clear_after_ticks: It must be gone for this many ticks in a row.
        latched: Stays until it is cleared by hand.
    """

    id: int
    name: str
    reaction: ReactionT
    message: str
    raise_after_ticks: int = 1
    clear_after_ticks: int = 1
    latched: bool = False


class FaultTable(Generic[ReactionT]):
    """Rows by name and id, validated."""

    def __init__(self, rows: Collection[Fault[ReactionT]]) -> None:
        """Check and index the rows; hardest reaction first, then by id.

        Raises:
            FaultTableError: An id or name occurs twice, or a row is not valid.
        """
        ordered = sorted(rows, key=lambda row: (-row.reaction, row.id))
        self._by_name: dict[str, Fault[ReactionT]] = {}
        self._by_id: dict[int, Fault[ReactionT]] = {}
        for row in ordered:
            _check_row(row)
            if row.name in self._by_name or row.id in self._by_id:
                raise FaultTableError(f"Fault {row.id} {row.name!r}: id or name occurs twice.")
            self._by_name[row.name] = row
            self._by_id[row.id] = row

    def __iter__(self) -> Iterator[Fault[ReactionT]]:
        return iter(self._by_name.values())

    def __len__(self) -> int:
        return len(self._by_name)

    def named(self, name: str) -> Fault[ReactionT]:
        """Return a row.

        Raises:
            FaultTableError: There is none of that name.
        """
        row = self._by_name.get(name)
        if row is None:
            raise FaultTableError(
                f"There is no fault {name!r}; the table has {one_of(self.names)}."
            )
        return row

    def with_id(self, number: int) -> Fault[ReactionT]:
        """Return the row with a number from the wire.

        Raises:
            FaultTableError: There is none.
        """
        row = self._by_id.get(number)
        if row is None:
            raise FaultTableError(
                f"There is no fault {number}; the table has {one_of(self._by_id)}."
            )
        return row

    @property
    def names(self) -> tuple[str, ...]:
        """All names, hardest reaction first."""
        return tuple(self._by_name)


def _check_row(row: Fault[ReactionT]) -> None:
    problems = []
    if not 0 < row.id <= MAX_FAULT_ID:
        problems.append(f"id must be 1..{MAX_FAULT_ID}")
    if not re.fullmatch(r"[a-z][a-z0-9_]*", row.name):
        problems.append("name must be lower_snake")
    if row.raise_after_ticks < 1 or row.clear_after_ticks < 1:
        problems.append("hysteresis must be at least 1 tick")
    if row.message.count("{") != row.message.count("{}") or row.message.count("{}") > 1:
        problems.append("message may hold one {} and no other brace")
    if not row.message.endswith("."):
        problems.append("message must be a sentence")
    if problems:
        raise FaultTableError(f"Fault {row.id} {row.name!r}: {'; '.join(problems)}.")


class FaultMonitor(Generic[ReactionT]):
    """Applies the hysteresis of a table, one update per tick; no clock, no order of sets."""

    def __init__(self, table: FaultTable[ReactionT]) -> None:
        self._table = table
        self._held: dict[str, int] = dict.fromkeys(table.names, 0)
        self._gone: dict[str, int] = dict.fromkeys(table.names, 0)
        self._active: dict[str, bool] = dict.fromkeys(table.names, False)
        self._is_busy = False

    def update(self, conditions: Collection[str]) -> tuple[Fault[ReactionT], ...]:
        """Take the conditions of one tick.

        Args:
            conditions: Names of the faults whose condition holds now.

        Returns:
            The active faults, hardest first.

        Raises:
            FaultTableError: A name is not in the table.
        """
        if not conditions and not self._is_busy:
            return ()  # the common tick costs nothing
        for name in conditions:
            self._table.named(name)
        for row in self._table:
            holds = row.name in conditions
            self._held[row.name] = self._held[row.name] + 1 if holds else 0
            self._gone[row.name] = 0 if holds else self._gone[row.name] + 1
            if self._held[row.name] >= row.raise_after_ticks:
                self._active[row.name] = True
            elif self._gone[row.name] >= row.clear_after_ticks and not row.latched:
                self._active[row.name] = False
        self._is_busy = any(self._active.values()) or any(self._held.values())
        return self.active

    @property
    def active(self) -> tuple[Fault[ReactionT], ...]:
        """Faults that are raised, hardest first."""
        return tuple(row for row in self._table if self._active[row.name])

    def clear_latched(self) -> None:
        """Forget latched faults whose condition is gone; the others stay."""
        for row in self._table:
            if row.latched and self._held[row.name] == 0:
                self._active[row.name] = False

    def reset(self) -> None:
        """Forget everything, latched faults too."""
        for name in self._table.names:
            self._held[name] = self._gone[name] = 0
            self._active[name] = False
        self._is_busy = False

    def to_state(self) -> dict[str, list[int]]:
        """Return the counters by fault name: held, gone, active; only those that are not zero."""
        return {
            name: [self._held[name], self._gone[name], int(self._active[name])]
            for name in self._table.names
            if self._held[name] or self._gone[name] or self._active[name]
        }

    def from_state(self, values: Mapping[str, Sequence[int]]) -> None:
        """Restore what `to_state` returned.

        Raises:
            FaultTableError: A name is not in the table.
        """
        self.reset()
        for name, (held, gone, active) in values.items():
            self._table.named(name)
            self._held[name], self._gone[name], self._active[name] = held, gone, bool(active)
        self._is_busy = bool(values)
