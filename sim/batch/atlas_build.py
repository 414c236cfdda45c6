"""Compile the rows of a sweep into the atlas that control reads."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from downbeat.control.atlas import Cell, write_atlas
from downbeat.control.modes import modes_between
from downbeat.control.slots import PARTS_PER_BEAT, entry_slots, exit_slots
from downbeat.policies.manifest import SkillManifest
from downbeat.sim.batch.pair import Finding, Pair
from downbeat.sim.batch.perturb import Profile
from downbeat.sim.batch.store import Store


def open_pair(store: Store, a: SkillManifest, b: SkillManifest) -> Pair:
    """Return what a sweep knows about an ordered pair."""
    parts = PARTS_PER_BEAT if a.kind == "stepping" else 1
    hints = store.hints().get(a.name)
    pair = Pair(modes_between(a, b), exit_slots(a).count, entry_slots(b).count, parts, hints)
    rows = store.load(a, b)
    if len(rows):
        pair.add(rows)
    return pair


def cell_of(a: SkillManifest, b: SkillManifest, finding: Finding) -> Cell:
    """Return a finding as control reads it: the bound in the slots that it is about, else 1."""
    bound = np.ones((exit_slots(a).count, entry_slots(b).count), np.float32)
    if finding.count:
        rows, columns = list(finding.exits), list(finding.entries)
        bound[np.ix_(rows, columns)] = finding.bound
    return Cell(a.name, b.name, finding.mode.name, bound, finding.count, finding.fallen)


def build_atlas(
    out: Path, rows: Path, skills: Mapping[str, SkillManifest], profile: Profile, seed: int
) -> list[Cell]:
    """Write the atlas of the skills into a folder; return its cells.

    Args:
        out: Folder.
        rows: Folder of the sweep.
        skills: Name -> manifest.
        profile: Of the sweep.
        seed: Of the sweep.
    """
    store = Store(rows, profile, seed)
    cells = [
        cell_of(a, b, finding)
        for a in skills.values()
        for b in skills.values()
        if a.name != b.name
        for finding in open_pair(store, a, b).findings()
    ]
    write_atlas(out, cells, skills, {"profile": profile.name, "seed": seed, "world": store.world})
    return cells
