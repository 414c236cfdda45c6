"""Sound out where there is no robot: a sound card, or a file that says what would have sounded.

The same methods as `control.bridge.voice.RobotSpeaker`: what speaks does not know where it sounds.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import soundfile

from downbeat.perception.errors import PerceptionError

SAMPLE_RATE_HZ = 16_000
I16 = npt.NDArray[np.int16]


class Speaker(Protocol):
    """Something that sounds and shines.

    Attributes:
        sample_rate_hz: Of what `play` takes [Hz].
    """

    sample_rate_hz: int

    def play(self, samples: I16, utime: int) -> float:
        """Play (n,) mono samples instead of what plays now; return their duration [s]."""
        ...

    def update(self, utime: int) -> None:
        """Do what is due at `utime` [us]; call it ten times a second."""
        ...

    def is_playing(self, utime: int) -> bool:
        """Whether something sounds."""
        ...

    def stop(self) -> None:
        """Be silent now."""
        ...

    def set_volume(self, volume: float) -> None:
        """Set the volume, 0..1."""
        ...

    def show(self, what: str) -> None:
        """Show what the robot does: "listening", "speaking", "dancing" or "stopped"."""
        ...

    def close(self) -> None:
        """Release the device or finish the file."""
        ...


def _check(samples: I16) -> None:
    if samples.dtype != np.int16 or samples.ndim != 1:
        raise PerceptionError(
            f"{samples.dtype} of shape {samples.shape} cannot be played; valid is one row of int16 "
            f"at {SAMPLE_RATE_HZ} Hz."
        )


def _check_volume(volume: float) -> float:
    if not 0.0 <= volume <= 1.0:
        raise PerceptionError(f"The volume cannot be {volume}; valid are 0 to 1.")
    return volume


class FileSpeaker:
    """Writes what sounds to a WAV file, on the show's time: silence where nothing sounds."""

    sample_rate_hz = SAMPLE_RATE_HZ

    def __init__(self, path: Path, first_utime: int) -> None:
        """Open the file.

        Args:
            path: WAV file, overwritten.
            first_utime: Time of its first sample [us].

        Raises:
            PerceptionError: It cannot be written.
        """
        try:
            self._file: Any = soundfile.SoundFile(
                path, "w", SAMPLE_RATE_HZ, 1, subtype="PCM_16", format="WAV"
            )
        except (soundfile.LibsndfileError, OSError) as error:
            raise PerceptionError(f"{path} cannot be written: {error}.") from error
        self._first_utime = first_utime
        self._written = 0
        self._pending = np.zeros(0, np.int16)
        self._start = 0
        self._volume = 1.0
        self.shown: list[str] = []
        """What the light showed, once per change."""

    def play(self, samples: I16, utime: int) -> float:
        """Begin a sound at `utime` [us]."""
        _check(samples)
        self.update(utime)
        self._pending = (samples * self._volume).astype(np.int16)
        self._start = self._sample_at(utime)
        return len(samples) / SAMPLE_RATE_HZ

    def _sample_at(self, utime: int) -> int:
        return max(0, (utime - self._first_utime) * SAMPLE_RATE_HZ // 1_000_000)

    def update(self, utime: int) -> None:
        """Write what has sounded up to `utime` [us]."""
        end = self._sample_at(utime)
        if end <= self._written:
            return
        block = np.zeros(end - self._written, np.int16)
        first = max(self._start, self._written)
        last = min(self._start + len(self._pending), end)
        if last > first:
            block[first - self._written : last - self._written] = self._pending[
                first - self._start : last - self._start
            ]
        self._file.write(block)
        self._written = end

    def is_playing(self, utime: int) -> bool:
        """Whether something sounds."""
        return self._sample_at(utime) < self._start + len(self._pending)

    def stop(self) -> None:
        """Cut what plays."""
        self._pending = self._pending[: max(0, self._written - self._start)]

    def set_volume(self, volume: float) -> None:
        """Set the volume of what is played from now on, 0..1."""
        self._volume = _check_volume(volume)

    def show(self, what: str) -> None:
        """Note it."""
        if self.shown[-1:] != [what]:
            self.shown.append(what)

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


class LocalSpeaker:
    """Plays on this machine's sound card; needs PortAudio (sounddevice)."""

    sample_rate_hz = SAMPLE_RATE_HZ

    def __init__(self, device: str | int | None = None) -> None:
        """Look for the device.

        Args:
            device: Name or number; None: the default one.

        Raises:
            PerceptionError: No PortAudio, or no such device.
        """
        try:
            import sounddevice

            sounddevice.check_output_settings(
                device=device, samplerate=SAMPLE_RATE_HZ, channels=1, dtype="int16"
            )
        except (ImportError, OSError, ValueError, RuntimeError) as error:
            raise PerceptionError(
                f"Sound cannot be played here ({error}); install PortAudio with `apt-get install "
                "libportaudio2` and `pip install sounddevice`, or write to a file."
            ) from error
        self._card: Any = sounddevice
        self._device = device
        self._end_utime = 0
        self._volume = 1.0

    def play(self, samples: I16, utime: int) -> float:
        """Begin a sound."""
        _check(samples)
        self._card.play(
            (samples * self._volume).astype(np.int16), SAMPLE_RATE_HZ, device=self._device
        )
        duration_s = len(samples) / SAMPLE_RATE_HZ
        self._end_utime = utime + round(duration_s * 1e6)
        return duration_s

    def update(self, utime: int) -> None:
        """Nothing is due: the card plays by itself."""

    def is_playing(self, utime: int) -> bool:
        """Whether something sounds."""
        return utime < self._end_utime

    def stop(self) -> None:
        """Be silent now."""
        self._end_utime = 0
        self._card.stop()

    def set_volume(self, volume: float) -> None:
        """Set the volume of what is played from now on, 0..1."""
        self._volume = _check_volume(volume)

    def show(self, what: str) -> None:
        """There is no light."""

    def close(self) -> None:
        """Be silent."""
        self.stop()
