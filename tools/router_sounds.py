"""Sound that the router learns from: music, voices and noise, mixed and heard in many ways.

What a window is called: music alone (1, 0) as (p_music, p_speech), speech alone (0, 1), neither
(0, 0). Of speech over music both count where they are equally loud, and the quieter one fades out
of the account over MASKED_DB: the difference of the two is what the rule asks for.
"""

from __future__ import annotations

import io
import shutil
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import soundfile
import soxr
from scipy.signal import butter, fftconvolve, lfilter, sosfilt

from downbeat.perception.features import F32
from downbeat.perception.router_frames import SAMPLE_RATE_HZ
from downbeat.perception.source import Recording
from downbeat.tools.matcher_sounds import pink_noise, room
from downbeat.tools.recogniser_sentences import CALIBRATION_SENTENCES, CALIBRATION_VOICES

CLIP_S = 7.0
MASKED_DB = 10.0
ACTIVE_DB = 30.0
"""The level of speech is that of its parts that are not this much below the loudest."""
LEVELS_DBFS = (-48.0, -8.0)
LANGUAGES = ("de", "fr", "es", "it", "pl", "ru", "pt", "sv", "nl", "tr", "hi", "cmn", "fi", "el")
TIMBRES = ("", "+f1", "+f2", "+f3", "+m2", "+m3", "+m5", "+klatt2")
TRAINED_VOICES = (*CALIBRATION_VOICES, *(a + b for a, b in zip(LANGUAGES, TIMBRES * 2)))


@dataclass(frozen=True)
class Clip:
    """Something to learn.

    Attributes:
        kind: "music", "song", "sung", "speech", "speech over music", "other".
        source: What it was made of; a source is never both trained on and validated with.
        samples: (n,) 16 kHz.
        p_music: 0..1.
        p_speech: 0..1.
    """

    kind: str
    source: str
    samples: F32
    p_music: float
    p_speech: float


def at_rate(recording: Recording) -> F32:
    """Return a recording's sound at 16 kHz."""
    if recording.sample_rate_hz == SAMPLE_RATE_HZ:
        return recording.samples
    sound = soxr.resample(recording.samples, recording.sample_rate_hz, SAMPLE_RATE_HZ)
    return np.asarray(sound, np.float32)


def synthetic_voices(
    voices: tuple[str, ...] = TRAINED_VOICES,
    sentences: tuple[str, ...] = CALIBRATION_SENTENCES,
    per_voice: int = 8,
) -> dict[str, F32]:
    """Return what espeak-ng says, by voice; nothing where it is not installed."""
    if shutil.which("espeak-ng") is None:
        return {}
    rng = np.random.default_rng(5)
    found = {}
    for voice in voices:
        chosen = [str(sentences[int(i)]) for i in rng.integers(0, len(sentences), per_voice)]
        pace = str(int(rng.integers(130, 200)))
        command = ["espeak-ng", "-v", voice, "-s", pace, "--stdout", ". ".join(chosen)]
        spoken = subprocess.run(command, capture_output=True, check=False, timeout=60)
        if spoken.returncode == 0 and len(spoken.stdout) > 1000:
            samples, rate = soundfile.read(io.BytesIO(spoken.stdout), dtype="float32")
            found[f"espeak {voice}"] = at_rate(Recording(voice, samples, rate))
    return found


def over_music(speech: F32, music: F32, ratio_db: float) -> F32:
    """Return speech over music; the ratio is that of the level while somebody speaks."""
    gain = active_rms(speech) / (_rms(music) + 1e-9) * 10.0 ** (-ratio_db / 20.0)
    return np.asarray(speech + music * np.float32(gain), np.float32)


