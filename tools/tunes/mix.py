"""A song: notes and hits on beats, on buses with effects, mixed and mastered."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from downbeat.perception.features import F32
from downbeat.tools.tunes.synth import RATE, drum, tone
from scipy.signal import fftconvolve

TAIL_S = 1.5
TARGET_RMS_DBFS = -16.0

SCALES = {"major": (0, 2, 4, 5, 7, 9, 11), "minor": (0, 2, 3, 5, 7, 8, 10)}
CHORDS = {
    "": (0, 4, 7),
    "m": (0, 3, 7),
    "7": (0, 4, 7, 10),
    "m7": (0, 3, 7, 10),
    "maj7": (0, 4, 7, 11),
}
NAMES = {
    "C": 0,
    "Db": 1,
    "D": 2,
    "Eb": 3,
    "E": 4,
    "F": 5,
    "Gb": 6,
    "G": 7,
    "Ab": 8,
    "A": 9,
    "Bb": 10,
    "B": 11,
}


def chord(symbol: str, octave: int = 4) -> tuple[int, ...]:
    """Return the MIDI pitches of a chord symbol such as Am7 or Eb."""
    root = symbol[:2] if symbol[:2] in NAMES else symbol[:1]
    base = 12 * (octave + 1) + NAMES[root]
    return tuple(base + step for step in CHORDS[symbol[len(root) :]])


class Song:
    """Buses that notes are added to; times in beats."""

    def __init__(self, bpm: float, beats: float, seed: int) -> None:
        self.bpm = bpm
        self.length = round(beats * 60.0 / bpm * RATE)
        self.rng = np.random.default_rng(seed)
        self._buses: dict[str, F32] = {}
        self._kicks: list[int] = []

    def sample(self, beat: float) -> int:
        """Return the sample at which a beat stands."""
        return round(beat * 60.0 / self.bpm * RATE)

    def _add(self, bus: str, at: int, sound: F32, level: float) -> None:
        if bus not in self._buses:
            self._buses[bus] = np.zeros(self.length + round(TAIL_S * RATE), np.float32)
        buffer = self._buses[bus]
        if at < 0 or at >= self.length:
            return
        count = min(len(sound), len(buffer) - at)
        buffer[at : at + count] += level * sound[:count]

    def note(self, voice: str, midi: float, beat: float, beats: float, level: float = 1.0) -> None:
        """Play a note; small seeded changes of level keep repeats from being copies."""
        human = level * float(self.rng.uniform(0.86, 1.0))
        samples = max(round(beats * 60.0 / self.bpm * RATE), 200)
        self._add(voice, self.sample(beat), tone(voice, midi, samples), human)

    def chord(
        self, voice: str, pitches: Sequence[int], beat: float, beats: float, level: float = 1.0
    ) -> None:
        """Play several notes at once."""
        for pitch in pitches:
            self.note(voice, pitch, beat, beats, level)

    def hit(self, name: str, beat: float, level: float = 1.0) -> None:
        """Play a drum."""
        human = level * float(self.rng.uniform(0.88, 1.0))
        self._add("drums", self.sample(beat), drum(name), human)
        if name == "kick":
            self._kicks.append(self.sample(beat))

    def melody(
        self, voice: str, steps: Sequence[tuple[float, float, float]], start: float, level: float
    ) -> None:
        """Play (beat, beats, midi) relative to `start`."""
        for beat, beats, midi in steps:
            self.note(voice, midi, start + beat, beats * 0.92, level)

    def fill(self, beat: float) -> None:
        """Announce a new section: a drum fill over the last two beats before `beat`."""
        pattern = self.rng.permutation([0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75])[:6]
        for offset in sorted(pattern.tolist()):
            self.hit("tom" if offset < 1.0 else "snare", beat - 2.0 + offset, 0.5 + 0.2 * offset)
        self.hit("crash", beat, 0.9)

    def mix(self, reverb: dict[str, float], duck: dict[str, float], delay: dict[str, float]) -> F32:
        """Return the master, (n,): per bus a reverb share, a sidechain depth, a delay share."""
        total = np.zeros(self.length + round(TAIL_S * RATE))
        wet = np.zeros_like(total)
        envelope = self._duck_envelope(len(total))
        for name in sorted(self._buses):
            bus = self._buses[name].astype(np.float64)
            bus = bus * (1.0 - duck.get(name, 0.0) * envelope)
            if name in delay:
                step = self.sample(0.75)
                for repeat in (1, 2, 3):
                    shifted = np.zeros_like(bus)
                    shifted[repeat * step :] = bus[: -repeat * step]
                    bus = bus + delay[name] ** repeat * shifted
            total += bus
            wet += reverb.get(name, 0.0) * bus
        total += fftconvolve(wet, _impulse_response())[: len(total)]
        return _master(total[: self.length])

    def _duck_envelope(self, count: int) -> np.ndarray:
        """Return 1 at each kick, falling to 0 within a third of a second."""
        envelope = np.zeros(count)
        shape = np.exp(-np.arange(round(0.33 * RATE)) / (0.11 * RATE))
        for at in self._kicks:
            stop = min(at + len(shape), count)
            envelope[at:stop] = np.maximum(envelope[at:stop], shape[: stop - at])
        return envelope


def _impulse_response() -> np.ndarray:
    """Return a synthetic hall of 1.1 s."""
    count = round(1.1 * RATE)
    t = np.arange(count) / RATE
    noise = np.random.default_rng(77).standard_normal(count)
    response = noise * np.exp(-t / 0.25) * np.minimum(t / 0.012, 1.0)
    return response / np.sqrt((response**2).sum()) * 0.6


def _master(samples: np.ndarray) -> F32:
    """Bring the level to the target and limit softly; short fades at both ends."""
    rms = float(np.sqrt((samples**2).mean())) + 1e-9
    out = np.tanh(samples * (10.0 ** (TARGET_RMS_DBFS / 20.0) / rms) * 1.08) * 0.95
    fade = round(0.01 * RATE)
    out[:fade] *= np.linspace(0.0, 1.0, fade)
    tail = round(0.5 * RATE)
    out[-tail:] *= np.linspace(1.0, 0.0, tail)
    return out.astype(np.float32)
