"""Recognition by any service that speaks OpenAI's `/audio/transcriptions`."""

from __future__ import annotations

import io
import math
import time
from typing import Any

import numpy as np
import soundfile

from downbeat.perception.features import F32
from downbeat.perception.recognisers import SAMPLE_RATE_HZ, Recognition, nothing, usable
from downbeat.perception.services import Service, ServiceError

DEFAULT_MODEL = "gpt-4o-mini-transcribe"
MAX_TEXT = 2_000
"""Letters of an answer that are kept: thirty seconds of speech have fewer."""


class OpenAIRecogniser:
    """Sends each utterance; every failure is an empty recognition that says why."""

    name = "openai"

    def __init__(
        self, url: str, model: str, key: str, key_variable: str, timeout_s: float = 10.0
    ) -> None:
        """Remember where to ask.

        Args:
            url: Root with its version.
            model: As the service names it.
            key: Bearer token, empty: none.
            key_variable: Where it came from.
            timeout_s: Longest wait [s].

        Raises:
            PerceptionError: The URL is none.
        """
        self._service = Service(url, key, key_variable, timeout_s)
        self._model = model

    def recognise(self, samples: F32, language: str = "en") -> Recognition:
        """Recognise one utterance; see `Recogniser`."""
        begin = time.perf_counter_ns()

        def spent_us() -> int:
            return (time.perf_counter_ns() - begin) // 1000

        sound = usable(samples)
        if not len(sound):
            return nothing(self.name, spent_us())
        fields = {"model": self._model, "response_format": "json", "stream": "true"}
        if language:
            fields["language"] = language.split("-")[0]
        try:
            answer = self._service.post_file(
                "/audio/transcriptions", fields, "utterance.wav", wav_bytes(sound)
            )
        except ServiceError as error:
            return nothing(self.name, spent_us(), str(error))
        text = answer.get("text")
        if not isinstance(text, str):
            return nothing(self.name, spent_us(), f"{self._service.url} sent no text.")
        text = " ".join(text.split())[:MAX_TEXT]
        return Recognition(text, confidence(answer), self.name, spent_us(), tuple(text.split()), "")


def wav_bytes(sound: F32) -> bytes:
    """Return (n,) samples at 16 kHz as a WAV file."""
    file = io.BytesIO()
    pcm = (np.clip(sound, -1.0, 1.0) * 32767).astype(np.int16)
    soundfile.write(file, pcm, SAMPLE_RATE_HZ, format="WAV", subtype="PCM_16")
    return file.getvalue()


def confidence(answer: dict[str, Any]) -> float:
    """Return the mean probability of the tokens where the service gives it, else NaN."""
    tokens = answer.get("logprobs")
    if not isinstance(tokens, list) or not tokens:
        return math.nan
    try:
        return math.exp(sum(float(token["logprob"]) for token in tokens) / len(tokens))
    except (TypeError, KeyError, ValueError, OverflowError):
        return math.nan
