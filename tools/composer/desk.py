"""The mixing desk: stems on a beat grid, sends to a room, mastering."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from downbeat.perception.features import F32
from downbeat.tools.composer.effects import compress, convolve, drive, highpass, limit
from downbeat.tools.composer.score import Note, hertz
from downbeat.tools.composer.waves import F64, RATE_HZ, count

Instrument = Callable[[float, float], F64]
Hit = Callable[[int], F64]

TAKES = 4
"""A drum hit is recorded so often; no two neighbours are the same sample."""
CEILING = 0.89
"""-1 dB full scale."""
LOUDNESS_DB = -15.0
"""RMS of the finished piece: a loud mix that still breathes."""
FADE_S = 0.005


class Stem:
    """One instrument's track."""

    def __init__(self, desk: Desk, seed: int) -> None:
        self._desk = desk
        self._random = np.random.default_rng(seed)
        self._cache: dict[tuple[object, ...], F64] = {}
        self._take = 0
        self.samples = np.zeros(desk.length)  # (n,)

    def play(
        self,
        instrument: Instrument,
        notes: Iterable[Note],
        gain: float = 1.0,
        loose_s: float = 0.004,
    ) -> Stem:
        """Play notes; `loose_s` is how far a player may be off the grid."""
        for note in notes:
            if not self._desk.has(note.beat):
                continue
            seconds = round(note.beats * self._desk.beat_s, 3)
            key = (instrument, note.pitch, seconds)
            if key not in self._cache:
                self._cache[key] = instrument(hertz(note.pitch), seconds)
            level = gain * note.velocity * self._random.uniform(0.9, 1.1)
            late_s = self._random.uniform(-loose_s, loose_s)
            self._add(self._cache[key], self._desk.time_s(note.beat) + late_s, level)
        return self

    def hit(self, sound: Hit, hits: Iterable[tuple[float, float]], gain: float = 1.0) -> Stem:
        """Strike a drum at every (beat, gain); drums stand on the grid."""
        for beat, strength in hits:
            if not self._desk.has(beat):
                continue
            self._take = (self._take + 1) % TAKES
            key = (sound, self._take)
            if key not in self._cache:
                self._cache[key] = sound(self._take)
            level = gain * strength * self._random.uniform(0.93, 1.0)
            self._add(self._cache[key], self._desk.time_s(beat), level)
        return self

    def sound(self, samples: F64, beat: float, gain: float = 1.0) -> Stem:
        """Place a sound of its own."""
        if self._desk.has(beat):
            self._add(samples, self._desk.time_s(beat), gain)
        return self

    def _add(self, samples: F64, at_s: float, gain: float) -> None:
        first = max(0, count(at_s))
        span = slice(first, min(first + len(samples), len(self.samples)))
        self.samples[span] += gain * samples[: span.stop - first]


class Desk:
    """A piece in the making.

    Attributes:
        beat_s: Length of a beat [s].
        length: Samples of the whole piece, tail included.
    """

    def __init__(self, bpm: float, beats: float, tail_s: float) -> None:
        """Open a desk.

        Args:
            bpm: Tempo.
            beats: Where to stop; what lies behind is not played.
            tail_s: Time for the last notes to ring [s].
        """
        self.beat_s = 60.0 / bpm
        self._beats = beats
        self.length = count(beats * self.beat_s + tail_s)
        self._stems: list[Stem] = []
        self._mix = np.zeros(self.length)  # (n,)
        self._send = np.zeros(self.length)  # (n,)

    def has(self, beat: float) -> bool:
        """Whether a beat lies inside the piece (or the excerpt that is rendered)."""
        return beat <= self._beats

    def time_s(self, beat: float) -> float:
        """Return the time of a beat [s]."""
        return beat * self.beat_s

    def stem(self) -> Stem:
        """Add a stem."""
        stem = Stem(self, seed=1_000 + len(self._stems))
        self._stems.append(stem)
        return stem

    def curve(self, points: Iterable[tuple[float, float]], per_sample: bool = True) -> F64:
        """Return straight lines through (beat, value): an automation lane."""
        beats, values = (np.array(column, np.float64) for column in zip(*points))
        step = 1 if per_sample else 512
        at = np.arange(0, self.length, step) / RATE_HZ / self.beat_s
        return np.interp(at, beats, values)

    def mix(self, samples: F64, gain_db: float, send_db: float | None = None) -> None:
        """Add a finished stem to the mix, and to the room."""
        gain = 10.0 ** (gain_db / 20.0)
        self._mix += gain * samples
        if send_db is not None:
            self._send += gain * 10.0 ** (send_db / 20.0) * samples

    def master(self, response: F64) -> F32:
        """Return the finished piece, (n,) float32: room, glue, loudness, limiter, faded ends."""
        mix = self._mix + highpass(convolve(self._send, response), 180.0)
        mix = highpass(mix, 28.0)
        mix *= 10.0 ** (LOUDNESS_DB / 20.0) / _rms(mix)
        mix = drive(compress(mix, LOUDNESS_DB + 1.0, 2.0), 0.5)
        mix *= 10.0 ** (LOUDNESS_DB / 20.0) / _rms(mix)
        mix = limit(mix, CEILING)
        fade = np.linspace(0.0, 1.0, count(FADE_S))
        mix[-len(fade) :] *= fade[::-1]
        return np.asarray(mix, np.float32)


def _rms(samples: F64) -> float:
    """Return the level of the sounding part."""
    return float(np.sqrt(np.mean(samples**2))) + 1e-9
