"""The atlas of transitions: what was proven offline about every change of skill.

A folder with `index.json` (which pairs, from which skills) and `bounds.npy` (memory-mapped): for
every pair and mode a table over exit and entry slots with the 95 % upper bound on the share of
robots that fall. A lookup is two dictionary hits and one element.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from downbeat.control.errors import ControlError
from downbeat.control.slots import Slots, entry_slots, exit_slots
from downbeat.policies.digest import skill_digest
from downbeat.policies.manifest import BUNDLED_SKILLS, SkillManifest

BUNDLED_ATLAS = BUNDLED_SKILLS / "atlas"
VERSION = 1
UNPROVEN = 1.0
NO_MISS_S = 0.03
"""Exact slots count for phases this near to them: a tick and a half."""

log = logging.getLogger("downbeat.control")


@dataclass(frozen=True)
class Cell:
    """One pair in one mode.

    Attributes:
        source: Skill that is left.
        target: Skill that is entered.
        mode: Name of the blend.
        bound: (exit slots, entry slots) 95 % upper bound on the share that falls; 1: unproven.
        count: Rollouts behind the bound.
        fallen: Of these.
    """

    source: str
    target: str
    mode: str
    bound: NDArray[np.float32]
    count: int
    fallen: int


class Atlas:
    """Bounds of the changes between the skills of a library."""

    def __init__(self, cells: Sequence[Cell] = (), meta: Mapping[str, Any] | None = None) -> None:
        self.cells = {(c.source, c.target, c.mode): c for c in cells}
        self.pairs = frozenset((c.source, c.target) for c in cells)
        self.meta = dict(meta or {})
        self._exits: dict[str, Slots] = {}
        self._entries: dict[str, Slots] = {}

    def exits(self, skill: SkillManifest) -> Slots:
        """Return where a skill may be left."""
        if skill.name not in self._exits:
            self._exits[skill.name] = exit_slots(skill)
        return self._exits[skill.name]

    def entries(self, skill: SkillManifest) -> Slots:
        """Return where a skill may be entered."""
        if skill.name not in self._entries:
            self._entries[skill.name] = entry_slots(skill)
        return self._entries[skill.name]

    @classmethod
    def load(cls, folder: Path, skills: Mapping[str, SkillManifest]) -> Atlas:
        """Open an atlas; pairs whose skills have changed since are left out, with a warning.

        Args:
            folder: With index.json and bounds.npy.
            skills: Name -> manifest of the skills that will be played.

        Raises:
            ControlError: The folder does not hold an atlas.
        """
        try:
            index = json.loads((folder / "index.json").read_text(encoding="utf-8"))
            if index["version"] != VERSION:
                raise ControlError(
                    f"The atlas {folder} is of version {index['version']}; {VERSION} is valid."
                )
            bounds = np.load(folder / "bounds.npy", mmap_mode="r", allow_pickle=False)
            known = {
                name
                for name, digest in index["skills"].items()
                if name in skills and skill_digest(skills[name]) == digest
            }
            cells = [
                _cell(row, bounds, skills)
                for row in index["cells"]
                if row[0] in known and row[1] in known
            ]
        except (OSError, ValueError, KeyError, TypeError, IndexError) as error:
            raise ControlError(
                f"{folder} does not hold an atlas of transitions: {error!r}; "
                "`downbeat sweep` makes one."
            ) from error
        changed = sorted(set(index["skills"]) & set(skills) - known)
        if changed:
            log.warning(
                "the atlas %s was made with other versions of %s: nothing is proven about them",
                folder,
                ", ".join(changed),
            )
        return cls(cells, index.get("meta", {}))

    def bound(
        self, source: SkillManifest, target: SkillManifest, mode: str, exit_s: float, entry_s: float
    ) -> float:
        """Return the 95 % upper bound on the share of robots that fall; 1 if nothing is proven.

        Args:
            source: What is left.
            target: What is entered.
            mode: Name of the blend.
            exit_s: Phase of the source at the onset, inside its loop [s].
            entry_s: Phase of the target at the onset, inside its loop [s].
        """
        cell = self.cells.get((source.name, target.name, mode))
        if cell is None:
            return UNPROVEN
        exits = self.exits(source)
        if exits.miss_s(exit_s) > NO_MISS_S:
            return UNPROVEN
        return float(cell.bound[exits.at(exit_s), self.entries(target).at(entry_s)])


def _cell(
    row: Sequence[Any], bounds: NDArray[np.float32], skills: Mapping[str, SkillManifest]
) -> Cell:
    source, target, mode, offset, count, fallen = row
    shape = (exit_slots(skills[source]).count, entry_slots(skills[target]).count)
    table = bounds[offset : offset + shape[0] * shape[1]].reshape(shape)
    return Cell(source, target, mode, table, int(count), int(fallen))


def _rounded_up(bound: NDArray[np.float32]) -> NDArray[np.float16]:
    """Return bounds as half floats that are never below the bound."""
    half = np.asarray(bound, np.float16)
    higher: NDArray[np.float16] = np.where(half < bound, np.nextafter(half, np.float16(2.0)), half)
    return higher


def write_atlas(
    folder: Path,
    cells: Sequence[Cell],
    skills: Mapping[str, SkillManifest],
    meta: Mapping[str, Any],
) -> None:
    """Write an atlas.

    Args:
        folder: Made if needed.
        cells: What is known.
        skills: The skills that it is about.
        meta: Where it comes from.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rows, tables, offset = [], [], 0
    for cell in cells:
        rows.append([cell.source, cell.target, cell.mode, offset, cell.count, cell.fallen])
        tables.append(_rounded_up(cell.bound).reshape(-1))
        offset += cell.bound.size
    index = {
        "version": VERSION,
        "meta": dict(meta),
        "skills": {name: skill_digest(manifest) for name, manifest in sorted(skills.items())},
        "cells": rows,
    }
    lines = ",\n".join(json.dumps(row) for row in rows)
    text = json.dumps({**index, "cells": "@"}, indent=1).replace('"@"', f"[\n{lines}\n]")
    (folder / "index.json").write_text(text + "\n", encoding="utf-8")
    flat = np.concatenate(tables) if tables else np.zeros(0, np.float16)
    np.save(folder / "bounds.npy", flat, allow_pickle=False)
