"""Calibrate the embedded recogniser: speak commands and other sentences, freeze what decides.

`python -m downbeat.tools.calibrate_recogniser` prints the table of the frozen calibration over
test voices and test sentences; with `--write` it first makes a new one from calibration voices
and calibration sentences, which the test never hears. Nothing of the test is used to choose.
"""

from __future__ import annotations

import argparse
import io
import json
import random
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import soundfile
import soxr

from downbeat.perception.features import F32
from downbeat.perception.recogniser_grammar import STOP_WORDS, plain
from downbeat.perception.recogniser_pocketsphinx import (
    CALIBRATION_FILE,
    FEATURES,
    Calibration,
    PocketsphinxRecogniser,
    load_calibration,
)
from downbeat.policies.manifest import load_skills
from downbeat.tools import recogniser_sentences as said
from downbeat.tools.errors import ToolError

RATE_HZ = 16_000
PAD_S = 0.25
MAX_FALSE_ACCEPTS = 0.02
"""On calibration sentences; the test is to stay within 3 %."""


@dataclass(frozen=True, slots=True)
class Item:
    """Something spoken.

    Attributes:
        kind: "command", "sentence" or "language" (another one than English).
        phrase: The skill phrase or stop word in it; "" for what is no command.
        text: The words.
        voice: Of espeak-ng.
        words_per_minute: Pace.
    """

    kind: str
    phrase: str
    text: str
    voice: str
    words_per_minute: int


@dataclass(frozen=True, slots=True)
class Heard:
    """An item and what the recogniser made of it, before anything is refused."""

    item: Item
    text: str
    features: tuple[float, ...]
    compute_s: float
    sound_s: float

    @property
    def right(self) -> bool:
        """The phrase is in the text, whole and not negated."""
        padded = f" {self.text} "
        negated = any(f" {word} " in padded for word in ("don't", "not", "never"))
        return bool(self.item.phrase) and f" {self.item.phrase} " in padded and not negated


def phrases() -> list[str]:
    """Return the phrases of all bundled skills, sorted."""
    return sorted({plain(text) for skill in load_skills().values() for text in skill.phrases})


def items(test: bool, share: int = 1) -> list[Item]:
    """Return what is spoken.

    Args:
        test: The test half: other voices, other carriers, other sentences.
        share: Only every so many-th, for a quick look.
    """
    voices = said.TEST_VOICES if test else said.CALIBRATION_VOICES
    forms = said.TEST_FORMS if test else said.CALIBRATION_FORMS
    others = said.TEST_OTHER_LANGUAGES if test else said.CALIBRATION_OTHER_LANGUAGES
    paces = said.WORDS_PER_MINUTE
    found = []
    for at, phrase in enumerate(sorted({*phrases(), *STOP_WORDS})):
        for turn in range(3):
            form = forms[0] if turn < 2 else forms[1 + at % (len(forms) - 1)]
            voice = voices[(at + 2 * turn) % len(voices)]
            found.append(Item("command", phrase, form.format(phrase), voice, paces[turn]))
    for at, text in enumerate(said.TEST_SENTENCES if test else said.CALIBRATION_SENTENCES):
        for turn in range(3):
            voice = voices[(at + 2 * turn) % len(voices)]
            found.append(Item("sentence", "", text, voice, paces[turn]))
    for language, texts in others.items():
        found += [
            Item("language", "", text, language + variant, 160)
            for text in texts
            for variant in ("", "+f2")
        ]
    return found[::share]


def speak(text: str, voice: str, words_per_minute: int) -> F32:
    """Return (n,) speech at 16 kHz, RMS 0.05.

    Raises:
        ToolError: espeak-ng is not installed, or does not know the voice.
    """
    if shutil.which("espeak-ng") is None:
        raise ToolError("espeak-ng is not installed; `apt install espeak-ng` brings it.")
    command = ["espeak-ng", "-v", voice, "-s", str(words_per_minute), "--stdout", text]
    raw = subprocess.run(command, capture_output=True, check=False, timeout=30).stdout
    if len(raw) < 100:
        raise ToolError(f"espeak-ng has no voice {voice!r}; `espeak-ng --voices` lists them.")
    samples, rate = soundfile.read(io.BytesIO(raw), dtype="float32")
    samples = soxr.resample(samples, rate, RATE_HZ)
    return (samples * (0.05 / np.sqrt(np.mean(samples**2)))).astype(np.float32)


def in_noise(samples: F32, snr_db: float, rng: np.random.Generator, pink: bool) -> F32:
    """Return speech with noise under it and for `PAD_S` around it.

    Args:
        samples: (n,) RMS 0.05.
        snr_db: Over the whole speech.
        rng: Source of the noise.
        pink: Falling by 3 dB per octave above 40 Hz; else white.
    """
    padded = np.pad(samples, round(PAD_S * RATE_HZ))
    noise = rng.standard_normal(len(padded))
    if pink:
        hertz = np.fft.rfftfreq(len(noise), 1 / RATE_HZ)
        noise = np.fft.irfft(np.fft.rfft(noise) / np.sqrt(np.maximum(hertz, 40.0)), len(noise))
        noise /= noise.std()
    return (padded + 0.05 * 10 ** (-snr_db / 20) * noise).astype(np.float32)


def hear(
    recogniser: PocketsphinxRecogniser, spoken: Iterable[Item], snr_db: float, seed: int
) -> Iterator[Heard]:
    """Speak the items in noise, white and pink in turn, and let them be recognised."""
    rng = np.random.default_rng(seed)
    for at, item in enumerate(spoken):
        voice = speak(item.text, item.voice, item.words_per_minute)
        sound = in_noise(voice, snr_db, rng, pink=bool(at % 2))
        begin = time.process_time()
        text, features = recogniser.score(sound)
        yield Heard(item, text, features, time.process_time() - begin, len(sound) / RATE_HZ)


