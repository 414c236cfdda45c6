"""What the embedded recogniser makes of what is spoken, before anything is refused."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import soundfile
import soxr

from downbeat.perception.recogniser_pocketsphinx import (
    MAX_COMMAND_S,
    VOICES,
    PocketsphinxRecogniser,
)
from downbeat.perception.segments import Segmenter
from downbeat.perception.vad import Vad
from downbeat.tools.recogniser_items import RATE_HZ, Item, Understanding, in_noise, speak

PIECE_S = 1.5
AUDIO_SUFFIXES = {".wav", ".flac", ".ogg"}


@dataclass(frozen=True, slots=True)
class Heard:
    """An item and what became of it, before anything is refused.

    Attributes:
        item: What was said.
        text: The words that were recognised; "" for none.
        meaning: What the robot would do: a skill, "stop", "again", ...; "" for nothing.
        features: What speaks for the words.
        voice: Whose acoustic model it was, one of `VOICES`.
        compute_s: Processor time [s].
        sound_s: Length of the sound [s].
    """

    item: Item
    text: str
    meaning: str
    features: tuple[float, ...]
    voice: str
    compute_s: float
    sound_s: float

    @property
    def right(self) -> bool:
        """The robot would do what was asked, or answer the question that was asked."""
        if self.item.kind == "question":
            return self.text == self.item.text
        return self.item.kind == "command" and self.meaning == self.item.meaning


def hear(
    recogniser: PocketsphinxRecogniser,
    understanding: Understanding,
    spoken: Iterable[Item],
    snr_db: float,
    seed: int,
    voices: Sequence[str] = ("",),
) -> Iterator[Heard]:
    """Speak the items in noise, white and pink in turn, and let them be recognised.

    Args:
        recogniser: Without a threshold of its own.
        understanding: Of the words.
        spoken: The items.
        snr_db: Level of the speech over the noise.
        seed: Of the noise.
        voices: Whose acoustic model, one after the other; "": the one that fits.
    """
    rng = np.random.default_rng(seed)
    for at, item in enumerate(spoken):
        speech = speak(item.text, item.voice, item.words_per_minute)
        sound = in_noise(speech, snr_db, rng, pink=bool(at % 2))
        for voice in voices:
            begin = time.process_time()
            found = recogniser.score(sound, voice)
            spent = time.process_time() - begin
            meaning = understanding(found.text)
            yield Heard(
                item, found.text, meaning, found.features, found.voice, spent, len(sound) / RATE_HZ
            )


def hear_talk(
    recogniser: PocketsphinxRecogniser,
    understanding: Understanding,
    spoken: Iterable[Item],
    snr_db: float,
    seed: int,
) -> Iterator[Heard]:
    """Speak what is no command in noise, and let its utterances be recognised; see `hear`."""
    rng = np.random.default_rng(seed)
    vad = Vad()
    for at, item in enumerate(spoken):
        speech = speak(item.text, item.voice, item.words_per_minute)
        sound = in_noise(np.pad(speech, RATE_HZ // 4), snr_db, rng, pink=bool(at % 2))
        ears = Segmenter(vad)
        for piece in (*ears.push(sound, 0), *ears.flush()):
            for voice in VOICES:
                found = recogniser.score(piece.samples, voice)
                meaning = understanding(found.text)
                length = len(piece.samples) / RATE_HZ
                yield Heard(item, found.text, meaning, found.features, voice, 0.0, length)


def hear_people(
    recogniser: PocketsphinxRecogniser, understanding: Understanding, folder: Path
) -> Iterator[Heard]:
    """Let recordings of people who command nothing be recognised, utterances and blind pieces.

    Args:
        recogniser: Without a threshold of its own.
        understanding: Of the words.
        folder: Of recordings.
    """
    for file in sorted(path for path in folder.iterdir() if path.suffix in AUDIO_SUFFIXES):
        samples, rate = soundfile.read(file, dtype="float32", always_2d=True)
        sound = soxr.resample(samples.mean(axis=1), rate, RATE_HZ).astype(np.float32)
        ears = Segmenter(Vad())
        pieces = [one.samples for one in (*ears.push(sound, 0), *ears.flush())]
        size = round(PIECE_S * RATE_HZ)
        pieces += [sound[at : at + size] for at in range(0, len(sound) - size + 1, size)]
        item = Item("sentence", "", "", file.name, 0)
        for piece in pieces:
            if piece.any() and len(piece) <= MAX_COMMAND_S * RATE_HZ:
                found = recogniser.score(piece, VOICES[0])
                meaning = understanding(found.text)
                length = len(piece) / RATE_HZ
                yield Heard(item, found.text, meaning, found.features, VOICES[0], 0.0, length)
