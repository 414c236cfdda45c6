"""`downbeat sweep` and `downbeat atlas`: run, compile, report."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from pathlib import Path

from rich.console import Console

from downbeat.control.atlas import BUNDLED_ATLAS, Atlas
from downbeat.policies.manifest import SkillManifest, load_skills
from downbeat.runtime.errors import DownbeatError
from downbeat.sim.batch.atlas_build import build_atlas
from downbeat.sim.batch.cluster import spread_ray
from downbeat.sim.batch.engine import EngineName, check_versions, resolve_engine
from downbeat.sim.batch.pair import QUICK, Depth
from downbeat.sim.batch.parquet import has_parquet, write_parquet
from downbeat.sim.batch.perturb import load_profile
from downbeat.sim.batch.sweep import (
    Progress,
    SweepConfig,
    pairs_of,
    refine_sweep,
    run_sweep,
    sweep_skills,
)
from downbeat.tools.atlas_plot import draw_atlas
from downbeat.tools.atlas_report import (
    as_json,
    by_kind,
    check_name,
    known_names,
    overview_table,
    pair_table,
    slot_tables,
    summaries,
    totals_line,
)
from downbeat.tools.errors import ToolError
from downbeat.tools.sweep_progress import SweepProgress

SETTINGS_NAME = "sweep.json"
TABLE_WIDTH = 110
LARGEST_TARGET = 0.5


@dataclass(frozen=True)
class SweepOptions:
    """What was asked for; see `tools/commands/sweep.py`."""

    skills: tuple[str, ...] = ()
    imported: Path | None = None
    out: Path = Path("runs/sweep")
    atlas: Path | None = None
    profile: str = "stage"
    seed: int = 0
    target: float | None = None
    quick: bool = False
    engine: EngineName = "auto"
    shard: str = ""
    workers: int = 0
    ray_address: str = ""
    json: bool = False
    depth: Depth | None = None
    """For tests: overrides target and quick."""


def sweep(options: SweepOptions) -> int:
    """Run a sweep, or what is left of it; then compile and report; 0 when all is decided.

    Raises:
        DownbeatError: A skill, profile, shard, target or folder is not valid.
    """
    config = config_of(options)
    skills = sweep_skills(config)
    profile = load_profile(config.profile)
    spread = None
    if options.ray_address:
        spread = spread_ray("" if options.ray_address == "local" else options.ray_address)
    _claim_folder(options.out, config)
    with SweepProgress(len(pairs_of(skills, config.shard)), to_stderr=options.json) as progress:
        done = run_sweep(config, progress, spread)
    if config.shard == (0, 1) and not options.quick:
        # Needs the rows of every pair; what shards left unproven is tried when they are merged.
        pairs = len(pairs_of(skills, config.shard))
        with SweepProgress(pairs, to_stderr=options.json) as progress:
            more = refine_sweep(config, progress, spread)
        done = replace(
            done, rollouts=done.rollouts + more.rollouts, seconds=done.seconds + more.seconds
        )
    atlas_dir = options.atlas or options.out / "atlas"
    build_atlas(atlas_dir, config.out, skills, profile, config.seed)
    return _report(options, config, done, atlas_dir)


# ---------------------------------------------------------------------- what was asked


def config_of(options: SweepOptions) -> SweepConfig:
    """Return the sweep that was asked for.

    Raises:
        ToolError: Shard, target, workers or the number of skills is not valid.
        SimError: The engine cannot run here.
    """
    depth = options.depth or (QUICK if options.quick else Depth())
    if options.target is not None:
        if not 0.0 < options.target <= LARGEST_TARGET:
            raise ToolError(
                f"--target {options.target:g} is not a share of robots that fall; more than 0 and "
                f"at most {LARGEST_TARGET:g} is valid."
            )
        depth = replace(depth, target=options.target)
    if options.workers < 0:
        raise ToolError(f"--workers {options.workers} is not valid; 0 (one per core) or more is.")
    if len(options.skills) == 1:
        raise ToolError(f"A change needs two skills; '{options.skills[0]}' alone has none.")
    if options.imported is not None and not options.imported.is_dir():
        raise ToolError(
            f"--imported {options.imported} is not a folder; one that `downbeat policy import` "
            "wrote is valid."
        )
    engine = resolve_engine(options.engine)
    _check_engine(engine)
    cores = len(os.sched_getaffinity(0))
    return SweepConfig(
        out=options.out / ("rows" if engine == "native" else f"rows-{engine}"),
        skills=tuple(dict.fromkeys(options.skills)),
        imported=options.imported,
        profile=options.profile,
        seed=options.seed,
        depth=depth,
        shard=shard_of(options.shard),
        workers=options.workers or (cores if engine == "native" else 1),
        engine=engine,
    )


def _check_engine(name: EngineName) -> None:
    if name == "native":
        return
    check_versions()
    if find_spec("downbeat.sim.batch.mjx") is None:
        raise ToolError(f"--engine {name} is not part of this version; --engine native is valid.")


def shard_of(text: str) -> tuple[int, int]:
    """Return "I/N" (from 1) as (i, n) from 0; empty: everything.

    Raises:
        ToolError: It is not a shard.
    """
    if not text:
        return (0, 1)
    index, slash, count = text.partition("/")
    if not slash or not index.isdecimal() or not count.isdecimal():
        raise ToolError(f"--shard '{text}' is not valid; I/N is, e.g. 1/4 ... 4/4.")
    if not 1 <= int(index) <= int(count):
        raise ToolError(f"--shard '{text}' is not valid; 1/{count} to {count}/{count} are.")
    return int(index) - 1, int(count)


def _claim_folder(out: Path, config: SweepConfig) -> None:
    """Note how deep this folder's sweep goes: rows of two depths do not make one proof.

    Raises:
        ToolError: The folder holds a sweep of another depth, or cannot be written.
    """
    path, mine = out / SETTINGS_NAME, asdict(config.depth)
    try:
        if path.exists():
            before = json.loads(path.read_text(encoding="utf-8"))["depth"]
            if before != mine:
                raise ToolError(
                    f"{out} holds a sweep with target {before['target']:g} and "
                    f"{before['robots']} x {before['max_blocks']} rollouts at most, this one has "
                    f"target {mine['target']:g} and {mine['robots']} x {mine['max_blocks']}; give "
                    "another --out, or the same --target and --quick."
                )
            return
        out.mkdir(parents=True, exist_ok=True)
        draft = path.with_name(f".{path.name}.{os.getpid()}")
        draft.write_text(json.dumps({"depth": mine}) + "\n", encoding="utf-8")
        os.replace(draft, path)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ToolError(f"{out} cannot hold a sweep: {error!r}; give another --out.") from error


# ---------------------------------------------------------------------- what came out


def _report(options: SweepOptions, config: SweepConfig, done: Progress, atlas_dir: Path) -> int:
    """Write the files, print what they say; 0 if every pair of the skills is decided."""
    skills, profile = sweep_skills(config), load_profile(config.profile)
    atlas = Atlas.load(atlas_dir, skills)
    names = by_kind(list(skills), skills)
    rows = summaries(atlas, names, config.depth.target)
    written = {
        "atlas": atlas_dir,
        "heat map": draw_atlas(
            options.out / "heatmap.png", rows, names, skills, config.depth.target
        ),
        "pairs": options.out / "pairs.txt",
    }
    with written["pairs"].open("w", encoding="utf-8") as file:
        text = Console(file=file, width=TABLE_WIDTH)
        text.print(totals_line(rows, config.depth.target))
        text.print(pair_table(rows))
    if has_parquet():
        written["cells"] = options.out / "cells.parquet"
        write_parquet(written["cells"], config.out, skills, profile, config.seed)
    untried = sum(row.route == "untried" for row in rows)
    if options.json:
        meta = {
            **atlas.meta,
            "rollouts_now": done.rollouts,
            "seconds": round(done.seconds, 1),
            "files": {key: str(path) for key, path in written.items()},
        }
        print(json.dumps(as_json(rows, meta)))
    else:
        _print_report(rows, names, written, done, config)
    return 0 if not untried or config.shard[1] > 1 else 1


def _print_report(
    rows: list, names: list[str], written: Mapping[str, Path], done: Progress, config: SweepConfig
) -> None:
    console = Console(markup=False, highlight=False)
    console.print(overview_table(rows, names))
    console.print(totals_line(rows, config.depth.target))
    console.print(f"this run: {done.rollouts:,} rollouts in {done.seconds / 60.0:.1f} min")
    for key, path in written.items():
        console.print(f"{key}: {path}", soft_wrap=True)
    if "cells" not in written:
        console.print("no cells.parquet: pip install 'downbeat[sweep]' brings pyarrow")
    untried = sum(row.route == "untried" for row in rows)
    if untried and config.shard[1] > 1:
        console.print(
            f"{untried} pairs belong to other shards: copy their rows into {config.out} and run "
            "without --shard; nothing is simulated twice"
        )


def show_atlas(
    source: str,
    target: str,
    folder: Path | None,
    imported: Path | None,
    proven: float,
    plot: Path | None,
    as_object: bool,
) -> int:
    """Print what an atlas knows.

    Args:
        source: Skill that is left; empty: all.
        target: Skill that is entered; empty: all.
        folder: Of the atlas; None: the bundled one.
        imported: Folder of imported policies.
        proven: Bound that counts as proven.
        plot: PNG to draw.
        as_object: Print JSON.

    Raises:
        DownbeatError: There is no atlas, or it knows nothing about a skill.
    """
    skills: dict[str, SkillManifest] = dict(load_skills())
    if imported is not None:
        skills.update(load_skills(imported))
    atlas = Atlas.load(folder or BUNDLED_ATLAS, skills)
    names = known_names(atlas, skills)
    for name in filter(None, (source, target)):
        check_name(name, names)
    if source and source == target:
        raise ToolError(f"'{source}' to '{target}' is no change; give two skills.")
    rows = summaries(atlas, names, proven)
    if plot is not None:
        _plot(plot, rows, names, skills, proven)
    chosen = [r for r in rows if source in ("", r.source) and target in ("", r.target)]
    if as_object:
        print(json.dumps(as_json(chosen, atlas.meta)))
        return 0
    console = Console(markup=False, highlight=False)
    if not source:
        console.print(overview_table(rows, names))
    else:
        console.print(pair_table(chosen))
    if source and target:
        for table in slot_tables(atlas, skills[source], skills[target]):
            console.print(table)
    console.print(totals_line(chosen, proven))
    if plot is not None:
        console.print(f"heat map: {plot}", soft_wrap=True)
    return 0


def _plot(
    path: Path, rows: list, names: list[str], skills: Mapping[str, SkillManifest], proven: float
) -> None:
    try:
        draw_atlas(path, rows, names, skills, proven)
    except (OSError, ValueError) as error:
        raise DownbeatError(
            f"--plot {path} cannot be drawn: {error}; a path that ends in .png is valid."
        ) from error
