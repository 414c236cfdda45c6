"""metrics.json of a run, from its log and the truth file alone (architecture, section 9).

Definitions. Onset: first tick at which the asked skill has at least half the weight. Followed: the
asked skill has at least half the weight for 80 % of the section (start and unannounced: of what is
left after 3 s) and the robot is upright. Announced and unannounced boundaries are never pooled; the
first section of a show counts with the unannounced, since nobody could know it.
"""

from __future__ import annotations

import json
import platform
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from downbeat.lcm_types import audio_source_t, control_status_t, skill_status_t
from downbeat.tools.errors import ToolError
from downbeat.tools.metrics_beats import BeatReport, SkillTables, beat_report
from downbeat.tools.metrics_checks import checks_report
from downbeat.tools.metrics_sections import SectionResult, evaluate_sections, fallen_spans
from downbeat.tools.metrics_speech import speech_report
from downbeat.tools.runlog import LOG_NAME, RunLog, read_run
from downbeat.tools.truth import TRUTH_NAME, Truth, read_truth

METRICS_NAME = "metrics.json"
RUN_NAME = "run.json"
"""Optional: what the run itself knew (seed, versions, replay_equal)."""
VERSIONED = ("downbeat", "mujoco", "onnxruntime", "numpy", "lcm")
PASSIVE_MODES = (
    control_status_t.DAMPING,
    control_status_t.FALLBACK,
    control_status_t.ESTOP,
)


def compute_metrics(run_dir: Path, skills: SkillTables | None = None) -> dict[str, Any]:
    """Compute all metrics of a run folder.

    Args:
        run_dir: Holds run.lcmlog and truth.json.
        skills: Built tempo and reference of every skill; None: the bundled ones.

    Returns:
        A dictionary ready for JSON; unknown values are None.

    Raises:
        ToolError: A file is missing or wrong.
    """
    log = read_run(run_dir / LOG_NAME)
    truth = read_truth(run_dir / TRUTH_NAME)
    return metrics_of(log, truth, skills or SkillTables.bundled(), _run_facts(run_dir))


