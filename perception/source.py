"""What a source of sound is; and a file as one, heard as time passes, real or simulated."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import soundfile

from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32
from downbeat.perception.ring import RATE_HZ, Block, Resampler, Ring

__all__ = [
    "AUDIO_SUFFIXES",
    "Block",
    "FileSource",
    "Recording",
    "Ring",
    "Source",
    "SourceCounters",
    "audio_files",
    "load_recording",
]

log = logging.getLogger("downbeat.listener")

AUDIO_SUFFIXES = (".wav", ".flac", ".ogg", ".mp3")
MIN_SAMPLE_RATE_HZ = 8_000
READ_FRAMES = 1 << 14
WHOLE = 0.98
"""A file that decodes to less than this share of what its header says was cut off."""


@dataclass(frozen=True, slots=True)
class Recording:
    """A decoded file.

    Attributes:
        name: File name without its suffix.
        samples: (n,) mono, full scale 1.
        sample_rate_hz: [Hz].
    """

    name: str
    samples: F32
    sample_rate_hz: int

    @property
    def duration_s(self) -> float:
        """Length [s]."""
        return len(self.samples) / self.sample_rate_hz


def load_recording(path: Path) -> Recording:
    """Decode a file to mono; of one that was cut off, what can be decoded, with a warning.

    Raises:
        PerceptionError: It is missing, a folder, no audio, damaged, empty or holds non-finite
            samples.
    """
    valid = f"valid are {', '.join(AUDIO_SUFFIXES)}"
    if path.is_dir():
        raise PerceptionError(f"{path} is a folder, and one audio file is wanted; {valid}.")
    if not path.is_file():
        raise PerceptionError(f"Audio file {path} does not exist; {valid}.")
    try:
        with soundfile.SoundFile(path) as file:
            rate, expected = int(file.samplerate), int(file.frames)
            samples, is_cut = _decode(file)
    except (soundfile.LibsndfileError, RuntimeError, TypeError) as error:
        if path.suffix.lower() in AUDIO_SUFFIXES:
            why = "it is damaged, or not an audio file in spite of its name"
            raise PerceptionError(
                f"{path} cannot be read: {why}; {valid} that are whole."
            ) from error
        raise PerceptionError(f"{path} is not an audio file that can be read; {valid}.") from error
    if len(samples) == 0 or rate < MIN_SAMPLE_RATE_HZ or not np.isfinite(samples).all():
        raise PerceptionError(
            f"{path} holds no usable sound (empty or cut off, below {MIN_SAMPLE_RATE_HZ} Hz, "
            "or not finite)."
        )
    if is_cut or len(samples) < WHOLE * expected:
        seconds = (len(samples) / rate, expected / rate)
        log.warning("%s is cut off: %.1f of %.1f s can be decoded.", path, *seconds)
    return Recording(path.stem, samples, rate)


def _decode(file: soundfile.SoundFile) -> tuple[F32, bool]:
    """Return the mono samples, (n,), and whether decoding failed on the way.

    Raises:
        soundfile.LibsndfileError: Not even the beginning can be decoded.
    """
    parts: list[F32] = []
    while True:
        try:
            part = file.read(READ_FRAMES, dtype="float32", always_2d=True)
        except (soundfile.LibsndfileError, RuntimeError):
            if not parts:
                raise
            return np.concatenate(parts), True
        if len(part) == 0:
            return (np.concatenate(parts) if parts else np.zeros(0, np.float32)), False
        parts.append(part.mean(axis=1).astype(np.float32))


def audio_files(folder: Path) -> list[Path]:
    """Return the audio files of a folder, sorted.

    Raises:
        PerceptionError: It is no folder, or has none.
    """
    if not folder.is_dir():
        raise PerceptionError(f"{folder} is not a folder of audio files.")
    found = sorted(p for p in folder.iterdir() if p.suffix.lower() in AUDIO_SUFFIXES)
    if not found:
        raise PerceptionError(
            f"{folder} holds no audio file; valid are {', '.join(AUDIO_SUFFIXES)}."
        )
    return found


@dataclass(slots=True)
class SourceCounters:
    """What came, and what did not.

    Attributes:
        good: Blocks taken.
        bad: Blocks that could not be used: another length, nothing but rubbish.
        lost_samples: Samples that are known to be missing, at 16 kHz.
        surplus: Blocks that came twice or too late; dropped.
        xruns: Times a sound card's buffer ran over.
        bad_samples: Samples that were no numbers, or absurdly loud; silence stands for them.
        outages: Times nothing came any more.
        last_bad: Length of the last bad block [bytes]; -1 before one.
    """

    good: int = 0
    bad: int = 0
    lost_samples: int = 0
    surplus: int = 0
    xruns: int = 0
    bad_samples: int = 0
    outages: int = 0
    last_bad: int = -1

    def text(self) -> str:
        """Return what is wrong so far, e.g. "xruns 2, lost_samples 480"; "" while all is well."""
        wrong = ("lost_samples", "xruns", "outages", "bad", "bad_samples", "surplus")
        return ", ".join(f"{name} {getattr(self, name)}" for name in wrong if getattr(self, name))


class Source(Protocol):
    """Sound on the show's clock, 16 kHz mono, in blocks without a gap inside.

    Attributes:
        name: File or device.
        duration_s: Length [s], NaN if nobody knows.
        sample_rate_hz: Of its blocks: 16 kHz.
        first_sample_utime: Nothing before is heard [us].
        is_finished: Everything was read.
        failure: Why nothing comes at the moment, one sentence; "" while it does.
        counters: What came, and what did not.
    """

    name: str
    duration_s: float
    sample_rate_hz: int
    first_sample_utime: int
    counters: SourceCounters

    @property
    def is_finished(self) -> bool:
        """Whether everything was read."""
        ...

    @property
    def failure(self) -> str:
        """Why nothing comes at the moment; "" while it does."""
        ...

    @property
    def heard_utime(self) -> int:
        """Up to when is known what sounded, or that nothing will be known [us]."""
        ...

    def read(self, utime: int) -> list[Block]:
        """Return what came in since the last read; never raises, never waits."""
        ...

    def close(self) -> None:
        """Release the device."""
        ...


class FileSource:
    """Plays a recording on a clock: sample k sounds at first_sample_utime + k / rate.

    It is brought to 16 kHz once, when it is opened: no read depends on the ones before, so that
    every pattern of steps hears the same.
    """

    sample_rate_hz = RATE_HZ
    failure = ""

    def __init__(
        self, recording: Recording, first_sample_utime: int, latency_s: float = 0.0
    ) -> None:
        """Start a recording.

        Args:
            recording: What sounds.
            first_sample_utime: When sample 0 sounds [us].
            latency_s: How long after it sounds a sample can be read, as behind a microphone's
                buffers [s]. Stamps stay those of the sound.
        """
        self.name = recording.name
        self.duration_s = recording.duration_s
        self.first_sample_utime = first_sample_utime
        self.counters = SourceCounters()
        self._samples = self._at_16_khz(recording)
        self._latency_us = round(latency_s * 1e6)
        self._read = 0

    def _at_16_khz(self, recording: Recording) -> F32:
        resampler = Resampler(recording.sample_rate_hz)
        blocks = resampler.push(Block(recording.samples, 0)) + resampler.flush()
        self.counters.bad_samples = resampler.num_bad_samples
        return np.concatenate([b.samples for b in blocks]) if blocks else np.zeros(0, np.float32)

    def read(self, utime: int) -> list[Block]:
        """Return the samples that came in since the last read; never any from the future."""
        elapsed_us = utime - self._latency_us - self.first_sample_utime
        heard = elapsed_us * RATE_HZ // 1_000_000
        heard = int(min(max(heard, self._read), len(self._samples)))
        first, first_utime = self._read, self.heard_utime
        self._read = heard
        if heard == first:
            return []
        self.counters.good += 1
        return [Block(self._samples[first:heard], first_utime, True)]

    @property
    def is_finished(self) -> bool:
        """Whether everything was read."""
        return self._read >= len(self._samples)

    @property
    def heard_utime(self) -> int:
        """When the last sample that was read had sounded [us]."""
        return self.first_sample_utime + self._read * 1_000_000 // RATE_HZ

    def close(self) -> None:
        """Nothing to release."""
