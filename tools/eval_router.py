"""`downbeat eval router`: what windows are called, by the paper's rule and by ours."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track as progress
from rich.table import Table
from scipy.stats import beta

from downbeat.perception.features import F32
from downbeat.perception.router import (
    LABEL_NAMES,
    MUSIC,
    SAMPLE_RATE_HZ,
    SKIP,
    SPEECH,
    Router,
    RouterConfig,
    paper_route,
)
from downbeat.perception.router_choice import make_router
from downbeat.tools.conditions import reverb
from downbeat.tools.console import say
from downbeat.tools.errors import ToolError
from downbeat.tools.matcher_sounds import add_noise, load_folder, pink_noise, synthetic_sounds
from downbeat.tools.recogniser_sentences import TEST_SENTENCES, TEST_VOICES
from downbeat.tools.router_sounds import at_rate, over_music, synthetic_voices

WINDOW_S = 5.0
AUDIBLE_DBFS = -50.0
"""Fades and gaps of a recording are no music and no speech; they are not asked for."""
BLOCK_S, JUDGE_EVERY_S = 0.05, 0.5
RATIOS_DB = (10, 5, 0, -5)
OVER = "speech over music {:+d} dB"
RULES = ("paper, v_frac 0.3", "paper", "ours")
PAPER_V_FRAC_MIN = 0.3
EXPECTED: dict[str, tuple[int, ...]] = {
    "music": (MUSIC,),
    "songs": (MUSIC,),
    "speech": (SPEECH,),
    "synthetic voices": (SPEECH,),
    OVER.format(10): (SPEECH,),
    OVER.format(5): (SPEECH,),
    OVER.format(0): (MUSIC, SPEECH),
    OVER.format(-5): (MUSIC,),
    "other sounds": (SKIP,),
    "noise and tones": (SKIP,),
    "silence": (SKIP,),
}
"""Where both are equally loud either is right, but not neither."""
ROOM = ", in a room"
ROOM_RT60_S, ROOM_SNR_DB, ROOM_GAIN = 0.5, 10.0, 0.2


@dataclass(frozen=True)
class RouterOptions:
    """What to evaluate.

    Attributes:
        music: Folder of music.
        songs: Folder of music with singing, a class of its own.
        speech: Folder of voices.
        other: Folder of sounds that are neither.
        model: What `downbeat models export ast` wrote; None: the embedded router.
        per_source: Windows of a recording at most.
        seed: Of rooms and mixtures.
        cost: Measure the cost of the stream, too.
    """

    music: Path | None
    songs: Path | None
    speech: Path | None
    other: Path | None
    model: Path | None = None
    per_source: int = 12
    seed: int = 7
    cost: bool = True


@dataclass
class Row:
    """One class of sound.

    Attributes:
        expected: Labels that are right.
        sources: Recordings.
        labels: By rule, of the same numbers: ours; the paper's with our thresholds, and with the
            voiced fraction of the project's first study.
    """

    expected: tuple[int, ...]
    sources: set[str] = field(default_factory=set)
    labels: dict[str, list[int]] = field(default_factory=lambda: {rule: [] for rule in RULES})

    def shares(self, rule: str) -> dict[str, float]:
        """Return the share of each label, of the right ones, and a 95 % interval of that."""
        labels = self.labels[rule]
        n, right = len(labels), sum(label in self.expected for label in labels)
        low = float(beta.ppf(0.025, right, n - right + 1)) if right else 0.0
        high = float(beta.ppf(0.975, right + 1, n - right)) if right < n else 1.0
        found = {name: labels.count(label) / n for label, name in LABEL_NAMES.items()}
        found |= {"right": right / n, "low95": low, "high95": high}
        return {name: round(value, 4) for name, value in found.items()}


class RouterStudy:
    """One run."""

    def __init__(self, options: RouterOptions) -> None:
        """Load the model and the recordings.

        Raises:
            ToolError: No folder is given.
            PerceptionError: A folder or the model cannot be read.
        """
        self.options = options
        if not any((options.music, options.songs, options.speech, options.other)):
            raise ToolError(
                "There is nothing to hear; valid are --music, --songs, --speech and --other DIR."
            )
        self.router = make_router("ast" if options.model else "embedded", options.model)
        self.config: RouterConfig = self.router.config
        self.rows: dict[str, Row] = {}
        self.cost_percent = float("nan")
        folders = (options.music, options.songs, options.speech, options.other)
        self.music, self.songs, self.speech, self.other = map(_folder, folders)

    def run(self, is_quiet: bool) -> RouterStudy:
        """Hear everything."""
        rng = np.random.default_rng(self.options.seed)
        for name, sound in self._sounds(is_quiet):
            for source, window in self._windows(sound):
                self._hear(name, source, window)
                if name in ("music", "songs", "speech", "synthetic voices"):
                    self._hear(name + ROOM, source, in_a_room(window, rng), name)
        self._mixtures(rng, is_quiet)
        if self.options.cost:
            self.cost_percent = self._cost()
        return self

    def _sounds(self, is_quiet: bool) -> Iterator[tuple[str, Mapping[str, F32]]]:
        made = {r.name: at_rate(r) for r in synthetic_sounds(10.0)}
        silence = {"silence": made.pop("silence")}
        rng = np.random.default_rng(3)
        silence["hiss -75 dB"] = (1.8e-4 * rng.standard_normal(160_000)).astype(np.float32)
        silence["offset"] = np.full(160_000, 0.1, np.float32)
        voices = synthetic_voices(TEST_VOICES, tuple(TEST_SENTENCES)) if self.speech else {}
        classes = {
            "music": self.music,
            "songs": self.songs,
            "speech": self.speech,
            "synthetic voices": voices,
            "other sounds": self.other,
            "noise and tones": made,
            "silence": silence,
        }
        for name, sounds in classes.items():
            for key in progress(list(sounds), name, disable=is_quiet, transient=True):
                yield name, {key: sounds[key]}

    def _windows(self, sounds: Mapping[str, F32]) -> Iterator[tuple[str, F32]]:
        """Yield windows of a recording, evenly spread; audible ones, but for silence itself."""
        count = round(WINDOW_S * SAMPLE_RATE_HZ)
        for name, sound in sounds.items():
            whole = np.pad(sound, (0, max(0, count - len(sound))))
            number = min(self.options.per_source, len(whole) // count)
            for first in np.linspace(0, len(whole) - count, number).astype(int):
                window = whole[first : first + count]
                level = 10.0 * np.log10(np.mean(window.astype(np.float64) ** 2) + 1e-12)
                if level >= AUDIBLE_DBFS or name in ("silence", "hiss -75 dB"):
                    yield name, window

    def _mixtures(self, rng: np.random.Generator, is_quiet: bool) -> None:
        """Hear every window of speech over a piece of music, at every ratio."""
        played = {**self.music, **self.songs}
        if not played:
            return
        names = sorted(played)
        count = round(WINDOW_S * SAMPLE_RATE_HZ)
        for key in progress(list(self.speech), "mixtures", disable=is_quiet, transient=True):
            for source, window in self._windows({key: self.speech[key]}):
                for ratio_db in RATIOS_DB:
                    music = played[names[int(rng.integers(len(names)))]]
                    music = np.resize(music, max(len(music), count))
                    first = int(rng.integers(len(music) - count + 1))
                    part = music[first : first + count]
                    if np.sqrt(np.mean(part**2)) < 10.0 ** (AUDIBLE_DBFS / 20.0):
                        continue
                    mixed = over_music(window, part, ratio_db)
                    mixed *= np.float32(min(1.0, 0.9 / np.abs(mixed).max()))
                    self._hear(OVER.format(ratio_db), source, mixed)

    def _hear(self, name: str, source: str, window: F32, expected_as: str = "") -> None:
        self.router.reset()
        self.router.hear(window, 0)
        found = self.router.judge(0.0)
        row = self.rows.setdefault(name, Row(EXPECTED[expected_as or name]))
        row.sources.add(source)
        scores = (found.p_music, found.p_speech, found.v_frac)
        strict = replace(self.config, v_frac_min=PAPER_V_FRAC_MIN)
        is_quiet = name == "silence"
        row.labels["ours"].append(found.label)
        for rule, config in (("paper", self.config), ("paper, v_frac 0.3", strict)):
            row.labels[rule].append(found.label if is_quiet else paper_route(*scores, config))

    def _cost(self) -> float:
        """Return the share of one core [%] for a stream with two judgements a second."""
        sounds = [*self.music.values(), *self.songs.values(), *self.speech.values()]
        sound = np.resize(np.concatenate(sounds)[: 60 * SAMPLE_RATE_HZ], 30 * SAMPLE_RATE_HZ)
        return stream_cost_percent(self.router, sound)

    def as_json(self) -> dict[str, Any]:
        """Return the contract of `--json`; shares are 0..1."""
        return {
            "model": self.router.name,
            "cost_percent_of_a_core": round(self.cost_percent, 3),
            "classes": {
                name: {
                    "expected": [LABEL_NAMES[label] for label in row.expected],
                    "n": len(row.labels["ours"]),
                    "sources": len(row.sources),
                    **{rule: row.shares(rule) for rule in RULES},
                }
                for name, row in self.rows.items()
            },
        }


def stream_cost_percent(router: Router, sound: F32) -> float:
    """Return the time a router needs for a stream, as a share of one core [%]."""
    block, every = round(BLOCK_S * SAMPLE_RATE_HZ), round(JUDGE_EVERY_S / BLOCK_S)
    router.reset()
    begin = time.process_time()
    for number, first in enumerate(range(0, len(sound) - block + 1, block)):
        router.hear(sound[first : first + block], first * 1_000_000 // SAMPLE_RATE_HZ)
        if number % every == every - 1:
            router.judge(0.0)
    return (time.process_time() - begin) / (len(sound) / SAMPLE_RATE_HZ) * 100.0


def in_a_room(window: F32, rng: np.random.Generator) -> F32:
    """Return a window as heard across a room with a fan: half a second of echo, pink noise."""
    echo = reverb(ROOM_RT60_S, 0.0)(window, SAMPLE_RATE_HZ, rng)
    noisy = add_noise(echo, pink_noise(len(echo), rng), ROOM_SNR_DB, SAMPLE_RATE_HZ)
    return noisy * np.float32(ROOM_GAIN)


def _folder(folder: Path | None) -> dict[str, F32]:
    return {} if folder is None else {n: at_rate(r) for n, r in load_folder(folder, say).items()}


def eval_router(options: RouterOptions, as_json: bool) -> int:
    """Run the study and print it; 0."""
    study = RouterStudy(options).run(is_quiet=as_json)
    if as_json:
        print(json.dumps(study.as_json()))
        return 0
    found = study.as_json()
    table = Table(title=f"Router {found['model']}: windows of {WINDOW_S:g} s")
    for heading in ("class (recordings)", "expected", "n", "rule", *LABEL_NAMES.values(), "right"):
        table.add_column(heading)
    for name, row in found["classes"].items():
        for rule in RULES:
            part = row[rule]
            shares = [f"{part[label]:.1%}" for label in LABEL_NAMES.values()]
            interval = f"{part['right']:.1%} ({part['low95']:.1%} to {part['high95']:.1%})"
            head = (f"{name} ({row['sources']})", " or ".join(row["expected"]), str(row["n"]))
            table.add_row(*(head if rule == RULES[0] else ("", "", "")), rule, *shares, interval)
    Console().print(table)
    if options.cost:
        print(f"cost of the stream: {study.cost_percent:.2f} % of one core")
    return 0
