"""The proof of one ordered pair of skills.

The first attempt counts every slot. One that meets too many falls is given up; the next one leaves
out the slots (of footwork: the beats) at which somebody fell and starts again from zero on fresh
rollouts with a share of the error allowed, so that choosing does not flatter the result. A last
attempt, once every pair of a source has been tried, is confined to the slots that all of them
together have shown to be good (`hints`). The whole course follows from the rows, so a killed sweep
goes on from them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from downbeat.control.modes import Mode
from downbeat.sim.batch.perturb import BLOCK
from downbeat.sim.batch.proof import upper_bound

CONFIDENCE = (0.965, 0.99, 0.995)
"""Of each attempt: together they may err in 5 % of the cases."""
HINTED = 3
"""The attempt on the slots that all pairs of a source together have shown to be good."""
ATTEMPTS = len(CONFIDENCE)
GIVE_UP = 1.5
"""A proof ends when more than this times the target fell: going on would take too long."""
ENOUGH = 0.6
"""Share of the slots from which a change must be proven."""
WORTH_KEEPING = 0.2
"""Share of the slots that must be left for a proof to be worth its time."""

ROW = np.dtype(
    [
        ("mode", "u1"),
        ("stage", "u1"),
        ("block", "<u2"),
        ("robot", "u1"),
        ("exit_slot", "u1"),
        ("entry_slot", "u1"),
        ("fell", "?"),
        ("fell_tick", "<i2"),
        ("max_tilt", "<f2"),
        ("max_torque_ratio", "<f2"),
        ("min_margin", "<f2"),
        ("end_error", "<f2"),
    ]
)
"""One rollout; stage is the attempt, from 1."""

Rows = NDArray[np.void]


@dataclass(frozen=True, slots=True)
class Depth:
    """How far to go.

    Attributes:
        target: Upper bound on the share that falls that counts as proven.
        max_blocks: Blocks of rollouts per attempt before a proof is given up.
        robots: Rollouts per block, at most 64.
    """

    target: float = 0.01
    max_blocks: int = 16
    robots: int = BLOCK


QUICK = Depth(target=0.08, max_blocks=1, robots=48)
"""One look: enough to see which changes are hopeless."""


@dataclass(frozen=True, slots=True)
class Task:
    """The next block to simulate.

    Attributes:
        mode: Index into the pair's modes.
        stage: The attempt, from 1.
        block: Robots.
        exits: Slots to draw from.
        entries: Slots to draw from.
    """

    mode: int
    stage: int
    block: int
    exits: tuple[int, ...]
    entries: tuple[int, ...]


@dataclass
class Finding:
    """What is known about one mode of a pair.

    Attributes:
        mode: The blend.
        exits: Slots that the bound is about.
        entries: Slots that the bound is about.
        count: Rollouts of the proof.
        fallen: Of these.
        bound: 95 % upper bound on the share that falls; 1 if there was no proof.
        all_count: Rollouts of all attempts.
        all_fallen: Of these.
    """

    mode: Mode
    exits: tuple[int, ...] = ()
    entries: tuple[int, ...] = ()
    count: int = 0
    fallen: int = 0
    bound: float = 1.0
    all_count: int = 0
    all_fallen: int = 0


@dataclass
class Pair:
    """The rows of an ordered pair, and what follows from them."""

    modes: Sequence[Mode]
    num_exits: int
    num_entries: int
    parts: int = 1
    hints: tuple[int, ...] | None = None
    rows: list[Rows] = field(default_factory=list)

    def add(self, rows: Rows) -> None:
        """Take the rows of a task."""
        self.rows.append(rows)

    def all_rows(self) -> Rows:
        """Return all rows so far."""
        return np.concatenate(self.rows) if self.rows else np.zeros(0, ROW)

    def findings(self) -> list[Finding]:
        """Return what is known about every mode that was tried."""
        rows = self.all_rows()
        found = []
        for index, mode in enumerate(self.modes):
            mine = rows[rows["mode"] == index]
            if len(mine):
                found.append(self._finding(mode, mine))
        return found

    def next_task(self, depth: Depth) -> Task | None:
        """Return the next block to simulate, or None when the pair is decided."""
        rows = self.all_rows()
        used = int(rows["block"].max()) + 1 if len(rows) else 0
        covered: set[int] = set()
        for index, mode in enumerate(self.modes):
            mine = rows[rows["mode"] == index]
            task = self._mode_task(index, mine, used, depth)
            if task is not None:
                return task
            finding = self._finding(mode, mine)
            if finding.bound <= depth.target and len(finding.entries) == self.num_entries:
                covered |= set(finding.exits)
            if self._is_enough(covered):
                return None
        return None

    def _is_enough(self, covered: set[int]) -> bool:
        """Whether another mode is not worth its time: most slots are covered."""
        return len(covered) >= ENOUGH * self.num_exits

    # ------------------------------------------------------------------ one mode

    def _mode_task(self, index: int, rows: Rows, block: int, depth: Depth) -> Task | None:
        for stage, exits, entries in self._attempts(rows):
            mine = rows[rows["stage"] == stage]
            if len(exits) < WORTH_KEEPING * self.num_exits or not entries:
                return None
            count, fallen = len(mine), int(mine["fell"].sum())
            if upper_bound(fallen, count, CONFIDENCE[stage - 1]) <= depth.target:
                return None
            if self._is_given_up(mine, depth, CONFIDENCE[stage - 1]):
                continue
            return Task(index, stage, block, exits, entries)
        return None

    @staticmethod
    def _is_given_up(rows: Rows, depth: Depth, confidence: float) -> bool:
        count, fallen = len(rows), int(rows["fell"].sum())
        if len(np.unique(rows["block"])) >= depth.max_blocks:
            return True
        if upper_bound(fallen, depth.max_blocks * depth.robots, confidence) > depth.target:
            return True  # not even if nobody falls any more
        return fallen >= 2 and fallen > GIVE_UP * depth.target * count

    def _attempts(self, rows: Rows) -> Iterator[tuple[int, tuple[int, ...], tuple[int, ...]]]:
        """Yield stage, exits and entries of each attempt: slots with falls before are left out."""
        for stage in range(1, ATTEMPTS + 1):
            before = rows[(rows["stage"] < stage) & rows["fell"]]
            # What fails at a quarter of a beat fails in its neighbours: leave out the whole beat.
            bad = {slot // self.parts for slot in before["exit_slot"].tolist()}
            exits = tuple(s for s in range(self.num_exits) if s // self.parts not in bad)
            entries = tuple(range(self.num_entries))
            if len(exits) < WORTH_KEEPING * self.num_exits:
                # Not the exits: perhaps the entries.
                bad = set(before["entry_slot"].tolist())
                entries = tuple(s for s in range(self.num_entries) if s not in bad)
                exits = tuple(range(self.num_exits))
            if stage < HINTED:
                yield stage, exits, entries
            elif self.hints is not None:
                yield stage, self.hints, tuple(range(self.num_entries))

    def _finding(self, mode: Mode, rows: Rows) -> Finding:
        finding = Finding(mode, all_count=len(rows), all_fallen=int(rows["fell"].sum()))
        for stage, exits, entries in self._attempts(rows):
            mine = rows[rows["stage"] == stage]
            if not len(mine):
                continue
            fallen = int(mine["fell"].sum())
            bound = upper_bound(fallen, len(mine), CONFIDENCE[stage - 1])
            if bound < finding.bound:
                finding.exits, finding.entries = exits, entries
                finding.count, finding.fallen, finding.bound = len(mine), fallen, bound
        return finding