def write_metrics(run_dir: Path, metrics: dict[str, Any]) -> Path:
    """Write metrics.json into the run folder."""
    path = run_dir / METRICS_NAME
    path.write_text(json.dumps(metrics, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return path


def metrics_of(
    log: RunLog, truth: Truth, skills: SkillTables, facts: dict[str, Any] | None = None
) -> dict[str, Any]:
    """Compute all metrics; see `compute_metrics`."""
    facts = facts or {}
    zero_utime = first_sample_utime(log)
    results = evaluate_sections(log, truth, zero_utime)
    beats = beat_report(log, truth, zero_utime, results, skills)
    spans = fallen_spans(log)
    announced = [r for r in results if r.section.boundary == "announced"]
    surprising = [r for r in results if r.section.boundary != "announced"]
    onset_errors_ms = [abs(r.onset_s) * 1e3 for r in announced if r.onset_s is not None]
    reactions_s = [r.onset_s for r in surprising if r.onset_s is not None]
    return {
        "falls": len(spans),
        "safety_trips": _safety_trips(log),
        "announced": {
            "total": len(announced),
            "followed": sum(r.followed for r in announced),
            "onset_error_ms": percentiles(onset_errors_ms, (50, 95)),
        },
        "unannounced": {
            "total": len(surprising),
            "followed": sum(r.followed for r in surprising),
            "reaction_s": percentiles(reactions_s, (50, 95), digits=3),
        },
        "beat_phase_error_ms": percentiles(beats.errors_ms, (50, 95)),
        "physical_lag_ms": _rounded(beats.physical_lag_ms, 1),
        "transitions": _transitions(log),
        "checks": checks_report(log),
        "speech": speech_report(log, truth.raw, zero_utime),
        "control": _control(log),
        "bus": {
            "lost": int(log.control.states_lost[-1]),
            "rejected": int(log.control.rejected[-1]),
        },
        "chunks": _chunks(log, truth, zero_utime),
        "plant_realtime_factor": _plant_realtime_factor(log),
        "replay_equal": facts.get("replay_equal"),
        "versions": facts.get("versions") or versions(),
        "seed": facts.get("seed", truth.seed),
        "announced_show": truth.announced,
        "duration_s": truth.duration_s,
        "bad_messages_in_log": log.bad_messages,
        "sections": [_row(result, beats) for result in results],
    }


def first_sample_utime(log: RunLog) -> int:
    """Return when sample 0 sounded [us].

    Raises:
        ToolError: The log holds no started audio source.
    """
    for message in log.events["AUDIO_SOURCE"]:
        if message.state == audio_source_t.STARTED:
            return int(message.first_sample_utime)
    raise ToolError(
        "The log holds no AUDIO_SOURCE with state STARTED, so nothing ties the sound to the time"
        f" base; the listener publishes it when it starts ({LOG_NAME})."
    )


def percentiles(values: Any, points: tuple[float, ...], digits: int = 1) -> dict[str, float | None]:
    """Return {"p50": .., "p95": .., "max": ..}; None without values."""
    names = [f"p{str(point).replace('.', '')}" for point in points]
    array = np.asarray(values, dtype=np.float64)
    if array.size == 0:
        return dict.fromkeys([*names, "max"])
    found = np.percentile(array, points)
    result = {name: _rounded(value, digits) for name, value in zip(names, found)}
    result["max"] = _rounded(array.max(), digits)
    return result


def versions() -> dict[str, str]:
    """Return the versions of what computes."""
    found = {"python": platform.python_version(), "machine": platform.machine()}
    for name in VERSIONED:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


def _rounded(value: float | None, digits: int) -> float | None:
    if value is None or not np.isfinite(value):
        return None
    return round(float(value), digits)


def _run_facts(run_dir: Path) -> dict[str, Any]:
    path = run_dir / RUN_NAME
    if not path.is_file():
        return {}
    facts = json.loads(path.read_text(encoding="utf-8"))
    return facts if isinstance(facts, dict) else {}


def _safety_trips(log: RunLog) -> int:
    """Count how often a fault made the robot passive."""
    control = log.control
    tripped = np.isin(control.mode, PASSIVE_MODES) & (control.fault != 0)
    return int(np.count_nonzero(tripped[1:] & ~tripped[:-1]) + bool(tripped[0]))


def _transitions(log: RunLog) -> dict[str, int]:
    """Count the requests that came to run, by how, and those refused."""
    plans: dict[tuple[int, int], str] = {}
    refused = set()
    for message in log.events["SKILL_STATUS"]:
        key = (int(message.source), int(message.request_id))
        if message.state == skill_status_t.REFUSED:
            refused.add(key)
        elif message.state == skill_status_t.RUNNING and message.plan:
            plans[key] = message.plan
    counts = dict.fromkeys(("direct", "blended", "via_stand"), 0)
    for plan in plans.values():
        counts[plan] = counts.get(plan, 0) + 1
    return {**counts, "refused": len(refused)}


def _control(log: RunLog) -> dict[str, Any]:
    control = log.control
    points = (50, 99, 99.9)
    return {
        "ticks": int(control.utime.size),
        "missed": int(control.missed.max()),
        "lateness_us": percentiles(control.lateness_us, points, 0),
        "compute_us": percentiles(control.compute_us, points, 0),
    }


def _chunks(log: RunLog, truth: Truth, zero_utime: int) -> dict[str, int]:
    """Count the windows heard while a track played, and those that named it.

    A window stands for the track at its middle; windows across a cut are not left out.
    """
    middles = {
        int(m.header.utime): 0.5 * (m.window_start_utime + m.window_end_utime)
        for m in log.events["AUDIO_CLASS"]
    }
    total = correct = 0
    seen = set()
    for message in log.events["MUSIC_MATCH"]:
        utime = int(message.header.utime)
        if utime in seen:
            continue  # the same window again, after a change of the lock
        seen.add(utime)
        segment = truth.segment_at((middles.get(utime, utime) - zero_utime) * 1e-6)
        if segment is not None:
            total += 1
            correct += bool(message.accepted) and message.track == segment.track
    return {"total": total, "correct": int(correct)}


def _plant_realtime_factor(log: RunLog) -> float | None:
    """Return simulated time over show time, from the physics steps that states count."""
    states = log.states
    if states.utime.size < 2 or not np.any(states.source == 0):
        return None
    elapsed_us = int(states.utime[-1] - states.utime[0])
    steps = int(states.tick[-1] - states.tick[0])
    step_us = float(np.median(np.diff(states.utime) / np.maximum(np.diff(states.tick), 1)))
    return _rounded(steps * step_us / elapsed_us, 4) if elapsed_us > 0 else None


def _row(result: SectionResult, beats: BeatReport) -> dict[str, Any]:
    section = result.section
    is_announced = section.boundary == "announced"
    onset_ms = None if result.onset_s is None else result.onset_s * 1e3
    return {
        "start_s": section.start_s,
        "end_s": section.end_s,
        "track": section.track,
        "skill": section.skill,
        "boundary": section.boundary,
        "onset_error_ms": _rounded(onset_ms, 1) if is_announced else None,
        "reaction_s": None if is_announced else _rounded(result.onset_s, 3),
        "followed_fraction": _rounded(result.fraction, 4),
        "followed": result.followed,
        "upright": result.upright,
        "beat_phase_error_p95_ms": _rounded(beats.section_p95_ms.get(result.index), 1),
        "physical_lag_ms": _rounded(beats.section_lag_ms.get(result.index), 1),
    }
