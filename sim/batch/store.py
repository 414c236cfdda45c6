"""Where a sweep keeps its rows: one content-addressed file per ordered pair of skills.

A file is named after everything its rows depend on, is replaced whole, and holds every block or
none of it: whatever kills the sweep, no row is lost that was counted, and none counts twice.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from hashlib import blake2b
from pathlib import Path

import numpy as np

from downbeat.catalog.mjcf import ModelOptions, g1_mjcf
from downbeat.policies.digest import skill_digest
from downbeat.policies.manifest import SkillManifest
from downbeat.sim.batch.pair import ROW, Rows
from downbeat.sim.batch.perturb import SUBSTEP_S, Profile
from downbeat.sim.errors import SimError

VERSION = 1
"""Raised when the same inputs would give other rows."""


def world_digest(profile: Profile, seed: int) -> str:
    """Return a hash of the robot, the physics, what is perturbed, and the seed."""
    digest = blake2b(digest_size=8)
    digest.update(g1_mjcf(ModelOptions(timestep_s=SUBSTEP_S, visual=False)).encode())
    digest.update(repr((VERSION, profile, seed)).encode())
    return digest.hexdigest()


class Store:
    """A folder of pair files."""

    def __init__(self, folder: Path, profile: Profile, seed: int) -> None:
        self.folder = folder
        self.world = world_digest(profile, seed)
        folder.mkdir(parents=True, exist_ok=True)

    def path(self, source: SkillManifest, target: SkillManifest) -> Path:
        """Return where the rows of a pair are."""
        digest = blake2b(digest_size=6)
        for part in (self.world, skill_digest(source), skill_digest(target)):
            digest.update(part.encode())
        return self.folder / f"{source.name}--{target.name}.{digest.hexdigest()}.npy"

    def load(self, source: SkillManifest, target: SkillManifest) -> Rows:
        """Return the rows of a pair; none if it was not begun.

        Raises:
            SimError: The file is damaged.
        """
        path = self.path(source, target)
        if not path.exists():
            return np.zeros(0, ROW)
        try:
            rows = np.load(path, allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise SimError(f"{path} cannot be read: {error}; delete it to begin anew.") from error
        if rows.dtype != ROW or rows.ndim != 1:
            raise SimError(f"{path} does not hold rows of a sweep; delete it to begin anew.")
        return rows

    def save(self, source: SkillManifest, target: SkillManifest, rows: Rows) -> None:
        """Replace the rows of a pair, all or nothing."""
        path = self.path(source, target)
        draft = path.with_name(f".{path.name}.{os.getpid()}")
        with draft.open("wb") as file:
            np.save(file, rows, allow_pickle=False)
            file.flush()
            os.fsync(file.fileno())
        os.replace(draft, path)

    def hints(self) -> dict[str, tuple[int, ...]]:
        """Return the exit slots that the first pass found good, by source; empty before it."""
        if not self._hints.exists():
            return {}
        table = json.loads(self._hints.read_text(encoding="utf-8"))
        return {name: tuple(slots) for name, slots in table.items()}

    def save_hints(self, hints: Mapping[str, tuple[int, ...]]) -> None:
        """Keep the good exit slots: what follows must not depend on rows that come later."""
        draft = self._hints.with_name(f".{self._hints.name}.{os.getpid()}")
        draft.write_text(json.dumps({n: list(s) for n, s in hints.items()}), encoding="utf-8")
        os.replace(draft, self._hints)

    @property
    def _hints(self) -> Path:
        return self.folder / f"hints.{self.world}.json"

    def files(self) -> Iterator[Path]:
        """Yield all pair files."""
        return iter(sorted(self.folder.glob("*--*.npy")))
