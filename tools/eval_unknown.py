"""`downbeat eval unknown`: music that the catalogue lacks, danced by the whole chain, on its beat.

Each stranger is one lockstep run: listener, conductor, control and plant, with a catalogue of other
recordings. Beats are those of the offline analysis, which the robot never sees; only strangers with
a steady beat count, and the offline analysis alone says which they are.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track as progress
from rich.table import Table

from downbeat.catalog.setlist import SetEntry, SetList
from downbeat.catalog.tracks import Track
from downbeat.lcm_types import music_match_t, skill_request_t
from downbeat.perception.source import Recording
from downbeat.policies.manifest import load_skills
from downbeat.tools.console import say
from downbeat.tools.errors import ToolError
from downbeat.tools.eval_mashup import dance_names, write_show
from downbeat.tools.finish import finish_run
from downbeat.tools.follow_reference import find_reference
from downbeat.tools.mashup import build_mashup
from downbeat.tools.matcher_sounds import load_folder
from downbeat.tools.metrics import first_sample_utime
from downbeat.tools.metrics_beats import phase_error_s
from downbeat.tools.recordings import Library, build_library
from downbeat.tools.run_lockstep import run_lockstep
from downbeat.tools.rundir import new_run_dir
from downbeat.tools.runlog import LOG_NAME, RunLog, read_run
from downbeat.tools.truth import TRUTH_NAME, read_truth

SETTLED_S = 8.0
"""From the first sample on: by then the dance must be on the beat."""
MIN_S = 30.0


@dataclass
class UnknownScore:
    """What came of the strangers.

    Attributes:
        runs: One row each.
        errors_ms: Of the dance against the beat, every tick from 8 s on.
        ticks, danced: Ticks from 8 s on, and those with a dance.
    """

    runs: list[dict[str, Any]] = field(default_factory=list)
    errors_ms: list[float] = field(default_factory=list)
    ticks: int = 0
    danced: int = 0

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        p50, p95 = np.percentile(self.errors_ms or [np.nan], (50, 95))
        begun = [row["begun_s"] for row in self.runs if row["begun_s"] is not None]
        return {
            "strangers": len(self.runs),
            "falls": sum(row["falls"] for row in self.runs),
            "false_locks": sum(row["false_locks"] for row in self.runs),
            "danced": round(self.danced / max(self.ticks, 1), 4),
            "beat_phase_error_ms": {"p50": round(float(p50), 1), "p95": round(float(p95), 1)},
            "begun_s": {
                "p50": round(float(np.median(begun or [np.nan])), 2),
                "max": round(max(begun, default=float("nan")), 2),
            },
            "runs": self.runs,
        }


def eval_unknown(
    tracks: Path, strangers: Path, seconds: float, count: int, seed: int, runs: Path, as_json: bool
) -> int:
    """Dance to each stranger and print; 0 if nobody fell.

    Raises:
        ToolError: No stranger is long and steady enough.
    """
    pieces = [r for r in load_folder(strangers, say).values() if r.duration_s >= MIN_S + 1.0]
    pieces = [r for r in pieces if find_reference(r).is_steady]
    order = np.random.default_rng(seed).permutation(len(pieces))[:count]
    if not len(order):
        raise ToolError(
            f"{strangers} holds no recording of {MIN_S:g} s or more with a steady beat."
        )
    score = UnknownScore()
    for number in progress(order.tolist(), "strangers", disable=as_json, transient=True):
        run_dir = new_run_dir(runs)
        library = build_library(tracks, run_dir / "catalog", dance_names(), seed, say=_nothing)
        if pieces[number].name in library.tracks:
            raise ToolError(f"'{pieces[number].name}' is in the catalogue {tracks}: no stranger.")
        _dance(score, run_dir, library, pieces[number], seconds, seed)
    result = score.as_json()
    if as_json:
        print(json.dumps(result))
    else:
        _print(result)
    return 0 if result["falls"] == 0 else 1


def _dance(
    score: UnknownScore,
    run_dir: Path,
    library: Library,
    piece: Recording,
    seconds: float,
    seed: int,
) -> None:
    """Run one stranger and count it."""
    rng = np.random.default_rng([seed, len(piece.samples)])
    length_s = min(seconds, piece.duration_s - 1.0)
    from_s = round(float(rng.uniform(0.0, piece.duration_s - length_s)), 2)
    grid = find_reference(piece).grid
    stranger = Track(piece.name, "stand", grid, title=piece.name, duration_s=piece.duration_s)
    entry = SetEntry(piece.name, from_s, length_s)
    named = {piece.name: stranger}
    mashup = build_mashup(SetList((entry,)), named, {piece.name: piece}, announced=False)
    mashup.truth["seed"] = seed
    show = write_show(run_dir, mashup, library, seed)
    run_lockstep(show, run_dir, float(mashup.truth["duration_s"]))
    metrics = finish_run(run_dir, video=False, quiet=True)
    log = read_run(run_dir / LOG_NAME)
    truth = read_truth(run_dir / TRUTH_NAME)
    errors_ms, ticks, begun_s = _errors(log, from_s, length_s, truth.beats[piece.name])
    score.errors_ms += errors_ms.tolist()
    score.ticks += ticks
    score.danced += len(errors_ms)
    p50, p95 = np.percentile(errors_ms if len(errors_ms) else [np.nan], (50, 95))
    score.runs.append(
        {
            "track": piece.name,
            "bpm": round(grid.tempo_bpm, 1),
            "begun_s": begun_s,
            "p50_ms": round(float(p50), 1),
            "p95_ms": round(float(p95), 1),
            "falls": metrics["falls"],
            "false_locks": _false_locks(log),
            "asked": _asked(log),
        }
    )


def _errors(
    log: RunLog, from_s: float, length_s: float, beats: Any
) -> tuple[NDArray[np.float64], int, float | None]:
    """Return |error| of danced ticks from 8 s on [ms], all ticks from then, the first dance [s]."""
    control = log.control
    skills = load_skills()
    at_s = (control.utime - first_sample_utime(log)) * 1e-6
    bpm = np.array([skills[name].bpm if name in skills else 0.0 for name in control.skill.tolist()])
    dances = (bpm > 0.0) & (control.blend_weight >= 1.0 - 1e-6) & (control.previous_skill == "")
    late = (at_s >= SETTLED_S) & (at_s < length_s)
    found = []
    for tempo in np.unique(bpm[dances & late]).tolist():
        chosen = dances & late & (bpm == tempo)
        error_s = phase_error_s(
            control.phase_s[chosen], control.phase_rate[chosen], tempo, beats, at_s[chosen] + from_s
        )
        found.append(np.abs(error_s) * 1e3)
    first = at_s[(bpm > 0.0) & (control.blend_weight >= 0.5) & (at_s > 0.0)]
    begun_s = round(float(first[0]), 2) if len(first) else None
    return (np.concatenate(found) if found else np.zeros(0)), int(late.sum()), begun_s


def _false_locks(log: RunLog) -> int:
    return sum(m.lock == music_match_t.LOCKED for m in log.events["MUSIC_MATCH"])


def _asked(log: RunLog) -> list[str]:
    """Return what the conductor asked for, in order."""
    starts = (m for m in log.events["SKILL_REQUEST"] if m.operation == skill_request_t.START)
    return [f"{m.skill} ({m.cause})" for m in starts]


def _nothing(_text: str) -> None:
    """Say nothing."""


def _print(result: dict[str, Any]) -> None:
    table = Table("stranger", "BPM", "dances from", "error p50", "p95", "asked")
    for row in result["runs"]:
        begun = "-" if row["begun_s"] is None else f"{row['begun_s']} s"
        table.add_row(
            row["track"], str(row["bpm"]), begun, f"{row['p50_ms']} ms", f"{row['p95_ms']} ms",
            row["asked"][0] if row["asked"] else "-",
        )  # fmt: skip
    console = Console()
    console.print(table)
    error = result["beat_phase_error_ms"]
    console.print(
        f"{result['strangers']} strangers: beat-phase error from 8 s on p50 {error['p50']} ms, "
        f"p95 {error['p95']} ms; danced {result['danced']:.1%} of the time from then on; "
        f"falls {result['falls']}, false locks {result['false_locks']}",
        highlight=False,
    )