def active_rms(samples: F32) -> float:
    """Return the level of speech without its pauses."""
    blocks = samples[: len(samples) // 320 * 320].reshape(-1, 320)
    power = (blocks.astype(np.float64) ** 2).mean(axis=1)
    loud = power[power >= power.max() * 10.0 ** (-ACTIVE_DB / 10.0)]
    return float(np.sqrt(loud.mean()))


def truth_over_music(ratio_db: float) -> tuple[float, float]:
    """Return what speech over music at a ratio is called: (p_music, p_speech)."""
    music = float(np.clip(1.0 - ratio_db / MASKED_DB, 0.0, 1.0))
    return music, float(np.clip(1.0 + ratio_db / MASKED_DB, 0.0, 1.0))


def noises(count: int, rng: np.random.Generator) -> F32:
    """Return some sound that is neither music nor speech, (count,)."""
    made = _NOISES[int(rng.integers(len(_NOISES)))](count, rng)
    if rng.random() < 0.3:
        made = made / (_rms(made) + 1e-9) + 0.5 * rng.standard_normal(count)
    return np.asarray(made / (_rms(made) + 1e-9), np.float32)


def _coloured(count: int, rng: np.random.Generator) -> F32:
    slope = rng.uniform(0.0, 1.0)
    bins = np.maximum(np.arange(count // 2 + 1), 20.0)
    spectrum = (rng.standard_normal(len(bins)) + 1j * rng.standard_normal(len(bins))) / bins**slope
    return np.fft.irfft(spectrum, count)


def _gusts(count: int, rng: np.random.Generator) -> F32:
    """Wind, waves, traffic: noise that swells."""
    slow = np.interp(np.arange(count), *_points(count, rng.uniform(0.3, 3.0), rng))
    return _coloured(count, rng) * np.exp(rng.uniform(0.5, 2.0) * slow)


def _tones(count: int, rng: np.random.Generator) -> F32:
    """Hum, beeps, alarms: a few steady or switched tones."""
    t = np.arange(count) / SAMPLE_RATE_HZ
    out = np.zeros(count)
    base = rng.choice([50.0, 60.0, 100.0, 120.0, rng.uniform(200.0, 3000.0)])
    for harmonic in range(1, int(rng.integers(2, 8))):
        out += rng.uniform(0.0, 1.0) / harmonic * np.sin(2 * np.pi * base * harmonic * t)
    if rng.random() < 0.5:
        out *= np.sin(2 * np.pi * rng.uniform(0.3, 4.0) * t) > 0
    return out + 0.02 * rng.standard_normal(count)


def _motor(count: int, rng: np.random.Generator) -> F32:
    """A robot's joints, drills, engines: a buzz whose pitch follows its load."""
    wander = np.interp(np.arange(count), *_points(count, rng.uniform(1.0, 6.0), rng))
    hertz = rng.uniform(40.0, 400.0) * np.exp(0.4 * wander)
    phase = np.cumsum(hertz) / SAMPLE_RATE_HZ
    buzz = np.tanh(3.0 * np.sin(2 * np.pi * phase)) * np.exp(0.5 * wander)
    return buzz + rng.uniform(0.1, 1.0) * _coloured(count, rng) * np.sqrt(count)


def _steps(count: int, rng: np.random.Generator) -> F32:
    """Steps, knocks, clapping, dishes: short noises, regular or not."""
    out = np.zeros(count)
    at, every = 0.0, rng.uniform(0.1, 1.2)
    jitter = rng.choice([0.02, 0.6])
    length = round(rng.uniform(0.01, 0.15) * SAMPLE_RATE_HZ)
    decay = np.exp(-np.arange(length) / (0.25 * length))
    while at * SAMPLE_RATE_HZ < count - length:
        first = round(at * SAMPLE_RATE_HZ)
        hit = rng.standard_normal(length) * decay * rng.uniform(0.3, 1.0)
        out[first : first + length] += lfilter([1.0], [1.0, -rng.uniform(0.0, 0.95)], hit)
        at += every * max(0.1, 1.0 + jitter * rng.standard_normal())
    return out + 0.003 * rng.standard_normal(count)


def _chirps(count: int, rng: np.random.Generator) -> F32:
    """Birds, squeaks, sirens: sweeps with pauses."""
    out = np.zeros(count)
    first = 0
    while first < count - 2000:
        length = int(rng.integers(800, 8000))
        t = np.linspace(0.0, 1.0, min(length, count - first))
        low, span = rng.uniform(300.0, 4000.0), rng.uniform(-0.5, 1.5)
        hertz = low * 2.0 ** (span * t + 0.1 * np.sin(2 * np.pi * rng.uniform(0.0, 12.0) * t))
        tone = np.sin(2 * np.pi * np.cumsum(np.minimum(hertz, 7500.0)) / SAMPLE_RATE_HZ)
        out[first : first + len(t)] += tone * np.hanning(len(t)) * rng.uniform(0.2, 1.0)
        first += length + int(rng.integers(200, 20_000))
    return out + 0.01 * rng.standard_normal(count)


def _pink(count: int, rng: np.random.Generator) -> F32:
    return pink_noise(count, rng)


def _points(count: int, hertz: float, rng: np.random.Generator) -> tuple[F32, F32]:
    number = max(2, round(hertz * count / SAMPLE_RATE_HZ) + 2)
    return np.linspace(0, count, number), rng.standard_normal(number)


_NOISES: tuple[Callable[[int, np.random.Generator], F32], ...] = (
    _coloured, _pink, _gusts, _tones, _motor, _steps, _chirps,
)  # fmt: skip


def heard(samples: F32, rng: np.random.Generator) -> F32:
    """Return the sound as some microphone in some room hears it, at some level."""
    out = samples / (_rms(samples) + 1e-9)
    if rng.random() < 0.5:
        response = room(rng.uniform(0.15, 0.8), SAMPLE_RATE_HZ, rng, rng.uniform(-3.0, 10.0))
        out = fftconvolve(out, response)[: len(out)]
    if rng.random() < 0.5:
        low, high = rng.uniform(40.0, 300.0), rng.uniform(3400.0, 7800.0)
        out = sosfilt(butter(2, (low, high), "bandpass", fs=SAMPLE_RATE_HZ, output="sos"), out)
    if rng.random() < 0.5:
        out = lfilter([1.0, rng.uniform(-0.7, 0.5)], [1.0], out)
    if rng.random() < 0.5:
        out = out + _rms(out) * 10.0 ** (-rng.uniform(0.0, 30.0) / 20.0) * noises(len(out), rng)
    if rng.random() < 0.1:
        out = np.clip(out, -1.2 * _rms(out), 1.2 * _rms(out))
    level = 10.0 ** (rng.uniform(*LEVELS_DBFS) / 20.0)
    out = out / (_rms(out) + 1e-9) * level + 10.0 ** (-80.0 / 20.0) * rng.standard_normal(len(out))
    return np.asarray(np.clip(out, -1.0, 1.0), np.float32)


def piece(sounds: Mapping[str, F32], rng: np.random.Generator) -> tuple[str, F32]:
    """Return (name, CLIP_S of it) of one of the sounds, from a place that is not silent."""
    names = sorted(sounds)
    name = names[int(rng.integers(len(names)))]
    count = round(CLIP_S * SAMPLE_RATE_HZ)
    sound = sounds[name]
    if len(sound) < count:
        sound = np.tile(sound, count // len(sound) + 1)
    for _ in range(8):
        first = int(rng.integers(len(sound) - count + 1))
        part = sound[first : first + count]
        if _rms(part) > 1e-3:
            break
    return name, part


def babble(voices: Mapping[str, F32], rng: np.random.Generator) -> F32:
    """Return eight people talking at once, (CLIP_S,), RMS 1."""
    mixed = sum(p / (_rms(p) + 1e-9) for _, p in (piece(voices, rng) for _ in range(8)))
    return np.asarray(mixed / (_rms(np.asarray(mixed)) + 1e-9), np.float32)


def _rms(samples: F32) -> float:
    return float(np.sqrt(np.mean(np.asarray(samples, np.float64) ** 2)))
