"""`downbeat eval speech --spoken`: from sound to the moving robot, in voices and noise."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from downbeat.catalog.tracks import BUNDLED_TRACKS, load_tracks
from downbeat.policies.manifest import load_skills
from downbeat.tools.demo import bundled_library
from downbeat.tools.errors import ToolError
from downbeat.tools.eval_mashup import play, say, write_show
from downbeat.tools.recordings import Library
from downbeat.tools.report import report
from downbeat.tools.rundir import new_run_dir
from downbeat.tools.spoken_lines import CLEAN, HOLD_S, NOISE, VOICES, spoken_show

SPEECH_NAME, HEARING_NAME = "speech.toml", "hearing.toml"
HEARING = '[conductor]\nunknown = "ignore"\n'
"""Nothing here is music: what the robot does then is another evaluation's."""
LARGE = ("run.lcmlog", "journal", "mashup.wav", "spoken.wav")
"""Of a run that was judged: half a gigabyte for nine of them."""
ACCURACY = {CLEAN: 0.9, "10": 0.8}
FALSE_TRIGGERS, SKEW_MS = 0.03, 100.0


@dataclass
class Level:
    """What became of all voices at one noise level.

    Attributes:
        noise: "clean", or signal over noise [dB].
        commands, obeyed: Commands, and those that the robot carried out.
        misheard: Commands that were taken for another one.
        others, false_triggers: Sentences that are no command, and those that were obeyed.
        questions, answered: Of the others: questions, and those that were answered.
        falls: Of the robot.
        latency_ms: From the end of a command to its intent, simulated work [ms].
        onset_s: From the end of a command to half of the weight [s].
        start_skew_ms, end_skew_ms: Gesture against the answer's sound [ms].
        without: Answers without their gesture.
        wrong: (voice, said, wanted, understood).
    """

    noise: str
    commands: int = 0
    obeyed: int = 0
    misheard: int = 0
    others: int = 0
    false_triggers: int = 0
    questions: int = 0
    answered: int = 0
    falls: int = 0
    latency_ms: list[float] = field(default_factory=list)
    onset_s: list[float] = field(default_factory=list)
    start_skew_ms: list[float] = field(default_factory=list)
    end_skew_ms: list[float] = field(default_factory=list)
    without: int = 0
    wrong: list[tuple[str, str, str, str]] = field(default_factory=list)

    def add(self, voice: str, metrics: dict[str, Any]) -> None:
        """Count a run."""
        speech = metrics["speech"]
        self.commands += speech["commands"]
        self.obeyed += speech["obeyed"]
        self.others += speech["others"]
        self.false_triggers += speech["false_triggers"]
        self.questions += speech["questions"]
        self.answered += speech["answered"]
        self.falls += metrics["falls"]
        gestures = speech["gestures"]
        self.start_skew_ms += gestures["start_skews_ms"]
        self.end_skew_ms += gestures["end_skews_ms"]
        self.without += gestures["without"]
        for row in speech["utterances"]:
            is_command = row["expected"] not in ("", "answer")
            if is_command and row["good"]:
                self.latency_ms.append(row["latency_ms"])
                self.onset_s += [] if row["onset_s"] is None else [row["onset_s"]]
            if not row["good"]:
                self.wrong.append((voice, row["text"], row["expected"], row["found"]))
                self.misheard += is_command and row["found"] not in ("", row["expected"])


