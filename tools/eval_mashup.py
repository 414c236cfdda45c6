"""`downbeat eval mashup`: the paper's M20 and M30 on any recordings."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from downbeat.policies.manifest import load_skills
from downbeat.tools.commands.evaluate import Mashup as MashupArgs
from downbeat.tools.console import say
from downbeat.tools.errors import ToolError
from downbeat.tools.finish import finish_run
from downbeat.tools.mashup import Mashup, build_mashup, seeded_set_list
from downbeat.tools.recordings import INDEX_NAME, Library, build_library, with_duration
from downbeat.tools.rundir import new_run_dir
from downbeat.tools.show import SHOW_NAME, Show, ShowConfig, load_show


def dance_names() -> list[str]:
    """Return the bundled dances: what has beats and is not walked."""
    skills = load_skills()
    return [n for n, m in skills.items() if m.bpm > 0 and m.kind != "locomotion"]


def long_motions(folder: Path, section_s: float) -> list[str]:
    """Return the imported motions that last for a section: a one-shot ends in stand."""
    skills = load_skills(folder)
    return [n for n, m in skills.items() if m.kind == "tracking" and m.duration_s >= section_s]


def run_eval_mashup(args: MashupArgs) -> int:
    """Build, run, report; 0 if the robot stayed up and followed every section."""
    if args.section_seconds < 5.0 or args.sections < 2:
        raise ToolError(
            f"--section-seconds {args.section_seconds} and --sections {args.sections} cannot be "
            "run; sections must last at least 5 s and there must be at least 2."
        )
    run_dir = new_run_dir(args.runs)
    skills: Sequence[str] = dance_names() if args.rules is None else sorted(load_skills())
    if args.imported is not None and args.rules is None:
        skills = sorted({*skills, *long_motions(args.imported, args.section_seconds)})
    library = build_library(args.tracks, run_dir / "catalog", skills, args.seed, args.rules, say)
    tracks = {n: with_duration(t, library.recordings[n]) for n, t in library.tracks.items()}
    set_list, left_out = seeded_set_list(
        tracks, library.recordings, args.section_seconds, args.sections, args.seed
    )
    if left_out:
        say(f"left out (no {args.section_seconds:.0f} s without a pause): {', '.join(left_out)}")
    mashup = build_mashup(set_list, tracks, library.recordings, args.announced, left_out)
    mashup.truth["seed"] = args.seed
    mass_scale, friction = robot_of(args.seed) if args.perturb else (1.0, 0.6)
    show = write_show(
        run_dir,
        mashup,
        library,
        args.seed,
        imported="" if args.imported is None else str(args.imported.resolve()),
        fallback=args.fallback,
        transitions=args.transitions,
        checker=args.checker,
        atlas="" if args.atlas is None else str(args.atlas.resolve()),
        mass_scale=mass_scale,
        friction=friction,
        hearing="" if args.hearing is None else str(args.hearing.resolve()),
    )
    play(show, run_dir, mashup, args.realtime, args.url)
    metrics = finish_run(run_dir, video=args.video, quiet=args.json)
    metrics["left_out"] = list(left_out)
    if args.json:
        print(json.dumps(metrics))
    return 0 if metrics["good"] else 1


def robot_of(seed: int) -> tuple[float, float]:
    """Return torso mass factor and friction of the robot that a seed means."""
    rng = np.random.default_rng([seed, 0xB0D7])
    return round(float(rng.uniform(0.95, 1.05)), 4), round(float(rng.uniform(0.5, 0.8)), 3)


def write_show(
    run_dir: Path,
    mashup: Mashup,
    library: Library,
    seed: int,
    **settings: Any,
) -> Show:
    """Write the files of a show into its run folder; `settings` are those of `ShowConfig`."""
    mashup.write(run_dir)
    folder = library.folder.relative_to(run_dir).as_posix()
    config = ShowConfig(
        audio="mashup.wav",
        tracks=folder,
        index=f"{folder}/{INDEX_NAME}",
        set_list="setlist.toml" if mashup.truth["announced"] else "",
        seed=seed,
        **settings,
    )
    path = run_dir / SHOW_NAME
    path.write_text(config.to_toml(), encoding="utf-8")
    return load_show(path)


def play(show: Show, run_dir: Path, mashup: Mashup, realtime: bool, url: str) -> None:
    """Run the show in real time or in lockstep."""
    duration_s = float(mashup.truth["duration_s"])
    if realtime:
        from downbeat.tools.run_realtime import run_realtime

        run_realtime(show, run_dir, duration_s, url)
        return
    from downbeat.tools.run_lockstep import run_lockstep

    def progress(done_s: int, total_s: float) -> None:
        if sys.stderr.isatty() or done_s % 20 == 0:
            end = "\r" if sys.stderr.isatty() else "\n"
            print(f"lockstep {done_s:4d} / {total_s:.0f} s", end=end, file=sys.stderr, flush=True)

    speed = run_lockstep(show, run_dir, duration_s, progress)
    note: dict[str, Any] = {"lockstep_speed": round(speed, 2)}
    (run_dir / "run.json").write_text(json.dumps(note), encoding="utf-8")
    say(f"lockstep ran {speed:.1f} times faster than real time on one core")
