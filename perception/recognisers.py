"""Speech to text behind one interface; the embedded recogniser is the default."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

import numpy as np

from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32
from downbeat.runtime.errors import one_of

SAMPLE_RATE_HZ = 16_000
MAX_S = 30.0
"""Longer sound is cut: no command lasts that long, and no wait may grow with it."""

MIN_S = 0.1

Phrases = Iterable[str] | Mapping[str, str]
"""Phrases, or phrases and what they ask for."""


@dataclass(frozen=True, slots=True)
class Recognition:
    """What was said.

    Attributes:
        text: "" where nothing was recognised.
        confidence: 0..1; NaN where the backend gives none.
        backend: Name of the recogniser.
        compute_us: How long it took [us].
        words: One per word of the text.
        failure: Why a backend could not answer; "" where it did (also with nothing recognised).
    """

    text: str
    confidence: float
    backend: str
    compute_us: int
    words: tuple[str, ...] = ()
    failure: str = ""


class Recogniser(Protocol):
    """Sound in, text out. It never raises for what it hears, and never waits without a bound."""

    name: str

    def recognise(self, samples: F32, language: str = "en") -> Recognition:
        """Recognise one utterance.

        Args:
            samples: (n,) mono, 16 kHz, full scale 1.
            language: BCP 47; "" lets the backend find out, where it can.
        """
        ...


@dataclass(frozen=True, slots=True)
class RecogniserConfig:
    """Which backend, and what it needs.

    Attributes:
        backend: One of `BACKENDS`.
        url: Root of an OpenAI-compatible service, with its version ("…/v1").
        model: Name of the service's model, or path or hub id of local weights; "": the default.
        key_variable: Environment variable that holds the key; the key itself is never configured.
        timeout_s: Longest wait for one answer [s].
    """

    backend: str = "pocketsphinx"
    url: str = "https://api.openai.com/v1"
    model: str = ""
    key_variable: str = "OPENAI_API_KEY"
    timeout_s: float = 10.0


def usable(samples: F32) -> F32:
    """Return the part of the sound that a recogniser may work on, finite and not too long.

    Returns:
        (n,) full scale 1; empty where there is too little, or nothing but digital silence.
    """
    sound = np.asarray(samples, np.float32).reshape(-1)[: round(MAX_S * SAMPLE_RATE_HZ)]
    enough = len(sound) >= MIN_S * SAMPLE_RATE_HZ and np.isfinite(sound).all()
    return np.clip(sound, -1.0, 1.0) if enough and sound.any() else np.zeros(0, np.float32)


def nothing(backend: str, compute_us: int = 0, failure: str = "") -> Recognition:
    """Return that nothing was recognised."""
    return Recognition("", math.nan, backend, compute_us, (), failure)


def make_recogniser(
    config: RecogniserConfig,
    phrases: Phrases,
    environment: Mapping[str, str] = MappingProxyType({}),
) -> Recogniser:
    """Return the configured backend; only that one's libraries are imported.

    Args:
        config: Which, and what it needs.
        phrases: What the skills are called by; the embedded recogniser hears nothing else. With
            what each asks for, phrases of one meaning do not compete; "" is a question.
        environment: Where the key is looked up.

    Raises:
        PerceptionError: There is no such backend, or it lacks what it needs.
    """
    if config.backend not in BACKENDS:
        raise PerceptionError(
            f"Recogniser {config.backend!r} does not exist; valid are {one_of(BACKENDS)}."
        )
    return BACKENDS[config.backend](config, phrases, environment)


def _pocketsphinx(config: RecogniserConfig, phrases: Phrases, env: Mapping[str, str]) -> Recogniser:
    from downbeat.perception.recogniser_pocketsphinx import PocketsphinxRecogniser

    return PocketsphinxRecogniser(phrases)


def _openai(config: RecogniserConfig, phrases: Phrases, env: Mapping[str, str]) -> Recogniser:
    from downbeat.perception.recogniser_openai import DEFAULT_MODEL, OpenAIRecogniser

    key = env.get(config.key_variable, "")
    model = config.model or DEFAULT_MODEL
    return OpenAIRecogniser(config.url, model, key, config.key_variable, config.timeout_s)


def _whisper(config: RecogniserConfig, phrases: Phrases, env: Mapping[str, str]) -> Recogniser:
    from downbeat.perception.recogniser_whisper import WhisperRecogniser

    return WhisperRecogniser(config.model)


BACKENDS: dict[str, Callable[[RecogniserConfig, Phrases, Mapping[str, str]], Recogniser]] = {
    "pocketsphinx": _pocketsphinx,
    "openai": _openai,
    "whisper": _whisper,
}
