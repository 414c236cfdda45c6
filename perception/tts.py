"""Text to speech: espeak-ng on this machine, an OpenAI-compatible service, or only the text."""

from __future__ import annotations

import io
import shutil
import subprocess
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt
import soundfile
import soxr

from downbeat.perception.errors import PerceptionError
from downbeat.perception.services import Service, ServiceError
from downbeat.perception.speaker import SAMPLE_RATE_HZ

I16 = npt.NDArray[np.int16]
DEFAULT_MODEL = "gpt-4o-mini-tts"
DEFAULT_VOICE = "alloy"
LETTERS_PER_S = 16.0
"""Of espeak-ng at 165 words a minute, measured over the embedded answers."""
MAX_S = 60.0
_TIMEOUT_S = 10.0
_PEAK = 0.7


@dataclass(frozen=True, slots=True)
class Spoken:
    """Speech that can be played.

    Attributes:
        text: The words.
        samples: (n,) mono int16 at 16 kHz; empty where nothing can sound and the text is shown.
        duration_s: How long it takes, or would take [s].
        backend: Who spoke.
        failure: Why the wanted backend could not, empty if it did.
    """

    text: str
    samples: I16
    duration_s: float
    backend: str
    failure: str = ""


class Voice(Protocol):
    """Text in, sound out. It never raises, and never waits without a bound."""

    name: str

    def say(self, text: str) -> Spoken:
        """Speak a text."""
        ...


class SilentVoice:
    """Nothing sounds: the text is shown, and its duration is estimated for the gesture."""

    name = "text"

    def say(self, text: str) -> Spoken:
        """Estimate how long a voice would need."""
        return silent(text, self.name)


def silent(text: str, backend: str, failure: str = "") -> Spoken:
    """Return an utterance that is only shown."""
    duration_s = min(MAX_S, 0.2 + len(text) / LETTERS_PER_S)
    return Spoken(text, np.zeros(0, np.int16), duration_s, backend, failure)


class EspeakVoice:
    """espeak-ng, a Debian package; 20 ms for a sentence."""

    name = "espeak-ng"

    def __init__(self, voice: str = "en-us", words_per_minute: int = 165) -> None:
        """Look for the program.

        Raises:
            PerceptionError: It is not installed.
        """
        found = shutil.which("espeak-ng")
        if found is None:
            raise PerceptionError(
                "espeak-ng is not installed; `apt-get install espeak-ng` brings it. Without it "
                "answers are shown as text (voice = text)."
            )
        self._command = [found, "-v", voice, "-s", str(words_per_minute), "--stdin", "--stdout"]

    def say(self, text: str) -> Spoken:
        """Speak; what cannot be spoken is shown."""
        try:
            raw = subprocess.run(
                self._command, input=text.encode(), capture_output=True, timeout=_TIMEOUT_S
            ).stdout
            return spoken(text, raw, self.name)
        except (OSError, subprocess.SubprocessError, PerceptionError) as error:
            return silent(text, "text", f"espeak-ng could not speak: {error}")


class ServiceVoice:
    """Any service that speaks OpenAI's `/audio/speech`; espeak-ng or the text when it fails."""

    name = "openai"

    def __init__(self, service: Service, model: str = "", voice: str = "") -> None:
        """Remember where to ask."""
        self._service = service
        self._model = model or DEFAULT_MODEL
        self._voice = voice or DEFAULT_VOICE
        self._instead = local_voice()

    def say(self, text: str) -> Spoken:
        """Ask the service; speak here if it fails."""
        body = {
            "model": self._model,
            "voice": self._voice,
            "input": text,
            "response_format": "wav",
        }
        try:
            raw = self._service.post_for_bytes("/audio/speech", body)
            return spoken(text, raw, self.name)
        except (ServiceError, PerceptionError) as error:
            instead = self._instead.say(text)
            return Spoken(text, instead.samples, instead.duration_s, instead.backend, str(error))


def local_voice() -> Voice:
    """Return what can speak on this machine."""
    try:
        return EspeakVoice()
    except PerceptionError:
        return SilentVoice()


def spoken(text: str, raw: bytes, backend: str) -> Spoken:
    """Decode a sound file to 16 kHz mono int16, without silence at its ends.

    The duration drives a gesture, so what is silent must not count.

    Raises:
        PerceptionError: It is no sound, or nothing sounds in it.
    """
    try:
        sound, rate = soundfile.read(io.BytesIO(_with_sizes(raw)), dtype="float32", always_2d=True)
    except (soundfile.LibsndfileError, RuntimeError, TypeError) as error:
        raise PerceptionError(f"{backend} sent no sound that can be read.") from error
    mono = sound.mean(axis=1)
    if not len(mono) or not np.isfinite(mono).all() or not mono.any():
        raise PerceptionError(f"{backend} sent silence.")
    mono = soxr.resample(mono, rate, SAMPLE_RATE_HZ)[: round(MAX_S * SAMPLE_RATE_HZ)]
    peak = float(np.abs(mono).max())
    loud = np.flatnonzero(np.abs(mono) > 0.01 * peak)
    mono = mono[loud[0] : loud[-1] + 1] * (_PEAK / peak)
    samples = (mono * 32767).astype(np.int16)
    return Spoken(text, samples, len(samples) / SAMPLE_RATE_HZ, backend)


def _with_sizes(raw: bytes) -> bytes:
    """Return a WAV file whose sizes are true: what is written to a pipe says 2 GB."""
    at = raw.find(b"data", 12)
    if raw[:4] != b"RIFF" or at < 0 or len(raw) < at + 8:
        return raw
    size = len(raw) - at - 8
    return (
        raw[:4]
        + (len(raw) - 8).to_bytes(4, "little")
        + raw[8 : at + 4]
        + size.to_bytes(4, "little")
        + raw[at + 8 :]
    )
