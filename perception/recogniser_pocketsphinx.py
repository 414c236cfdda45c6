"""The embedded recogniser: a grammar of the skills' phrases that says nothing rather than wrong.

Two searches hear the same sound: the grammar, and a free loop over all phones. What is a command
fits the grammar nearly as well as it fits the loop; any other sentence fits it far worse. The
log-likelihood ratio of both, over the utterance and over its worst word, decides, by weights that
`python -m downbeat.tools.calibrate_recogniser` froze.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32
from downbeat.perception.recogniser_grammar import british, grammar, pronounce, words
from downbeat.perception.recognisers import SAMPLE_RATE_HZ, Recognition, nothing, usable

CALIBRATION_FILE = Path(__file__).parent / "data" / "recogniser_pocketsphinx.json"
MAX_COMMAND_S = 8.0
"""Longer speech is no command, and is not worth the time that decoding it takes."""

FEATURES = ("ratio", "worst_word", "log_frames")

_FRAME_SAMPLES = 160
_DITHER_DB = -28.0
"""Below the speech: digital silence and very clean sound break the acoustic model."""

_BEAMS = {"beam": 1e-80, "wbeam": 1e-60, "pbeam": 1e-80}
_FILLERS = {"<sil>", "<s>", "</s>", "(NULL)", "SIL", "[NOISE]", "[SPEECH]", "+NSN+", "+SPN+"}


@dataclass(frozen=True, slots=True)
class Calibration:
    """What decides that a grammar's answer was really said.

    Attributes:
        weights: One per feature, in their order.
        offset: Added; the logistic function of the sum is the confidence.
        threshold: Confidence below which nothing was recognised.
        info: How it was made, for the reader.
    """

    weights: tuple[float, ...]
    offset: float
    threshold: float
    info: str = ""

    def confidence(self, features: tuple[float, ...]) -> float:
        """Return 0..1."""
        total = self.offset + sum(w * x for w, x in zip(self.weights, features))
        return 1.0 / (1.0 + math.exp(-max(min(total, 50.0), -50.0)))


def load_calibration(path: Path | None = None) -> Calibration:
    """Load the frozen weights.

    Raises:
        PerceptionError: The file is missing or is none.
    """
    file = path or CALIBRATION_FILE
    try:
        table = json.loads(file.read_text(encoding="utf-8"))
        weights = tuple(float(table["weights"][name]) for name in FEATURES)
        return Calibration(
            weights, float(table["offset"]), float(table["threshold"]), str(table["info"])
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise PerceptionError(
            f"{file} is no calibration of the embedded recogniser ({error!r}); "
            "`python -m downbeat.tools.calibrate_recogniser --write` makes one."
        ) from error


class PocketsphinxRecogniser:
    """Hears the given phrases and the stop words, in English; everything else is nothing."""

    name = "pocketsphinx"

    def __init__(self, phrases: Iterable[str], calibration: Calibration | None = None) -> None:
        """Load the acoustic model that the package carries and build the grammar.

        Args:
            phrases: What the skills are called by.
            calibration: When an answer counts; None: the frozen one.

        Raises:
            PerceptionError: The package is missing, or refuses the grammar.
        """
        try:
            import pocketsphinx
        except ImportError as error:
            raise PerceptionError(
                "The recogniser pocketsphinx is not installed; `pip install pocketsphinx` brings "
                "it, and backend = openai or whisper needs none."
            ) from error
        self.calibration = calibration or load_calibration()
        self._decoder = pocketsphinx.Decoder(
            # All senones: only then are scores of two searches on one scale.
            lm=None, loglevel="FATAL", compallsen=True, bestpath=False, **_BEAMS
        )  # fmt: skip
        text = grammar(phrases)
        for word in words(text):
            self._add(word)
        try:
            self._decoder.add_jsgf_string("commands", text)
            self._decoder.add_allphone_file("phones", None)
        except (RuntimeError, ValueError) as error:
            raise PerceptionError(
                f"The phrases make no grammar ({error}); valid are words of Latin letters."
            ) from error

    def recognise(self, samples: F32, language: str = "en") -> Recognition:
        """Recognise one utterance; see `Recogniser`."""
        begin = time.perf_counter_ns()
        sound = usable(samples)
        english = language.lower().split("-")[0] in ("", "en")
        if not english or not len(sound) or len(sound) > MAX_COMMAND_S * SAMPLE_RATE_HZ:
            return nothing(self.name, (time.perf_counter_ns() - begin) // 1000)
        text, features = self.score(sound)
        confidence = self.calibration.confidence(features) if text else math.nan
        compute_us = (time.perf_counter_ns() - begin) // 1000
        if not text or confidence < self.calibration.threshold:
            return Recognition("", confidence, self.name, compute_us)
        return Recognition(text, confidence, self.name, compute_us, tuple(text.split()))

    def score(self, sound: F32) -> tuple[str, tuple[float, ...]]:
        """Return the best sentence of the grammar and what speaks for it.

        Args:
            sound: (n,) mono, 16 kHz, full scale 1, not digital silence.

        Returns:
            The text ("" where no path fits) and the values of `FEATURES`.
        """
        pcm = (np.clip(_dithered(sound), -1, 1) * 32767).astype("<i2").tobytes()
        count = len(sound) // _FRAME_SAMPLES + 2
        text, command = self._search("commands", pcm)
        spoken = [part for part in command if part[0] not in _FILLERS]
        if not spoken:
            return "", (0.0,) * len(FEATURES)
        _, free = self._search("phones", pcm)
        ratio = np.append(0.0, np.cumsum(_per_frame(command, count) - _per_frame(free, count)))
        voiced = [part for part in free if part[0] not in _FILLERS] or spoken
        first = min(spoken[0][1], voiced[0][1])
        last = max(spoken[-1][2], voiced[-1][2]) + 1
        mean = [
            1000.0 * float(ratio[end] - ratio[start]) / (end - start)
            for start, end in ((first, last), *((s, e + 1) for _, s, e, _ in spoken))
        ]
        return text, (mean[0], min(mean[1:]), math.log(last - first))

    def _search(self, name: str, pcm: bytes) -> tuple[str, list[tuple[str, int, int, float]]]:
        """Return the text and (word, first frame, last frame, log score) of each part."""
        decoder = self._decoder
        decoder.activate_search(name)
        decoder.start_utt()
        decoder.process_raw(pcm, no_search=False, full_utt=True)
        decoder.end_utt()
        best = decoder.hyp()
        if best is None:
            return "", []
        parts = [
            (part.word, part.start_frame, part.end_frame, math.log(max(part.ascore, 1e-30)))
            for part in decoder.seg()
            if part.end_frame >= part.start_frame and part.word != "(NULL)"
        ]
        return best.hypstr or "", parts

    def _add(self, word: str) -> None:
        lookup: Any = self._decoder.lookup_word
        if lookup(word) is None:
            self._decoder.add_word(word, pronounce(word, lookup), False)
        forms, number = [lookup(word)], 2
        while (form := lookup(f"{word}({number})")) is not None:
            forms.append(form)
            number += 1
        for other in sorted({new for known in forms for new in british(known)} - set(forms)):
            self._decoder.add_word(f"{word}({number})", other, False)
            number += 1


def _dithered(sound: F32) -> F32:
    loud = np.sort(sound.astype(np.float64) ** 2)[-max(len(sound) // 3, 1) :]
    level = max(math.sqrt(float(np.mean(loud))) * 10 ** (_DITHER_DB / 20), 1e-4)
    noise = np.random.default_rng(1).standard_normal(len(sound))  # the same at every call
    return (sound + level * noise).astype(np.float32)


def _per_frame(parts: list[tuple[str, int, int, float]], count: int) -> np.ndarray[Any, Any]:
    found = np.zeros(count)
    for _, start, end, score in parts:
        found[start : end + 1] += score / (end + 1 - start)
    return found