def fit(heard: list[Heard], info: str) -> Calibration:
    """Return the logistic regression of "this was said", and the threshold.

    Wrong answers to real commands count as not said, so they are refused like other sentences.
    """
    rows = [one for one in heard if one.text]
    x = np.array([one.features for one in rows])  # (n, f)
    y = np.array([one.right for one in rows], float)
    centre, spread = x.mean(0), x.std(0)
    z = np.column_stack(((x - centre) / spread, np.ones(len(x))))
    w = np.zeros(z.shape[1])
    for _ in range(50):  # Newton's method with a little ridge
        p = 1 / (1 + np.exp(-z @ w))
        curve = z.T @ (z * (p * (1 - p))[:, None]) + 1e-2 * np.eye(len(w))
        w += np.linalg.solve(curve, z.T @ (y - p) - 1e-2 * w)
    weights = w[:-1] / spread
    offset = float(w[-1] - weights @ centre)
    made = Calibration(tuple(float(v) for v in weights), offset, 0.0)
    foreign = [one for one in heard if one.item.kind != "command"]
    scores = np.sort([made.confidence(one.features) if one.text else 0.0 for one in foreign])
    allowed = int(MAX_FALSE_ACCEPTS * len(scores))
    threshold = float(np.nextafter(scores[len(scores) - 1 - allowed], 2.0))
    return Calibration(made.weights, offset, threshold, info)


def rates(heard: list[Heard], calibration: Calibration) -> dict[str, Any]:
    """Return the shares of right, wrong and refused commands and of false accepts."""
    taken = [
        (one, bool(one.text) and calibration.confidence(one.features) >= calibration.threshold)
        for one in heard
    ]

    def share(rows: list[bool]) -> float:
        return round(sum(rows) / len(rows), 4) if rows else float("nan")

    commands = [(one, ok) for one, ok in taken if one.item.kind == "command"]
    several = [(one, ok) for one, ok in commands if " " in one.item.phrase]
    return {
        "commands": len(commands),
        "right": share([ok and one.right for one, ok in commands]),
        "wrong": share([ok and not one.right for one, ok in commands]),
        "refused": share([not ok for _, ok in commands]),
        "right_of_several_words": share([ok and one.right for one, ok in several]),
        "sentences": sum(one.item.kind == "sentence" for one, _ in taken),
        "false_accepts": share([ok for one, ok in taken if one.item.kind == "sentence"]),
        "false_accepts_languages": share([ok for one, ok in taken if one.item.kind == "language"]),
        "real_time_factor": round(
            sum(one.compute_s for one in heard) / sum(one.sound_s for one in heard), 4
        ),
    }


def calibrate(share: int = 1) -> tuple[Calibration, dict[str, Any]]:
    """Return a new calibration from the calibration half at 20 dB, and its own rates."""
    blank = Calibration((0.0,) * len(FEATURES), 0.0, 0.0)
    recogniser = PocketsphinxRecogniser(phrases(), blank)
    spoken = items(test=False, share=share)
    random.Random(0).shuffle(spoken)
    heard = list(hear(recogniser, spoken, 20.0, seed=1))
    info = f"{len(heard)} utterances of espeak-ng at 20 dB, calibration voices and sentences"
    made = fit(heard, info)
    return made, rates(heard, made)


def write(calibration: Calibration) -> None:
    """Freeze it where the recogniser looks."""
    table = {
        "info": calibration.info,
        "weights": dict(zip(FEATURES, (round(w, 6) for w in calibration.weights))),
        "offset": round(calibration.offset, 6),
        "threshold": round(calibration.threshold, 6),
    }
    CALIBRATION_FILE.parent.mkdir(exist_ok=True)
    CALIBRATION_FILE.write_text(json.dumps(table, indent=2) + "\n", encoding="utf-8")


def evaluate(snr_db: float = 20.0, share: int = 1, details: bool = False) -> dict[str, Any]:
    """Return the rates of the frozen calibration on the test half."""
    calibration = load_calibration()
    recogniser = PocketsphinxRecogniser(phrases(), calibration)
    heard = list(hear(recogniser, items(test=True, share=share), snr_db, seed=2))
    found = {"snr_db": snr_db, **rates(heard, calibration)}
    if details:
        found["confused"] = [
            f"{one.item.text} ({one.item.voice}) -> {one.text}"
            for one in heard
            if not one.right
            and one.text
            and calibration.confidence(one.features) >= calibration.threshold
        ]
    return found


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="make and freeze a new calibration")
    parser.add_argument("--snr-db", type=float, nargs="*", default=[20.0], help="of the test")
    parser.add_argument("--share", type=int, default=1, help="only every so many-th utterance")
    parser.add_argument("--details", action="store_true", help="list what was accepted wrongly")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    arguments = parser.parse_args()
    result: dict[str, Any] = {}
    if arguments.write:
        made, result["calibration"] = calibrate(arguments.share)
        write(made)
    result["test"] = [evaluate(snr, arguments.share, arguments.details) for snr in arguments.snr_db]
    result["peak_memory_mib"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    if arguments.json:
        print(json.dumps(result))
        return
    rows = [("calibration", result["calibration"])] if "calibration" in result else []
    rows += [(f"test {row['snr_db']:g} dB", row) for row in result["test"]]
    for title, row in rows:
        print(title)
        for key, value in row.items():
            print(f"  {key:<26}{value}")
    print(f"peak memory of the process: {result['peak_memory_mib']} MiB", file=sys.stderr)


if __name__ == "__main__":
    main()
