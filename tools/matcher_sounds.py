"""What a room, a microphone and other people do to music: conditions of the matcher's bench.

The conditions of the project's chunk study: white noise, and a robot's microphone (reverberation,
voices, pink noise, a narrow band, low level). Deterministic by the generator handed in.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import soxr
from scipy.signal import butter, fftconvolve, sosfilt

from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32
from downbeat.perception.source import Recording, audio_files, load_recording
from downbeat.tools.mashup import SAMPLE_RATE_HZ

Condition = Callable[[F32, int, np.random.Generator], F32]
"""(samples, sample rate [Hz], generator) -> samples of the same length."""

REVERB_RT60_S = 0.5
BABBLE_SNR_DB = PINK_SNR_DB = 10.0
BAND_HZ = (120.0, 7200.0)
MICROPHONE_GAIN_DB = -10.0
BLOCK_S = 7.5
"""A signal-to-noise ratio holds for each block of this length, as in the chunk study."""


def add_noise(samples: F32, noise: F32, snr_db: float, sample_rate_hz: int) -> F32:
    """Add noise at a ratio to the level of each block."""
    block = round(BLOCK_S * sample_rate_hz)
    out = samples.copy()
    for first in range(0, len(samples), block):
        part = slice(first, first + block)
        gain = _rms(samples[part]) / _rms(noise[part]) * 10.0 ** (-snr_db / 20.0)
        out[part] += noise[part] * np.float32(gain)
    return out


def white_noise(snr_db: float) -> Condition:
    """Return the condition "white noise at this ratio"."""

    def apply(samples: F32, sample_rate_hz: int, rng: np.random.Generator) -> F32:
        noise = rng.standard_normal(len(samples)).astype(np.float32)
        return add_noise(samples, noise, snr_db, sample_rate_hz)

    return apply


def robot_microphone(babble: F32) -> Condition:
    """Return the condition "heard by a robot in a room with people".

    Args:
        babble: Voices at any level, repeated as needed; at the rate of the sound.
    """

    def apply(samples: F32, sample_rate_hz: int, rng: np.random.Generator) -> F32:
        response = room(REVERB_RT60_S, sample_rate_hz, rng)
        sound = fftconvolve(samples, response)[: len(samples)].astype(np.float32)
        voices = np.resize(np.roll(babble, -int(rng.integers(len(babble)))), len(sound))
        sound = add_noise(sound, voices, BABBLE_SNR_DB, sample_rate_hz)
        sound = add_noise(sound, pink_noise(len(sound), rng), PINK_SNR_DB, sample_rate_hz)
        band = butter(4, BAND_HZ, "bandpass", fs=sample_rate_hz, output="sos")
        return (sosfilt(band, sound) * 10.0 ** (MICROPHONE_GAIN_DB / 20.0)).astype(np.float32)

    return apply


def make_babble(voices: list[F32], seconds: float, sample_rate_hz: int) -> F32:
    """Return several voices at once, each of the same level, (n,)."""
    count = round(seconds * sample_rate_hz)
    rng = np.random.default_rng(7)
    babble = np.zeros(count, np.float32)
    for voice in voices + voices:
        turned = np.roll(voice, int(rng.integers(len(voice))))
        babble += np.resize(turned, count) / np.float32(_rms(voice))
    return babble


def pink_noise(count: int, rng: np.random.Generator) -> F32:
    """Return noise with equal power per octave, (count,)."""
    bins = np.maximum(np.arange(count // 2 + 1), 20.0)
    spectrum = (rng.standard_normal(len(bins)) + 1j * rng.standard_normal(len(bins))) / bins**0.5
    return np.fft.irfft(spectrum, count).astype(np.float32)


def room(
    rt60_s: float, sample_rate_hz: int, rng: np.random.Generator, direct_db: float = 0.0
) -> F32:
    """Return a synthetic impulse response; `direct_db`: direct over diffuse sound."""
    count = round(1.2 * rt60_s * sample_rate_hz)
    decay = np.exp(-6.908 * np.arange(count) / sample_rate_hz / rt60_s)
    tail = rng.standard_normal(count) * decay
    tail[: round(0.002 * sample_rate_hz)] = 0.0
    tail *= 10.0 ** (-direct_db / 20.0) / np.sqrt((tail**2).sum())
    tail[0] = 1.0
    return tail.astype(np.float32)


def _rms(samples: F32) -> float:
    return float(np.sqrt(np.mean(samples.astype(np.float64) ** 2)) + 1e-12)


def synthetic_sounds(seconds: float = 20.0) -> list[Recording]:
    """Return tones, chords, noise and silence."""
    rng = np.random.default_rng(11)
    count = round(seconds * SAMPLE_RATE_HZ)
    t = np.arange(count) / SAMPLE_RATE_HZ
    sounds: dict[str, Callable[[], F32]] = {
        "silence": lambda: np.zeros(count, np.float32),
        "white": lambda: 0.1 * rng.standard_normal(count),
        "brown": lambda: _brown(count, rng),
        "siren": lambda: 0.2 * np.sin(2 * np.pi * (600 * t - 60 * np.cos(2 * np.pi * 0.5 * t))),
    }
    for hertz in (220.0, 440.0, 523.25, 1000.0):
        sounds[f"tone {hertz:g}"] = lambda hertz=hertz: 0.2 * np.sin(2 * np.pi * hertz * t)
        sounds[f"chord {hertz:g}"] = lambda hertz=hertz: sum(
            0.1 * np.sin(2 * np.pi * hertz * ratio * t) for ratio in (1.0, 1.25, 1.5)
        )
    return [Recording(n, make().astype(np.float32), SAMPLE_RATE_HZ) for n, make in sounds.items()]


def _brown(count: int, rng: np.random.Generator) -> F32:
    walk = np.cumsum(rng.standard_normal(count))
    walk -= np.linspace(walk[0], walk[-1], count)
    return 0.1 * walk / walk.std()


def load_folder(folder: Path, say: Callable[[str], None] | None = None) -> dict[str, Recording]:
    """Decode a folder of recordings, by name.

    Args:
        folder: Of audio files.
        say: Told of each file that is left out; None: such a file is an error.

    Raises:
        PerceptionError: No folder of audio files; without `say`, a file that cannot be read.
    """
    found: dict[str, Recording] = {}
    for path in audio_files(folder):
        try:
            recording = load_recording(path)
        except PerceptionError as error:
            if say is None:
                raise
            say(f"left out: {error}")
            continue
        found[recording.name] = recording
    return found


def conditions(speech: Path | None) -> dict[str, Condition | None]:
    """Return the conditions that can be measured; a robot's microphone needs voices."""
    found: dict[str, Condition | None] = {"clean": None, "white noise 10 dB": white_noise(10.0)}
    if speech is not None:
        voices = [
            soxr.resample(r.samples, r.sample_rate_hz, SAMPLE_RATE_HZ)
            for r in load_folder(speech).values()
        ]
        found["robot microphone"] = robot_microphone(make_babble(voices, 30.0, SAMPLE_RATE_HZ))
    return found
