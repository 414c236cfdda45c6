"""What the embedded recogniser is adapted, calibrated and tested with: spoken by espeak-ng."""

from __future__ import annotations

import io
import shutil
import subprocess
from dataclasses import dataclass

import numpy as np
import soundfile
import soxr

from downbeat.perception.features import F32
from downbeat.perception.grounding import NOT_BY_VOICE, STAND, IntentKind
from downbeat.perception.intent_model import CHAT
from downbeat.perception.recogniser_grammar import STOP_WORDS, plain
from downbeat.perception.recogniser_network import STOP
from downbeat.perception.reply_table import QUESTIONS
from downbeat.perception.speech_config import SpeechConfig
from downbeat.policies.manifest import load_skills
from downbeat.tools import recogniser_sentences as said
from downbeat.tools import spoken_lines
from downbeat.tools.errors import ToolError
from downbeat.tools.speech_parts import make_grounder
from downbeat.tools.train_intents import load_sentences

RATE_HZ = 16_000
PAD_S = 0.25
MAX_WORDS = 14


@dataclass(frozen=True, slots=True)
class Item:
    """Something spoken.

    Attributes:
        kind: "command", "question", "sentence" or "language" (another one than English).
        meaning: The skill that is asked for, or "stop"; "" for what is no command.
        text: The words.
        voice: Of espeak-ng.
        words_per_minute: Pace.
    """

    kind: str
    meaning: str
    text: str
    voice: str
    words_per_minute: int


class Understanding:
    """What the robot would do for some words, as the speech process grounds them."""

    def __init__(self) -> None:
        """Load the sentence model, where there is one."""
        self._grounder = make_grounder(SpeechConfig(), load_skills())
        self._known: dict[str, str] = {"": ""}

    def __call__(self, text: str) -> str:
        """Return a skill, "stop", another kind of intent, or "" where the body does nothing."""
        if text not in self._known:
            intent = self._grounder.ground(text)
            quiet = intent.kind in (IntentKind.CHAT, IntentKind.NONE)
            self._known[text] = "" if quiet else intent.skill or intent.kind.value
            if intent.kind is IntentKind.STOP:
                self._known[text] = STOP
        return self._known[text]


def commands() -> dict[str, str]:
    """Return the phrases of all bundled skills and the stop words: phrase -> skill or "stop"."""
    spoken = {
        plain(text): STOP if name == STAND else name
        for name, skill in load_skills().items()
        if name not in NOT_BY_VOICE
        for text in skill.phrases
    }
    return dict(sorted((spoken | dict.fromkeys(STOP_WORDS, STOP)).items()))


def items(half: str, share: int = 1) -> list[Item]:
    """Return what is spoken.

    Args:
        half: "adaptation", "calibration" (other voices) or "test" (other voices, other carriers,
            other sentences).
        share: Only every so many-th, for a quick look.
    """
    test = half == "test"
    voices = {
        "adaptation": said.ADAPTATION_VOICES,
        "calibration": said.CALIBRATION_VOICES,
        "test": said.TEST_VOICES,
    }[half]
    forms = said.TEST_FORMS if test else said.CALIBRATION_FORMS
    others = said.TEST_OTHER_LANGUAGES if test else said.CALIBRATION_OTHER_LANGUAGES
    paces = said.WORDS_PER_MINUTE
    found = []
    for at, (phrase, meaning) in enumerate(commands().items()):
        for turn in range(3):
            form = forms[0] if turn < 2 else forms[1 + at % (len(forms) - 1)]
            voice = voices[(at + 2 * turn) % len(voices)]
            found.append(Item("command", meaning, form.format(phrase), voice, paces[turn]))
    rest = [("question", plain(text)) for text in QUESTIONS]
    rest += [
        ("sentence", text)
        for text in (said.TEST_SENTENCES if test else said.CALIBRATION_SENTENCES)
        if text not in QUESTIONS
    ]
    for at, (kind, text) in enumerate(rest):
        for turn in range(1 if kind == "question" else 3):
            voice = voices[(at + 2 * turn) % len(voices)]
            found.append(Item(kind, "", text, voice, paces[turn]))
    for language, texts in others.items():
        found += [
            Item("language", "", text, language + variant, 160)
            for text in texts
            for variant in ("", "+f2")
        ]
    return found[::share]


def talk(count: int) -> list[Item]:
    """Return what people say near the robot, in the calibration's voices: no command in it.

    Every so many-th of the talk that the intent model learns from, without what the test says.
    """
    held = {plain(text) for text in (*said.TEST_SENTENCES, *spoken_lines.OTHERS)}
    texts = [
        one.text
        for one in load_sentences()
        if one.wanted == CHAT and one.text.isascii() and 4 <= len(one.text.split()) <= MAX_WORDS
    ]
    texts = [text for text in texts if plain(text) not in held]
    step = max(1, len(texts) // count)
    voices, paces = said.CALIBRATION_VOICES, said.WORDS_PER_MINUTE
    return [
        Item("sentence", "", text, voices[at % len(voices)], paces[at % len(paces)])
        for at, text in enumerate(texts[::step][:count])
    ]


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
