"""How much begins to sound, as it sounds: onset strength in groups of bands, in fixed steps.

The growth of the log energy in each band, as the offline grid uses it, but causal: the floor under
the logarithm follows the sound's own level, and every number depends on the past alone. Steps have
a fixed length, so the result does not depend on the size of the blocks that came in.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.fft

from downbeat.perception.features import F32

F64 = npt.NDArray[np.float64]

SAMPLE_RATE_HZ = 16_000
HOP = 160
HOP_S = HOP / SAMPLE_RATE_HZ
"""10 ms per frame."""
STEP_FRAMES = 5
STEP = STEP_FRAMES * HOP
STEP_S = STEP / SAMPLE_RATE_HZ
"""Frames come out by the step of 50 ms."""
WINDOW = 512
"""32 ms: short, so that a beat's place hardly depends on how loud it is."""
NUM_BANDS = 26
MIN_BIN, MAX_BIN = 1, 240
"""31 Hz to 7.5 kHz."""
GROUP_EDGES_HZ = (180.0, 700.0, 2400.0)
NUM_GROUPS = len(GROUP_EDGES_HZ) + 1
"""Bass drum and bass; chords and snare; voices and snare; cymbals."""
LAG_FRAMES = 2
"""Growth is measured over 20 ms."""
FLOOR_SHARE = 0.05
"""The log floor stands so far under the band's own mean: what is weaker is no onset."""
FLOOR = 3e-3
"""And never below this magnitude: a quiet room's noise is no music."""
LEVEL_S = 4.0
LATE_S = 0.007
"""The curve peaks this much after an onset: growth shows as soon as the window touches it, but is
complete only at the end of the lag (measured on the bundled pieces, whose beats are known)."""


def _band_edges() -> npt.NDArray[np.int64]:
    """Return the first bin of each band and the end of the last, (NUM_BANDS + 1,)."""
    for count in range(NUM_BANDS, 200):
        edges = np.unique(np.geomspace(MIN_BIN, MAX_BIN, count + 1).round().astype(np.int64))
        if len(edges) > NUM_BANDS:
            return edges
    raise AssertionError("too few bins for the bands")


_EDGES = _band_edges()
_CENTRE_HZ = 0.5 * (_EDGES[:-1] + _EDGES[1:]) * SAMPLE_RATE_HZ / WINDOW
_GROUP = np.searchsorted(GROUP_EDGES_HZ, _CENTRE_HZ)
_MEMBERS = np.equal.outer(_GROUP, np.arange(NUM_GROUPS))
GROUP_WEIGHTS = _MEMBERS / _MEMBERS.sum(axis=0)
"""(bands, groups): the mean over a group's bands."""
_HANN = np.hanning(WINDOW + 1)[:-1].astype(np.float32)
_KEEP = WINDOW - HOP
"""Samples that the next step needs of this one."""
_DECAY = float(np.exp(-STEP_S / LEVEL_S))


class OnsetStream:
    """Sound in blocks of any size, onset frames out in steps of STEP_FRAMES.

    Frame k is centred on sample k * HOP; it comes out once WINDOW / 2 samples more were heard.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Begin anew: the next sample is sample 0."""
        # What came before is unknown; the first frames lean on silence and are not used.
        self._rest = np.zeros(WINDOW // 2, np.float32)
        self._before: F64 | None = None
        self._level = np.zeros(len(_CENTRE_HZ))
        self._weight = 0.0

    def push(self, samples: F32) -> list[F64]:
        """Hear on.

        Args:
            samples: (n,) mono, 16 kHz, full scale 1.

        Returns:
            The steps that were completed, each (STEP_FRAMES, NUM_GROUPS), not negative.
        """
        self._rest = np.concatenate([self._rest, np.asarray(samples, np.float32)])
        steps = []
        used = 0
        while len(self._rest) - used >= STEP + _KEEP:
            steps.append(self._step(self._rest[used : used + STEP + _KEEP]))
            used += STEP
        self._rest = self._rest[used:].copy()
        return steps

    def _step(self, sound: F32) -> F64:
        windows = np.lib.stride_tricks.sliding_window_view(sound, WINDOW)[::HOP]
        spectrum = scipy.fft.rfft(windows * _HANN, axis=1)  # (STEP_FRAMES, 257)
        magnitude = np.abs(spectrum[:, : _EDGES[-1]]).astype(np.float64)
        bands = np.add.reduceat(magnitude, _EDGES[:-1], axis=1) / np.diff(_EDGES)
        self._level = _DECAY * self._level + (1.0 - _DECAY) * bands.mean(axis=0)
        self._weight = _DECAY * self._weight + (1.0 - _DECAY)
        log_bands = np.log(bands + FLOOR + FLOOR_SHARE * self._level / self._weight)
        before = log_bands[:1].repeat(LAG_FRAMES, 0) if self._before is None else self._before
        joined = np.concatenate([before, log_bands])
        self._before = log_bands[-LAG_FRAMES:]
        growth = np.maximum(joined[LAG_FRAMES:] - joined[:-LAG_FRAMES], 0.0)
        return np.asarray(growth @ GROUP_WEIGHTS)  # (STEP_FRAMES, NUM_GROUPS)
