"""The embedded recogniser: hears the skills' phrases, and says nothing rather than wrong.

The acoustic model is the one that the package pocketsphinx carries; the search is made for this
task. One pass scores every phrase with what may be said around it, and a loop of any phones hears
the same sound. What is a command fits its phrase nearly as well as it fits the loop, in every part
of it, and fits no phrase of another meaning; any other sentence does not. How sure that is says a
logistic regression of a few such figures, which `python -m downbeat.tools.calibrate_recogniser`
froze.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from downbeat.perception.acoustic_model import load_acoustic_model, packaged_folder
from downbeat.perception.cepstra import cepstra, dithered, mel_spectrum, streams, without_noise
from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32
from downbeat.perception.phone_network import Chain, Part, Search, best_states, search
from downbeat.perception.recogniser_grammar import NEGATION
from downbeat.perception.recogniser_network import (
    AFTER,
    PHRASE,
    Dictionary,
    command_networks,
)
from downbeat.perception.recognisers import SAMPLE_RATE_HZ, Recognition, nothing, usable

CALIBRATION_FILE = Path(__file__).parent / "data" / "recogniser_pocketsphinx.json"
MAX_COMMAND_S = 8.0
"""Longer speech is no command, and is not worth the time that decoding it takes."""

FEATURES = ("ratio", "worst_part", "margin", "log_frames", "phones", "around")
"""Of the best candidate: see `PocketsphinxRecogniser.score`."""
VOICES = ("people", "synthetic")
"""The acoustic model as it was made, from people, and adapted to synthetic voices."""

_SCALE = np.float32(0.25)
"""Of the acoustic scores: frames are no independent witnesses."""
_PHONE_COST = -3.0
_MOST_MARGIN = 30.0
_LIKELIER = 0.25
"""Per frame: people gain -0.2 to 0.1 by the adaptation, voices like those it heard 1 to 3."""
_CLOSEST = 12
"""Candidates whose meaning is looked at."""
_WORST_PHONES = 2


@dataclass(frozen=True, slots=True)
class Decision:
    """What decides that an answer was really said.

    Attributes:
        weights: One per feature, in their order.
        offset: Added; the logistic function of the sum is the confidence.
        threshold: Confidence below which nothing was recognised.
    """

    weights: tuple[float, ...]
    offset: float
    threshold: float

    def confidence(self, features: tuple[float, ...]) -> float:
        """Return 0..1."""
        total = self.offset + sum(w * x for w, x in zip(self.weights, features, strict=True))
        return 1.0 / (1.0 + math.exp(-max(min(total, 50.0), -50.0)))


@dataclass(frozen=True, slots=True)
class Calibration:
    """The frozen decisions: the two acoustic models have scores of different scales.

    Attributes:
        by_voice: One per `VOICES`.
        info: How it was made, for the reader.
    """

    by_voice: Mapping[str, Decision]
    info: str = ""


def load_calibration(path: Path | None = None) -> Calibration:
    """Load the frozen weights.

    Raises:
        PerceptionError: The file is missing or is none.
    """
    file = path or CALIBRATION_FILE
    try:
        table = json.loads(file.read_text(encoding="utf-8"))
        found = {
            voice: Decision(
                tuple(float(table[voice]["weights"][name]) for name in FEATURES),
                float(table[voice]["offset"]),
                float(table[voice]["threshold"]),
            )
            for voice in VOICES
        }
        return Calibration(found, str(table["info"]))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise PerceptionError(
            f"{file} is no calibration of the embedded recogniser ({error!r}); "
            "`python -m downbeat.tools.calibrate_recogniser --write` makes one."
        ) from error


@dataclass(frozen=True, slots=True)
class Hearing:
    """The best candidate, before anything is refused.

    Attributes:
        text: Its words; "" where no phrase fits into the sound.
        features: What speaks for it, the values of `FEATURES`.
        voice: Under which acoustic model, one of `VOICES`.
    """

    text: str
    features: tuple[float, ...]
    voice: str


@dataclass(frozen=True, slots=True)
class Candidate:
    """A way to understand the whole sound.

    Attributes:
        chain: Of the phrase.
        score: Logarithm, scaled.
        parts: What is said, in order, pauses left out; the phrase is one of them.
        phrase: Which.
        meaning: What it asks for.
    """

    chain: Chain
    score: float
    parts: tuple[Part, ...]
    phrase: Part
    meaning: str


class PocketsphinxRecogniser:
    """Hears the given phrases and the stop words, in English; everything else is nothing."""

    name = "pocketsphinx"

    def __init__(
        self,
        phrases: Iterable[str] | Mapping[str, str],
        calibration: Calibration | None = None,
    ) -> None:
        """Load the acoustic model that the package carries and build the networks; about 1 s.

        Args:
            phrases: What the skills are called by, each with what it asks for: phrases of one
                meaning never compete. "" is a question to be answered. Without meanings every
                phrase has its own.
            calibration: When an answer counts; None: the frozen one.

        Raises:
            PerceptionError: The package is missing, or its model is not the one that fits.
        """
        self.calibration = calibration or load_calibration()
        if not isinstance(phrases, Mapping):
            phrases = {text: text for text in phrases}
        folder = packaged_folder()
        model = load_acoustic_model(folder / "en-us")
        dictionary = Dictionary(folder / "cmudict-en-us.dict", model)
        self._networks = command_networks(phrases, model, dictionary, _PHONE_COST)
        self._model = replace(model, triphones={})  # of no more use, and large
        self._networks.columns.model = self._model
        self._models = dict(zip(VOICES, (self._model, self._model.adapted()), strict=True))

    def recognise(self, samples: F32, language: str = "en") -> Recognition:
        """Recognise one utterance; see `Recogniser`."""
        begin = time.perf_counter_ns()
        sound = usable(samples)
        english = language.lower().split("-")[0] in ("", "en")
        if not english or not len(sound) or len(sound) > MAX_COMMAND_S * SAMPLE_RATE_HZ:
            return nothing(self.name, (time.perf_counter_ns() - begin) // 1000)
        heard = self.score(sound)
        decision = self.calibration.by_voice[heard.voice]
        confidence = decision.confidence(heard.features) if heard.text else math.nan
        compute_us = (time.perf_counter_ns() - begin) // 1000
        if not heard.text or confidence < decision.threshold:
            return Recognition("", confidence, self.name, compute_us)
        return Recognition(heard.text, confidence, self.name, compute_us, tuple(heard.text.split()))

    def score(self, sound: F32, voice: str = "") -> Hearing:
        """Return the best candidate and what speaks for it.

        The features are the log-likelihood ratio to the loop of phones per frame of speech, the
        same over the worst pair of phones, the distance to the best candidate of another meaning,
        the logarithm of the frames of speech, the phones of the phrase, the parts around it.

        Args:
            sound: (n,) mono, 16 kHz, full scale 1, not digital silence.
            voice: Whose acoustic model; "": the one that fits.
        """
        scores, loop, voice = self._hear(sound, voice)
        found = self._candidates(scores)
        if not found:
            return Hearing("", (0.0,) * len(FEATURES), voice)
        best = found[0]
        other = next((one.score for one in found if one.meaning != best.meaning), -math.inf)
        free = loop.hubs[:, 0]
        voiced = [part for part in loop.path(len(scores), 0) if part.label] or [best.phrase]
        first = min(best.parts[0].first, voiced[0].first)
        last = max(best.parts[-1].end, voiced[-1].end)
        features = (
            (best.score - float(free[-1])) / (last - first),
            self._worst_part(best, scores, free),
            min(best.score - other, _MOST_MARGIN),
            math.log(last - first),
            float(len(best.chain.columns) // 3),
            float(len(best.parts) - 1),
        )
        return Hearing(" ".join(part.label for part in best.parts), features, voice)

    def _hear(self, sound: F32, voice: str) -> tuple[F32, Search, str]:
        """Return (t, columns) scaled log-likelihoods, the loop's search of them, and whose.

        The model of synthetic voices only counts where the sound, whatever it says, is likelier
        under it by far: people are as likely under both.
        """
        features = streams(cepstra(without_noise(mel_spectrum(dithered(sound)))))
        heard = {}
        for name in (voice,) if voice else VOICES:
            likelihoods = self._models[name].log_likelihoods(features)
            scores = self._networks.columns.select(likelihoods) * _SCALE
            heard[name] = scores, search(self._networks.loop, scores)
        if not voice:
            people, synthetic = (float(heard[name][1].hubs[-1, 0]) for name in VOICES)
            voice = VOICES[int(synthetic - people > _LIKELIER * len(features))]
        return *heard[voice], voice

    def _candidates(self, scores: F32) -> list[Candidate]:
        """Return the closest, the best first."""
        front = search(self._networks.front, scores)
        back = search(self._networks.back, scores[::-1])
        rest = back.hubs[::-1, AFTER]  # rest[t]: frames from t to the end, after the phrase
        total = front.ends + rest[1:, None]
        ends = total.argmax(axis=0)
        value = total[ends, np.arange(total.shape[1])]
        chains = front.network.chains
        order = [int(k) for k in np.argsort(-value) if chains[k].leads_to == PHRASE]
        texts: dict[str, int] = {}
        for number in order:
            if len(texts) < _CLOSEST and value[number] > -1e8:
                texts.setdefault(chains[number].label, number)
        return [
            self._candidate(front, back, number, int(ends[number]), float(value[number]))
            for number in texts.values()
        ]

    def _candidate(
        self, front: Search, back: Search, number: int, end: int, score: float
    ) -> Candidate:
        chain = front.network.chains[number]
        begin = int(front.begins[end, number])
        count = len(front.ends)
        before = front.path(begin, chain.entry)
        after = [
            Part(part.label, count - part.end, count - part.first)
            for part in back.path(count - 1 - end, AFTER)[::-1]
        ]
        phrase = Part(chain.label, begin, end + 1)
        parts = tuple(part for part in (*before, phrase, *after) if part.label)
        negated = any(part.label in NEGATION for part in parts)
        meaning = "not" if negated else self._networks.meanings[chain.label]
        return Candidate(chain, score, parts, phrase, meaning)

    def _worst_part(self, best: Candidate, scores: F32, free: F32) -> float:
        """Return the least log-likelihood ratio per frame over two phones of the phrase."""
        first, end = best.phrase.first, best.phrase.end
        columns = list(best.chain.columns)
        said = scores[first:end, columns]
        phones = np.array(best.chain.phones)
        kind = np.arange(len(phones)) % 3
        states = best_states(said, self._model.stay[phones, kind], self._model.leave[phones, kind])
        ratio = said[np.arange(len(said)), states] - np.diff(free[first : end + 1])
        number = states // 3
        total = np.bincount(number, ratio)
        frames = np.bincount(number)
        size = min(_WORST_PHONES, len(total))
        window = np.ones(size)
        mean = np.convolve(total, window, "valid") / np.convolve(frames, window, "valid")
        return float(mean.min())
