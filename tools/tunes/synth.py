"""Instruments: additive tones and noise drums, band-limited and deterministic."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from downbeat.perception.features import F32
from scipy.signal import butter, sosfilt

RATE = 44_100


@dataclass(frozen=True)
class Voice:
    """A tone of harmonics.

    Attributes:
        partials: Amplitude of harmonics 1, 2, ...
        decay_s: Time constant of the first harmonic; higher ones die faster by `damping`.
        damping: Extra decay per harmonic.
        attack_s, release_s: Edges of the envelope.
        detune: Relative detuning of copies; several make it wide.
        vibrato: Depth of a 5.5 Hz vibrato that grows over the note.
        gain: Overall level.
    """

    partials: tuple[float, ...]
    decay_s: float = 10.0
    damping: float = 0.0
    attack_s: float = 0.005
    release_s: float = 0.05
    detune: tuple[float, ...] = (0.0,)
    vibrato: float = 0.0
    gain: float = 1.0


def _saw(count: int, tilt: float = 1.0) -> tuple[float, ...]:
    return tuple(1.0 / n**tilt for n in range(1, count + 1))


VOICES: dict[str, Voice] = {
    "saw_lead": Voice(_saw(14), 2.5, 0.02, 0.01, 0.08, (-0.004, 0.0, 0.005), 0.004, 0.20),
    "pluck": Voice(_saw(12, 1.1), 0.28, 0.25, 0.002, 0.04, (-0.002, 0.002), 0.0, 0.34),
    "pad": Voice(_saw(9, 1.5), 9.0, 0.0, 0.25, 0.35, (-0.006, -0.002, 0.003, 0.007), 0.0, 0.075),
    "choir": Voice(
        (0.6, 1.0, 0.55, 0.5, 0.2, 0.12), 9.0, 0.0, 0.3, 0.4, (-0.005, 0.004), 0.006, 0.1
    ),
    "bass": Voice(_saw(8, 1.3), 0.9, 0.15, 0.004, 0.03, (0.0,), 0.0, 0.55),
    "slap": Voice(_saw(14, 0.9), 0.22, 0.3, 0.001, 0.02, (0.0,), 0.0, 0.5),
    "upright": Voice((1.0, 0.55, 0.25, 0.1), 0.5, 0.3, 0.006, 0.05, (0.0,), 0.0, 0.75),
    "piano": Voice(
        (1.0, 0.6, 0.4, 0.3, 0.2, 0.14, 0.09, 0.06),
        0.7,
        0.22,
        0.002,
        0.08,
        (-0.0008, 0.0008),
        0.0,
        0.26,
    ),
    "brass": Voice(
        (0.7, 1.0, 0.9, 0.7, 0.5, 0.38, 0.28, 0.2, 0.14),
        3.0,
        0.05,
        0.035,
        0.06,
        (-0.003, 0.003),
        0.003,
        0.12,
    ),
    "organ": Voice(
        (1.0, 0.8, 0.0, 0.6, 0.0, 0.3, 0.0, 0.35), 20.0, 0.0, 0.006, 0.03, (0.0,), 0.002, 0.13
    ),
    "bell": Voice(
        (1.0, 0.0, 0.45, 0.0, 0.3, 0.0, 0.2), 0.9, 0.1, 0.001, 0.2, (0.0, 0.003), 0.0, 0.17
    ),
    "flute": Voice((1.0, 0.25, 0.12, 0.05), 8.0, 0.0, 0.05, 0.08, (0.0,), 0.007, 0.3),
}


def hertz(midi: float) -> float:
    """Return the frequency of a MIDI pitch [Hz]."""
    return 440.0 * 2.0 ** ((midi - 69.0) / 12.0)


@lru_cache(maxsize=4096)
def tone(voice_name: str, midi: float, samples: int) -> F32:
    """Return one note, (samples + release,)."""
    voice = VOICES[voice_name]
    release = round(voice.release_s * RATE)
    t = np.arange(samples + release) / RATE
    out = np.zeros(len(t))
    bend = voice.vibrato * np.minimum(t / 0.5, 1.0) / (2 * np.pi * 5.5)
    wobble = bend * np.sin(2 * np.pi * 5.5 * t)
    for copy, detune in enumerate(voice.detune):
        base = hertz(midi) * (1.0 + detune)
        phase = 2 * np.pi * base * (t + wobble)
        for n, amplitude in enumerate(voice.partials, start=1):
            if amplitude == 0.0 or base * n > 0.42 * RATE:
                continue
            decay = np.exp(-t / voice.decay_s * (1.0 + voice.damping * (n - 1)))
            out += amplitude * decay * np.sin(n * phase + 1.7 * copy + 0.3 * n * n)
    edge = np.minimum(t / voice.attack_s, 1.0)
    edge[samples:] *= np.linspace(1.0, 0.0, release)
    return (voice.gain / len(voice.detune) ** 0.5 * out * edge).astype(np.float32)


def _noise(samples: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(samples)


def _band(samples: np.ndarray, low: float, high: float) -> np.ndarray:
    return sosfilt(butter(2, (low, high), "bandpass", fs=RATE, output="sos"), samples)


@lru_cache(maxsize=64)
def drum(name: str) -> F32:
    """Return one hit of a drum, (n,).

    Names: kick, snare, clap, hat, open_hat, crash, conga_low, conga_high, conga_slap, clave,
    cowbell, tom, shaker, riser.
    """
    t = np.arange(round(_DRUM_LENGTH_S.get(name, 0.35) * RATE)) / RATE
    if name == "kick":
        sweep = 48.0 * t + 110.0 / 28.0 * (1.0 - np.exp(-28.0 * t))
        out = 0.95 * np.sin(2 * np.pi * sweep) * np.exp(-t / 0.13)
        out += 0.2 * _noise(len(t), 1) * np.exp(-t / 0.003)
    elif name == "snare":
        out = 0.4 * _band(_noise(len(t), 2), 1200.0, 9000.0) * np.exp(-t / 0.09)
        out += 0.4 * np.sin(2 * np.pi * 190.0 * t) * np.exp(-t / 0.05)
    elif name == "clap":
        gate = sum(np.where(t >= d, np.exp(-(t - d) / 0.012), 0.0) for d in (0.0, 0.011, 0.023))
        tail = np.where(t >= 0.03, np.exp(-(t - 0.03) / 0.09), 0.0)
        out = 0.42 * _band(_noise(len(t), 3), 800.0, 5000.0) * (0.7 * gate + tail)
    elif name in ("hat", "open_hat", "shaker", "crash"):
        tau = {"hat": 0.025, "open_hat": 0.16, "shaker": 0.05, "crash": 0.7}[name]
        level = {"hat": 0.2, "open_hat": 0.2, "shaker": 0.13, "crash": 0.22}[name]
        out = level * _band(_noise(len(t), 4 + len(name)), 6000.0, 16000.0) * np.exp(-t / tau)
    elif name.startswith("conga"):
        pitch = {"conga_low": 175.0, "conga_high": 265.0, "conga_slap": 330.0}[name]
        tau = 0.05 if name == "conga_slap" else 0.16
        out = (
            0.5 * np.sin(2 * np.pi * (pitch * t + 3.0 * (1 - np.exp(-t / 0.02)))) * np.exp(-t / tau)
        )
        out += 0.16 * _band(_noise(len(t), 9), 900.0, 4000.0) * np.exp(-t / 0.012)
    elif name == "clave":
        out = 0.45 * np.sin(2 * np.pi * 2500.0 * t) * np.exp(-t / 0.025)
    elif name == "cowbell":
        square = np.sign(np.sin(2 * np.pi * 562.0 * t)) + np.sign(np.sin(2 * np.pi * 845.0 * t))
        out = 0.2 * _band(square, 500.0, 5000.0) * np.exp(-t / 0.07)
    elif name == "tom":
        sweep = 90.0 * t + 60.0 / 14.0 * (1.0 - np.exp(-14.0 * t))
        out = 0.6 * np.sin(2 * np.pi * sweep) * np.exp(-t / 0.16)
    else:  # riser: noise that opens over two seconds
        sweep = _band(_noise(len(t), 11), 1500.0, 12000.0)
        out = 0.16 * sweep * (t / t[-1]) ** 2
    fade = min(200, len(out))
    out[-fade:] *= np.linspace(1.0, 0.0, fade)
    return out.astype(np.float32)


_DRUM_LENGTH_S = {"crash": 2.0, "riser": 1.9, "open_hat": 0.5, "kick": 0.45}
