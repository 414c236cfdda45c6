"""Recognition by Whisper weights on this machine: the extra `models` (torch, transformers)."""

from __future__ import annotations

import math
import time
from typing import Any

from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32
from downbeat.perception.recognisers import SAMPLE_RATE_HZ, Recognition, nothing, usable

DEFAULT_MODEL = "openai/whisper-base.en"


class WhisperRecogniser:
    """Runs a Whisper model by transformers."""

    name = "whisper"

    def __init__(self, model: str = "") -> None:
        """Load the weights.

        Args:
            model: Folder with the weights, or their id on the hub; empty: `DEFAULT_MODEL`.

        Raises:
            PerceptionError: transformers is missing, or there are no such weights.
        """
        try:
            from transformers import pipeline
        except ImportError as error:
            raise PerceptionError(
                "The recogniser whisper needs transformers and torch; `pip install "
                "'downbeat[models]'` brings them, and backend = pocketsphinx needs neither."
            ) from error
        name = model or DEFAULT_MODEL
        try:
            self._run: Any = pipeline("automatic-speech-recognition", model=name)
        except Exception as error:  # whatever the hub, the disk or the weights do
            raise PerceptionError(
                f"Whisper weights '{name}' cannot be loaded ({type(error).__name__}: "
                f"{str(error)[:120]}); give a folder, or an id of the hub where there is network."
            ) from error

    def recognise(self, samples: F32, language: str = "en") -> Recognition:
        """Recognise one utterance; see `Recogniser`."""
        begin = time.perf_counter_ns()
        sound = usable(samples)
        if not len(sound):
            return nothing(self.name, (time.perf_counter_ns() - begin) // 1000)
        try:
            answer = self._run({"raw": sound, "sampling_rate": SAMPLE_RATE_HZ})
            text = " ".join(str(answer["text"]).split())
        except (RuntimeError, ValueError, KeyError, TypeError) as error:
            spent = (time.perf_counter_ns() - begin) // 1000
            return nothing(self.name, spent, f"whisper failed: {error}")
        spent = (time.perf_counter_ns() - begin) // 1000
        return Recognition(text, math.nan, self.name, spent, tuple(text.split()))
