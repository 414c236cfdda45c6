"""`downbeat demo --scene onstage`: music plays, somebody speaks over it, the robot answers."""

from __future__ import annotations

import json
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import soxr

from downbeat.catalog.setlist import SetEntry, SetList
from downbeat.catalog.tracks import BUNDLED_TRACKS, load_tracks
from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32
from downbeat.perception.tts import EspeakVoice
from downbeat.policies.manifest import load_skills
from downbeat.tools.errors import ToolError
from downbeat.tools.mashup import SAMPLE_RATE_HZ, Mashup, build_mashup

SPEECH_NAME = "speech.toml"
TRACK, FROM_S, SECONDS = "salsa_del_puerto", 8.0, 56.0
ABOVE_MUSIC_DB = 14.0
"""A microphone in the hand of who speaks; the music comes from the hall."""
HOLD_S = 8.0


@dataclass(frozen=True)
class Line:
    """A line of the scene: when [s], what, in which voice, and what it is to do."""

    at_s: float
    text: str
    voice: str
    expected: str


SCENE = (
    Line(12.0, "walk like a zombie", "en-us", "zombie"),
    Line(25.0, "what can you do", "en-gb", "answer"),
    Line(41.0, "dance like a robot", "en-us+m3", "robot"),
)


def build_scene(recordings: Any) -> Mashup:
    """Return the music with the lines spoken over it.

    Raises:
        ToolError: espeak-ng, which speaks the lines, is not installed.
    """
    tracks = load_tracks(BUNDLED_TRACKS, load_skills())
    set_list = SetList((SetEntry(TRACK, FROM_S, SECONDS),))
    music = build_mashup(set_list, tracks, recordings, announced=False)
    level = float(np.sqrt(np.mean(music.samples.astype(np.float64) ** 2)))
    mixed = 0.35 * music.samples
    rows = []
    for line in SCENE:
        sound = speak(line.text, line.voice, SAMPLE_RATE_HZ)
        at = round(line.at_s * SAMPLE_RATE_HZ)
        gain = 0.35 * level * 10 ** (ABOVE_MUSIC_DB / 20.0) / loud_rms(sound)
        mixed[at : at + len(sound)] += gain * sound[: len(mixed) - at]
        rows.append(
            {
                "start_s": line.at_s,
                "end_s": line.at_s + len(sound) / SAMPLE_RATE_HZ,
                "text": line.text,
                "expected": line.expected,
            }
        )
    truth = {**music.truth, "speech": rows, "sections": undisturbed(music.truth["sections"], rows)}
    return Mashup(mixed, set_list, truth)


def undisturbed(sections: list[dict[str, Any]], rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return what the music alone decides: before the first line, and well after the last."""
    first = rows[0]["start_s"]
    last = rows[-1]["end_s"] + HOLD_S + 3.0
    kept = []
    for section in sections:
        for begin, end in ((0.0, first), (last, float("inf"))):
            start_s, end_s = max(section["start_s"], begin), min(section["end_s"], end)
            if end_s - start_s > 6.0:
                boundary = "start" if start_s > section["start_s"] else section["boundary"]
                kept.append({**section, "start_s": start_s, "end_s": end_s, "boundary": boundary})
    return kept


def speech_toml(folder: Path) -> str:
    """Write the scene's speech.toml; returns its name."""
    text = f'hold_s = {HOLD_S}\n\n[voice]\noutput = "file"\n'
    (folder / SPEECH_NAME).write_text(text, encoding="utf-8")
    return SPEECH_NAME


def speak(text: str, voice: str, rate_hz: int, words_per_minute: int = 150) -> F32:
    """Return a sentence of espeak-ng at a rate.

    Raises:
        ToolError: It is not installed, or has no such voice.
    """
    try:
        spoken = EspeakVoice(voice, words_per_minute).say(text)
    except PerceptionError as error:
        raise ToolError(f"The scene is spoken by espeak-ng: {error}") from error
    if not len(spoken.samples):
        raise ToolError(f"espeak-ng has no voice '{voice}'; `espeak-ng --voices` lists them.")
    sound = spoken.samples.astype(np.float32) / 32768.0
    return soxr.resample(sound, 16_000, rate_hz).astype(np.float32)


def loud_rms(sound: F32) -> float:
    """Return the level of a voice while it sounds."""
    power = sound.astype(np.float64) ** 2
    return float(np.sqrt(power[power > 1e-5].mean()))


def has_espeak() -> bool:
    """Whether the scene can be spoken here."""
    try:
        subprocess.run(["espeak-ng", "--version"], capture_output=True, check=True)
    except (OSError, subprocess.SubprocessError):
        return False
    return True


def print_scene(metrics: dict[str, Any]) -> None:
    """Print what became of each line."""
    from rich.console import Console
    from rich.table import Table

    table = Table("said", "wanted", "understood", "after [s]", "good")
    for row in metrics["speech"]["utterances"]:
        after = "" if row["onset_s"] is None else f"{row['onset_s']:.2f}"
        table.add_row(
            row["text"], row["expected"], row["found"] or "-", after, "yes" if row["good"] else "no"
        )
    console = Console()
    console.print(table)
    console.print(json.dumps(metrics["speech"]["gestures"]), highlight=False)
