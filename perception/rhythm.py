"""What tempo and phase the last seconds speak for: a leaky Fourier bank and a learned template.

Each group of bands has one complex number per rhythmic frequency, which forgets exponentially. A
tempo and a phase together pick some of them (the beat, its half, its harmonics) and turn them to
where a beat would stand; a linear template then says how much that looks like a beat. The template
knows that the bass stands on the beat and cymbals often between beats; it was learned from
recordings by `downbeat.tools.train_follow` and is a table of numbers, no more.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from importlib.resources.abc import Traversable

import numpy as np
import numpy.typing as npt

from downbeat.perception.onset_stream import F64, HOP_S, NUM_GROUPS, STEP_FRAMES, STEP_S

C128 = npt.NDArray[np.complex128]

MIN_BPM, MAX_BPM = 78.0, 164.0
"""One octave, 80 to 160 BPM, and a little more on both sides, so that 80 and 160 are inside."""
PER_OCTAVE = 116
"""Tempos stand 0.6 % apart; three times a frequency is 183.9 steps up."""
NUM_TEMPOS = int(np.floor(PER_OCTAVE * np.log2(MAX_BPM / MIN_BPM))) + 1
TEMPOS_BPM = MIN_BPM * 2.0 ** (np.arange(NUM_TEMPOS) / PER_OCTAVE)
PERIODS_S = 60.0 / TEMPOS_BPM
NUM_PHASES = 24
PHASES = np.arange(NUM_PHASES) / NUM_PHASES
HARMONICS = np.array([0.5, 1.0, 1.5, 2.0, 3.0, 4.0])
"""Multiples of the beat's frequency. Of the halves only the size counts: which of two beats is the
first does not matter here."""
WHOLE, HALVES = [1, 3, 4, 5], [0, 2]
_SHIFTS = np.round(PER_OCTAVE * np.log2(HARMONICS)).astype(int)
_FREQUENCIES_HZ = (
    MIN_BPM / 60.0 * 2.0 ** (np.arange(_SHIFTS[0], NUM_TEMPOS + _SHIFTS[-1]) / PER_OCTAVE)
)
_PICK = np.arange(NUM_TEMPOS)[:, None] + _SHIFTS - _SHIFTS[0]  # (NUM_TEMPOS, harmonics)
MEMORY_S = 4.0
"""The bank forgets to 1/e in this time."""
LEVEL_S = 4.0
LEVEL_FLOOR = 0.02
"""Growth of log energy per frame that is nothing; music has 0.05 to 0.3."""
MAX_STRENGTH = 6.0
"""One loud crash counts no more than this many mean frames."""
_TURN = np.exp(2j * np.pi * np.outer(HARMONICS, PHASES))  # (harmonics, NUM_PHASES)
_OCTAVES = np.log2(TEMPOS_BPM / 120.0)
_PART_ENDS = np.cumsum(NUM_GROUPS * np.array([4, 4, 2, len(HARMONICS)]))
"""Real and imaginary parts at the whole harmonics, sizes of the halves, all sizes, the tempo."""
FEATURES = int(_PART_ENDS[-1]) + 2


class Equaliser:
    """Brings every group of bands to the same mean, by what was heard so far."""

    def __init__(self) -> None:
        self._mean = np.zeros(NUM_GROUPS)
        self._weight = 0.0

    def push(self, onsets: F64) -> F64:
        """Return a step, (STEP_FRAMES, NUM_GROUPS), with a mean near zero."""
        keep = float(np.exp(-STEP_S / LEVEL_S))
        self._mean = keep * self._mean + (1.0 - keep) * onsets.mean(axis=0)
        self._weight = keep * self._weight + 1.0 - keep
        mean = self._mean / self._weight
        strength = np.minimum(onsets / (mean + LEVEL_FLOOR), MAX_STRENGTH)
        return np.asarray(strength - mean / (mean + LEVEL_FLOOR))

    @property
    def activity(self) -> float:
        """Mean growth of log energy per frame, over the groups."""
        return float(self._mean.mean() / max(self._weight, 1e-9))


class RhythmBank:
    """Fourier coefficients of the onsets at rhythmic frequencies, forgetting."""

    def __init__(self, memory_s: float = MEMORY_S) -> None:
        self._keep = float(np.exp(-STEP_S / memory_s))
        self._omega = 2.0 * np.pi * _FREQUENCIES_HZ
        ages = HOP_S * (STEP_FRAMES - np.arange(STEP_FRAMES))
        self._in = np.exp(1j * np.outer(self._omega, ages))
        self._on = np.exp(1j * self._omega * STEP_S)[:, None] * self._keep
        self._sums: C128 = np.zeros((len(self._omega), NUM_GROUPS), np.complex128)
        self._power = np.zeros(NUM_GROUPS)
        self._frames = 0.0

    def push(self, strength: F64) -> None:
        """Hear one step of an Equaliser, (STEP_FRAMES, NUM_GROUPS)."""
        self._sums = self._on * self._sums + self._in @ strength
        self._power = self._keep * self._power + (strength**2).sum(axis=0)
        self._frames = self._keep * self._frames + STEP_FRAMES

    @property
    def fill(self) -> float:
        """How much of the memory holds sound, 0..1: few beats always look regular."""
        return float(self._frames * (1.0 - self._keep) / STEP_FRAMES)

    def coefficients(self) -> C128:
        """Return what each tempo picks, (NUM_TEMPOS, NUM_GROUPS, harmonics).

        Sizes are 0..1; phase 0 is the end of the last step: a beat phi periods later gives a
        positive number when it is turned by exp(2 pi i m phi).
        """
        size = np.sqrt(self._power * self._frames) + 1e-6 + 0.05 * self._frames
        picked = (self._sums / size)[_PICK]  # (NUM_TEMPOS, harmonics, NUM_GROUPS)
        return np.asarray(picked.transpose(0, 2, 1))


@dataclass(frozen=True)
class BeatTemplate:
    """What a beat looks like in the coefficients: a small network over `features`.

    Row 0 of the weights is the linear part; the others are hidden units, which know what belongs
    together: a cymbal between two bass drums speaks for the bass, alone it speaks for itself.

    Attributes:
        weights: (1 + hidden, FEATURES) in the order of `features`.
        bias: (hidden,) of the hidden units.
        out: (hidden,) what each adds to the score.
    """

    weights: F64
    bias: F64
    out: F64

    def score(self, coefficients: C128) -> F64:
        """Return the score of every tempo and phase, (NUM_TEMPOS, NUM_PHASES)."""
        rows = self._rows(coefficients)
        linear, hidden = rows[:, 0], np.tanh(rows[:, 1:] + self.bias[:, None])
        return np.asarray(linear + np.einsum("thp,h->tp", hidden, self.out))

    def _rows(self, coefficients: C128) -> F64:
        """Return weights times features without making them, (NUM_TEMPOS, rows, NUM_PHASES)."""
        real, imag, halves, sizes, tempo = np.split(self.weights, _PART_ENDS, axis=1)
        turned = (real - 1j * imag).reshape(len(real), NUM_GROUPS, -1)
        whole = np.einsum("tgm,rgm->trm", coefficients[:, :, WHOLE], turned, optimize=True)
        rows = (whole @ _TURN[WHOLE]).real
        half = np.abs((coefficients[:, :, HALVES, None] * _TURN[HALVES]).real)
        rows += halves @ half.reshape(NUM_TEMPOS, -1, NUM_PHASES)
        flat = np.abs(coefficients).reshape(NUM_TEMPOS, -1) @ sizes.T
        flat += np.stack([_OCTAVES, _OCTAVES**2], axis=1) @ tempo.T
        return np.asarray(rows + flat[:, :, None])


def features(coefficients: C128) -> F64:
    """Return what a template weighs, (NUM_TEMPOS, NUM_PHASES, FEATURES); for learning only."""
    turned = coefficients[:, None] * _TURN.T[None, :, None, :]
    whole = turned[..., WHOLE].reshape(NUM_TEMPOS, NUM_PHASES, -1)
    halves = np.abs(turned[..., HALVES].real).reshape(NUM_TEMPOS, NUM_PHASES, -1)
    sizes = np.abs(turned).reshape(NUM_TEMPOS, NUM_PHASES, -1)
    octaves = np.broadcast_to(_OCTAVES[:, None, None], (NUM_TEMPOS, NUM_PHASES, 1))
    return np.concatenate([whole.real, whole.imag, halves, sizes, octaves, octaves**2], axis=2)


def read_template(file: Traversable) -> BeatTemplate:
    """Return the template that `downbeat.tools.train_follow` wrote."""
    parts = json.loads(file.read_text(encoding="utf-8"))
    return BeatTemplate(**{name: np.array(values, np.float64) for name, values in parts.items()})


@lru_cache(maxsize=1)
def bundled_template() -> BeatTemplate:
    """Return the template in the wheel."""
    return read_template(resources.files("downbeat.perception") / "data" / "beat_template.json")
