"""The cells of a sweep as a Parquet file, for notebooks and dashboards."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from downbeat.control.modes import Mode
from downbeat.control.slots import entry_slots, exit_slots
from downbeat.policies.manifest import SkillManifest
from downbeat.sim.batch.atlas_build import cell_of, open_pair
from downbeat.sim.batch.pair import Pair, Rows
from downbeat.sim.batch.perturb import Profile
from downbeat.sim.batch.store import Store
from downbeat.sim.errors import SimError

COLUMNS = (
    "source",
    "target",
    "mode",
    "blend_s",
    "exit_slot",
    "exit_s",
    "entry_slot",
    "entry_s",
    "bound",
    "rollouts",
    "fallen",
    "max_tilt_rad",
    "max_torque_ratio",
    "min_margin_m",
    "end_error_rad",
)
"""`bound` is of the whole set of slots that was proven together; rollouts and falls are of this
slot, all attempts together; the measures are the worst (tilt, torque, margin) and the mean (error)
of the robots that stayed up."""


def has_parquet() -> bool:
    """Whether Parquet files can be written here."""
    return find_spec("pyarrow") is not None


def write_parquet(
    path: Path, rows: Path, skills: Mapping[str, SkillManifest], profile: Profile, seed: int
) -> int:
    """Write one row per pair, mode, exit slot and entry slot that was tried; return how many.

    Args:
        path: File to write.
        rows: Folder of the sweep's rows.
        skills: Name -> manifest.
        profile: Of the sweep.
        seed: Of the sweep.

    Raises:
        SimError: pyarrow is not installed.
    """
    if not has_parquet():
        raise SimError("Parquet needs pyarrow; install it with pip install 'downbeat[sweep]'.")
    import pyarrow
    from pyarrow import parquet

    store = Store(rows, profile, seed)
    table: dict[str, list[Any]] = {name: [] for name in COLUMNS}
    for a in skills.values():
        for b in skills.values():
            if a.name != b.name:
                for row in cell_rows(a, b, open_pair(store, a, b)):
                    for name, value in zip(COLUMNS, row, strict=True):
                        table[name].append(value)
    meta = {"profile": profile.name, "seed": str(seed), "world": store.world}
    made = pyarrow.table(table).replace_schema_metadata(meta)
    parquet.write_table(made, path, compression="zstd")
    return len(table["source"])


def cell_rows(a: SkillManifest, b: SkillManifest, pair: Pair) -> Iterator[tuple[Any, ...]]:
    """Yield the values of `COLUMNS` for every slot of a pair that was tried."""
    all_rows = pair.all_rows()
    index = {mode.name: number for number, mode in enumerate(pair.modes)}
    for finding in pair.findings():
        bound = cell_of(a, b, finding).bound  # (exits, entries)
        mine = all_rows[all_rows["mode"] == index[finding.mode.name]]
        for exit_slot in range(pair.num_exits):
            here = mine[mine["exit_slot"] == exit_slot]
            for entry_slot in np.unique(here["entry_slot"]).tolist():
                tried = here[here["entry_slot"] == entry_slot]
                yield (
                    *_where(a, b, finding.mode, exit_slot, entry_slot),
                    float(bound[exit_slot, entry_slot]),
                    *_measures(tried),
                )


def _where(
    a: SkillManifest, b: SkillManifest, mode: Mode, exit_slot: int, entry_slot: int
) -> tuple[Any, ...]:
    return (
        a.name,
        b.name,
        mode.name,
        mode.blend_ticks * 0.02,
        exit_slot,
        exit_slots(a).phase_s(exit_slot),
        entry_slot,
        entry_slots(b).phase_s(entry_slot),
    )


def _measures(rows: Rows) -> tuple[Any, ...]:
    fell = rows["fell"]
    up = rows[~fell]
    if not len(up):
        return (len(rows), int(fell.sum()), None, None, None, None)
    return (
        len(rows),
        int(fell.sum()),
        float(up["max_tilt"].max()),
        float(up["max_torque_ratio"].max()),
        float(up["min_margin"].min()),
        float(np.mean(up["end_error"], dtype=np.float64)),
    )
