"""`downbeat sweep` and `downbeat atlas`: prove changes of skill, and ask what is proven."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import tyro


@dataclass(frozen=True)
class Sweep:
    """Simulate every change of skill until it is proven or given up; goes on where it was."""

    skills: list[str] = field(default_factory=list)
    """Skill names; none: all skills."""
    imported: Path | None = None
    """Folder of imported policies (downbeat policy import) that are swept besides."""
    out: Path = Path("runs/sweep")
    """Folder of everything: rows, atlas, cells.parquet, heatmap.png, pairs.txt."""
    atlas: Path | None = None
    """Folder that receives the atlas; default: OUT/atlas."""
    profile: str = "stage"
    """Perturbations: a bundled profile, or the path of a TOML file."""
    seed: int = 0
    """Of everything that is drawn."""
    target: float | None = None
    """Upper bound on the share that falls that counts as proven; default: 0.01, quick: 0.08."""
    quick: bool = False
    """One look at every change: minutes, shows what is hopeless."""
    engine: Literal["auto", "native", "mjx", "warp"] = "auto"
    """What simulates; auto: mjx where JAX finds a GPU, else native."""
    shard: str = ""
    """I/N: only part I of N (from 1); the same folder, or the folders' rows copied into one,
    makes the whole."""
    workers: int = 0
    """Processes; 0: one per core that may be used (one for mjx)."""
    ray: bool = False
    """Spread over a Ray cluster (extra `sweep`)."""
    ray_address: str = ""
    """HOST:PORT of the cluster's head; empty: a cluster of --workers on this machine."""
    json: bool = False
    """Print the result as one JSON object on standard output."""

    def run(self) -> int:
        """Sweep; 0 when every pair is decided."""
        from downbeat.tools.sweep import SweepOptions, sweep

        return sweep(
            SweepOptions(
                skills=tuple(self.skills),
                imported=self.imported,
                out=self.out,
                atlas=self.atlas,
                profile=self.profile,
                seed=self.seed,
                target=self.target,
                quick=self.quick,
                engine=self.engine,
                shard=self.shard,
                workers=self.workers,
                ray_address=(self.ray_address or "local") if self.ray else "",
                json=self.json,
            )
        )


@dataclass(frozen=True)
class Atlas:
    """Print what is proven about changes of skill: all, of one skill, or of one pair."""

    source: tyro.conf.Positional[str] = ""
    """Skill that is left; omitted: an overview."""
    target: tyro.conf.Positional[str] = ""
    """Skill that is entered; omitted: all of them."""
    atlas: Path | None = None
    """Folder of an atlas (downbeat sweep); default: the bundled one."""
    imported: Path | None = None
    """Folder of imported policies that the atlas is about besides."""
    proven: float = 0.01
    """Upper bound on the share that falls that counts as proven."""
    plot: Path | None = None
    """Draw the heat map (PNG) of everything."""
    json: bool = False
    """Print one JSON object on standard output."""

    def run(self) -> int:
        """Print."""
        from downbeat.tools.sweep import show_atlas

        return show_atlas(
            self.source,
            self.target,
            self.atlas,
            self.imported,
            self.proven,
            self.plot,
            self.json,
        )