def eval_spoken(
    runs: Path, noise: Sequence[str], voices: int, seed: int, as_json: bool, keep: bool
) -> int:
    """Speak, listen, dance and judge; 0 if every target is reached.

    Raises:
        ToolError: No such voice or noise level, or espeak-ng is missing.
    """
    if not 1 <= voices <= len(VOICES) or not noise or set(noise) - set(NOISE):
        raise ToolError(
            f"--voices {voices} --noise {' '.join(noise)} cannot be spoken; valid are 1 to "
            f"{len(VOICES)} voices, and {', '.join(NOISE)}."
        )
    run_dir = new_run_dir(runs)
    tracks = load_tracks(BUNDLED_TRACKS, load_skills())
    levels = []
    for name in noise:
        level = Level(name)
        for at, voice in enumerate(VOICES[:voices]):
            folder = run_dir / f"{name}_{voice.replace('+', '_')}"
            folder.mkdir()
            library = bundled_library(tracks, folder / "catalog")
            level.add(voice, _run(folder, library, voice, name, seed + at))
            if not keep:
                for large in LARGE:
                    (folder / large).unlink(missing_ok=True)
            say(f"{name}, {voice}: {level.obeyed} of {level.commands} commands so far")
        levels.append(level)
    result = summary(levels)
    (run_dir / "spoken.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    if as_json:
        print(json.dumps(result))
    else:
        _print(result)
    return 0 if result["good"] else 1


def _run(folder: Path, library: Library, voice: str, noise: str, seed: int) -> dict[str, Any]:
    show_sound = spoken_show(voice, noise, seed)
    (folder / SPEECH_NAME).write_text(f"hold_s = {HOLD_S}\n", encoding="utf-8")
    (folder / HEARING_NAME).write_text(HEARING, encoding="utf-8")
    show = write_show(folder, show_sound, library, seed, speech=SPEECH_NAME, hearing=HEARING_NAME)
    play(show, folder, show_sound, False, "")
    return report(folder)


def summary(levels: Sequence[Level]) -> dict[str, Any]:
    """Return the contract of `--json`: shares, their 95 % intervals, and whether all is good."""
    rows = {}
    good = True
    for level in levels:
        accuracy = _share(level.obeyed, level.commands)
        triggers = _share(level.false_triggers, level.others)
        is_good = (
            accuracy["share"] >= ACCURACY.get(level.noise, 0.0)
            and triggers["share"] <= FALSE_TRIGGERS
            and not level.falls
        )
        good &= is_good
        rows[level.noise] = {
            **asdict(level),
            "accuracy": accuracy,
            "false_trigger": triggers,
            "latency_ms": _percentiles(level.latency_ms),
            "onset_s": _percentiles(level.onset_s),
            "start_skew_ms": _percentiles(level.start_skew_ms),
            "end_skew_ms": _percentiles(level.end_skew_ms),
            "good": is_good,
        }
    start = _percentiles([ms for level in levels for ms in level.start_skew_ms])
    end = _percentiles([ms for level in levels for ms in level.end_skew_ms])
    for skew in (start, end):
        good &= skew["p95"] is not None and skew["p95"] <= SKEW_MS
    return {
        "levels": rows,
        "gestures": {"answers": len([1 for level in levels for _ in level.start_skew_ms]),
                     "without": sum(level.without for level in levels),
                     "start_skew_ms": start, "end_skew_ms": end},
        "falls": sum(level.falls for level in levels),
        "good": bool(good),
    }  # fmt: skip


def _share(count: int, of: int) -> dict[str, float]:
    """Return a share with Wilson's 95 % interval."""
    if not of:
        return {"share": 0.0, "low": 0.0, "high": 1.0}
    z, p = 1.96, count / of
    middle = (p + z * z / (2 * of)) / (1 + z * z / of)
    half = z * math.sqrt(p * (1 - p) / of + z * z / (4 * of * of)) / (1 + z * z / of)
    return {
        "share": round(p, 4),
        "low": round(max(0.0, middle - half), 4),
        "high": round(min(1.0, middle + half), 4),
    }


def _percentiles(values: Sequence[float]) -> dict[str, float | None]:
    if not values:
        return {"p50": None, "p95": None, "max": None}
    p50, p95 = np.percentile(values, [50, 95])
    return {
        "p50": round(float(p50), 2),
        "p95": round(float(p95), 2),
        "max": round(float(max(values)), 2),
    }


def _print(result: dict[str, Any]) -> None:
    console = Console()
    table = Table("noise", "commands obeyed", "misheard", "false triggers", "answered", "falls")
    for name, row in result["levels"].items():
        table.add_row(
            name if name == CLEAN else f"{name} dB",
            _told(row["obeyed"], row["commands"], row["accuracy"]),
            str(row["misheard"]),
            _told(row["false_triggers"], row["others"], row["false_trigger"]),
            f"{row['answered']} of {row['questions']}",
            str(row["falls"]),
        )
    console.print(table)
    gestures = result["gestures"]
    start, end = gestures["start_skew_ms"], gestures["end_skew_ms"]
    console.print(
        f"gesture against sound, {gestures['answers']} answers: start p95 {start['p95']} ms, "
        f"end p95 {end['p95']} ms (to reach: 100); without a gesture: {gestures['without']}"
    )
    for name, row in result["levels"].items():
        for voice, said, wanted, found in row["wrong"]:
            told = f"  {name}, {voice}: {said!r} wanted {wanted or 'nothing'}, got {found or '-'}"
            console.print(told, highlight=False)


def _told(count: int, of: int, share: dict[str, float]) -> str:
    low, high = 100 * share["low"], 100 * share["high"]
    return f"{count} of {of}, {100 * share['share']:.1f} % ({low:.1f} to {high:.1f})"
