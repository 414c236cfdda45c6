"""What `downbeat eval speech --spoken` says: commands, questions and other sentences, in voices.

The sentences were fixed before the first run. The voices are none that the recogniser was adapted,
calibrated or tested with, nor are the sentences that ask for nothing; the commands hold phrases of
the manifests, which are what it listens for.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from downbeat.catalog.setlist import SetList
from downbeat.perception.features import F32
from downbeat.tools.mashup import SAMPLE_RATE_HZ, Mashup
from downbeat.tools.onstage import speak

VOICES = ("en-us+m4", "en-gb+m3", "en-us+f1")
CLEAN = "clean"
NOISE = (CLEAN, "20", "10")
"""Signal over noise [dB], over the whole sentence."""

COMMANDS = (
    ("do the arm wave", "armwave"),
    ("box step please", "boxstep"),
    ("show me the disco", "disco"),
    ("do the disco step", "discostep"),
    ("circle your hips", "hipcircle"),
    ("do a k pop dance", "kpop"),
    ("do the monkey", "monkey"),
    ("raise the roof", "pump"),
    ("dance like a robot", "robot"),
    ("dance a salsa", "salsa"),
    ("do the salsa step", "salsastep"),
    ("sway gently please", "sway"),
    ("show me the thriller", "thriller"),
    ("do the turn step", "turnstep"),
    ("dance like an egyptian", "tutting"),
    ("can you do the twist", "twist"),
    ("walk forward", "walk"),
    ("please dance a waltz", "waltz"),
    ("robot say hello", "wave"),
    ("walk like a zombie", "zombie"),
)
"""One for every skill that speech may ask for."""
STOP = ("stop dancing", "stop")
"""And how all of it ends."""
QUESTIONS = (
    "who are you",
    "what can you do",
    "what song is this",
    "how are you",
    "can you hear me",
    "thank you",
)
"""They are answered, with the gesture; to be taken for a command is a false trigger."""
OTHERS = (
    "the soup is still too hot to eat",
    "my cousin moved to another city last summer",
    "we need two more chairs in the front row",
    "the wave was much higher than the harbour wall",
    "a monkey escaped from the zoo this morning",
    "she read the whole thriller in a single night",
    "this shop only sells second hand records",
    "where did you leave the keys of the van",
    "the pump of the fountain has been broken for weeks",
    "i do not think that it will rain tomorrow",
    "they stopped at a small village for lunch",
    "could you turn the lights down a little",
    "he walked along the river until it got dark",
    "everybody should be back here at half past nine",
)
RMS = 0.05
LEAD_S, TAIL_S = 2.0, 8.0
AFTER_COMMAND_S, AFTER_QUESTION_S, AFTER_OTHER_S = 5.5, 11.5, 3.0
"""Until the next sentence: the robot has to begin, or to answer, in between."""
HOLD_S = 2.5
"""How long a dance lasts that was asked for; then the robot stands."""


@dataclass(frozen=True)
class Sentence:
    """A sentence and what it is to do, as in `metrics_speech.SpokenTruth`."""

    text: str
    expected: str

    @property
    def pause_s(self) -> float:
        """How long it is silent afterwards [s]."""
        if self.expected == "answer":
            return AFTER_QUESTION_S
        return AFTER_COMMAND_S if self.expected else AFTER_OTHER_S


def sentences(seed: int) -> list[Sentence]:
    """Return all of them, mixed by the seed; the stop comes last."""
    mixed = [Sentence(text, skill) for text, skill in COMMANDS]
    mixed += [Sentence(text, "answer") for text in QUESTIONS]
    mixed += [Sentence(text, "") for text in OTHERS]
    order = np.random.default_rng(seed).permutation(len(mixed))
    return [*(mixed[at] for at in order), Sentence(*STOP)]


def spoken_show(voice: str, noise: str, seed: int) -> Mashup:
    """Return sound and truth of one voice at one noise level.

    Args:
        voice: Of espeak-ng.
        noise: One of `NOISE`.
        seed: Of order and noise.

    Raises:
        ToolError: espeak-ng, or the voice, is missing.
    """
    parts: list[F32] = [np.zeros(round(LEAD_S * SAMPLE_RATE_HZ), np.float32)]
    rows: list[dict[str, Any]] = []
    length = len(parts[0])
    for one in sentences(seed):
        sound = speak(one.text, voice, SAMPLE_RATE_HZ)
        sound = sound * np.float32(RMS / np.sqrt(np.mean(sound.astype(np.float64) ** 2)))
        pause = np.zeros(round(one.pause_s * SAMPLE_RATE_HZ), np.float32)
        start_s, end_s = length / SAMPLE_RATE_HZ, (length + len(sound)) / SAMPLE_RATE_HZ
        rows.append(
            {"start_s": start_s, "end_s": end_s, "text": one.text, "expected": one.expected}
        )
        parts += [sound, pause]
        length += len(sound) + len(pause)
    parts.append(np.zeros(round(TAIL_S * SAMPLE_RATE_HZ), np.float32))
    samples = np.concatenate(parts)
    if noise != CLEAN:
        level = RMS * 10 ** (-float(noise) / 20.0)
        samples = samples + np.float32(level) * hall(len(samples), seed)
    truth: dict[str, Any] = {
        "version": 1,
        "sample_rate_hz": SAMPLE_RATE_HZ,
        "duration_s": len(samples) / SAMPLE_RATE_HZ,
        "announced": False,
        "segments": [],
        "sections": [],
        "beat_grids": {},
        "speech": rows,
        "seed": seed,
        "voice": voice,
        "noise": noise,
    }
    return Mashup(samples.astype(np.float32), SetList(()), truth)


def hall(count: int, seed: int) -> F32:
    """Return (count,) noise, half of its power white and half pink, RMS 1 below 8 kHz.

    White noise hides consonants, pink noise vowels; above 8 kHz nobody listens, so that power there
    would only flatter the ratio.
    """
    rng = np.random.default_rng([seed, 0x5EA])
    hertz = np.fft.rfftfreq(count, 1.0 / SAMPLE_RATE_HZ)
    inside = (hertz >= 40.0) & (hertz <= 8_000.0)
    total = np.zeros(count)
    for slope in (0.0, 0.5):
        shape = inside / np.maximum(hertz, 40.0) ** slope
        noise = np.fft.irfft(np.fft.rfft(rng.standard_normal(count)) * shape, count)
        total += noise / np.sqrt(2.0 * np.mean(noise**2))
    return (total / np.sqrt(np.mean(total**2))).astype(np.float32)
