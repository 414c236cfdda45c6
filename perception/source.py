"""Sound from a file, heard as time passes: real time and simulated time with the same code."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import soundfile

from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32

AUDIO_SUFFIXES = (".wav", ".flac", ".ogg", ".mp3")
MIN_SAMPLE_RATE_HZ = 8_000


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
    """Decode a file to mono.

    Raises:
        PerceptionError: It is missing, is no audio, is empty or holds non-finite samples.
    """
    valid = f"valid are {', '.join(AUDIO_SUFFIXES)}"
    if not path.is_file():
        raise PerceptionError(f"Audio file {path} does not exist; {valid}.")
    try:
        samples, rate = soundfile.read(path, dtype="float32", always_2d=True)
    except (soundfile.LibsndfileError, RuntimeError, TypeError) as error:
        raise PerceptionError(f"{path} is not an audio file that can be read; {valid}.") from error
    if len(samples) == 0 or rate < MIN_SAMPLE_RATE_HZ or not np.isfinite(samples).all():
        raise PerceptionError(
            f"{path} holds no usable sound (empty, below {MIN_SAMPLE_RATE_HZ} Hz, or not finite)."
        )
    return Recording(path.stem, samples.mean(axis=1).astype(np.float32), int(rate))


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


class FileSource:
    """Plays a recording on a clock: sample k sounds at first_sample_utime + k / rate."""

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
        self.recording = recording
        self.first_sample_utime = first_sample_utime
        self.sample_rate_hz = recording.sample_rate_hz
        self._latency_us = round(latency_s * 1e6)
        self._read = 0

    def read(self, utime: int) -> F32:
        """Return the samples that came in since the last read; never any from the future."""
        elapsed_us = utime - self._latency_us - self.first_sample_utime
        heard = elapsed_us * self.sample_rate_hz // 1_000_000
        heard = int(min(max(heard, self._read), len(self.recording.samples)))
        chunk = self.recording.samples[self._read : heard]
        self._read = heard
        return chunk

    @property
    def is_finished(self) -> bool:
        """Whether everything was read."""
        return self._read >= len(self.recording.samples)

    @property
    def heard_utime(self) -> int:
        """When the last sample that was read sounded [us]."""
        return self.first_sample_utime + self._read * 1_000_000 // self.sample_rate_hz


class Ring:
    """The last seconds of sound."""

    def __init__(self, seconds: float, sample_rate_hz: int) -> None:
        self.sample_rate_hz = sample_rate_hz
        self._size = round(seconds * sample_rate_hz)
        self._samples = np.zeros(0, np.float32)

    def append(self, chunk: F32) -> None:
        """Add new samples, forget the oldest."""
        if len(chunk) == 0:
            return
        self._samples = np.concatenate([self._samples, chunk])[-self._size :]

    def last(self, seconds: float) -> F32:
        """Return the newest `seconds`, or as much as there is."""
        count = min(round(seconds * self.sample_rate_hz), len(self._samples))
        return self._samples[len(self._samples) - count :]

    @property
    def seconds(self) -> float:
        """How much is held [s]."""
        return len(self._samples) / self.sample_rate_hz
