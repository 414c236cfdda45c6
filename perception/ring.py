"""The last seconds of sound, 16 kHz mono, every sample with its time; what is missing is a gap.

A gap is never bridged: whoever asks for the last seconds gets only what followed the newest gap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import soxr

from downbeat.perception.features import F32

RATE_HZ = 16_000
"""Of everything behind a source."""
ROUNDING_US = 1.0
"""Stamps are whole microseconds, samples are not."""
LOUDEST = 1_000.0
"""60 dB above full scale is no sound: memory that a driver did not fill."""
MAX_FOLLOW_US = 20_000.0
"""A block that claims to follow, but is off by more, does not."""


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Sound without a gap in it.

    Attributes:
        samples: (n,) mono, full scale 1.
        utime: When samples[0] sounded [us].
        follows: True: it continues the block before, and a small difference of the stamps is a
            clock that runs differently. False: samples are missing before it. None: the stamps say.
    """

    samples: F32
    utime: int
    follows: bool | None = None


class Ring:
    """Preallocated; appending costs what the block costs, whatever the ring holds."""

    def __init__(self, seconds: float, sample_rate_hz: int = RATE_HZ) -> None:
        """Make an empty ring.

        Args:
            seconds: How much it holds [s].
            sample_rate_hz: [Hz].
        """
        self.sample_rate_hz = sample_rate_hz
        self.num_gaps = 0
        """Gaps so far; the beginning is none."""
        self._us = 1e6 / sample_rate_hz
        self._buffer = np.zeros(round(seconds * sample_rate_hz), np.float32)
        self._total = 0  # samples ever appended; the next one goes to this place, modulo the size
        self._run_start = 0  # the first one after the newest gap
        # Sample number `_anchor` sounded at `_anchor_utime`; the others are counted from there, so
        # that the stamps do not depend on how the sound was cut into blocks.
        self._anchor = 0
        self._anchor_utime: int | None = None

    def append(
        self, samples: F32, first_utime: int | None = None, follows: bool | None = None
    ) -> None:
        """Add new samples, forget the oldest.

        Args:
            samples: (n,).
            first_utime: When samples[0] sounded [us]; None: right after what is held.
            follows: As in `Block`.
        """
        count = len(samples)
        if count == 0:
            return
        if first_utime is None:
            first_utime = 0 if self._anchor_utime is None else self._utime_of(self._total)
        self._place(first_utime, follows)
        size = len(self._buffer)
        kept = samples[max(0, count - size) :]
        at = (self._total + count - len(kept)) % size
        head = min(len(kept), size - at)
        self._buffer[at : at + head] = kept[:head]
        self._buffer[: len(kept) - head] = kept[head:]
        self._total += count

    def _place(self, utime: int, follows: bool | None) -> None:
        """Decide whether the next sample continues what is held, and when it sounded."""
        if self._anchor_utime is None:
            self._anchor, self._anchor_utime = self._total, utime
            return
        off_us = (utime - self._anchor_utime) - (self._total - self._anchor) * self._us
        if abs(off_us) <= ROUNDING_US and follows is not False:
            return
        tolerance_us = MAX_FOLLOW_US if follows else 0.5 * self._us
        if follows is False or abs(off_us) > max(tolerance_us, ROUNDING_US):
            self.mark_gap()
        self._anchor, self._anchor_utime = self._total, utime

    def mark_gap(self) -> None:
        """Say that samples are missing after what is held: it will not be returned any more."""
        if self._total > self._run_start:
            self.num_gaps += 1
            self._run_start = self._total

    def last(self, seconds: float) -> F32:
        """Return a copy of the newest `seconds`, or as much as there is since the newest gap."""
        count = min(round(seconds * self.sample_rate_hz), self._held)
        size = len(self._buffer)
        first = (self._total - count) % size
        tail = self._buffer[first : first + count]
        return np.concatenate([tail, self._buffer[: count - len(tail)]])

    @property
    def _held(self) -> int:
        return min(self._total - self._run_start, len(self._buffer))

    @property
    def seconds(self) -> float:
        """How much is held since the newest gap [s]."""
        return self._held / self.sample_rate_hz

    @property
    def last_utime(self) -> int:
        """When the newest sample had sounded: the time of the one after it [us]; 0 before any."""
        return 0 if self._anchor_utime is None else self._utime_of(self._total)

    def _utime_of(self, number: int) -> int:
        assert self._anchor_utime is not None
        return self._anchor_utime + int((number - self._anchor) * self._us)


class Resampler:
    """Blocks of any rate to 16 kHz, once, by a stream; stamps stay those of the sound.

    The filter's own delay only means that the newest samples (up to 60 ms) come with the next
    block: sample k of a run's output sounded k / 16 kHz after the run began (soxr drops the
    filter's start). A gap ends the run; what is left in the filter comes first. Samples that are
    not finite, or far beyond full scale, are taken for silence and counted.
    """

    def __init__(self, sample_rate_hz: int) -> None:
        """Begin.

        Args:
            sample_rate_hz: Of the blocks [Hz].
        """
        self.sample_rate_hz = sample_rate_hz
        self.num_bad_samples = 0
        self._stream: soxr.ResampleStream | None = None
        self._taken = self._given = 0  # of this run
        self._zero_utime = 0.0  # when sample 0 of the run sounded, by the newest block's stamp
        self._is_new_run = True
        self._started = False

    def push(self, block: Block) -> list[Block]:
        """Return what the block completes; after a gap, the end of the old run comes first."""
        samples = self._finite(block.samples)
        if self.sample_rate_hz == RATE_HZ:
            return [Block(samples, block.utime, block.follows)] if len(samples) else []
        if len(samples) == 0:
            return []
        out: list[Block] = []
        if not self._continues(block):
            out = self.flush()
        if self._stream is None:
            self._stream = soxr.ResampleStream(self.sample_rate_hz, RATE_HZ, 1, dtype="float32")
        self._zero_utime = block.utime - self._taken * 1e6 / self.sample_rate_hz
        self._taken += len(samples)
        return out + self._blocks(self._stream.resample_chunk(samples))

    def flush(self) -> list[Block]:
        """Return what the filter still holds; the next block begins a new run."""
        if self._stream is None:
            return []
        # The last samples lean on silence; they are few, and a gap follows.
        out = self._blocks(self._stream.resample_chunk(np.zeros(0, np.float32), last=True))
        self._stream = None
        self._taken = self._given = 0
        self._is_new_run = True
        return out

    def _continues(self, block: Block) -> bool:
        if self._stream is None or block.follows is not None:
            return block.follows is not False
        expected = self._zero_utime + self._taken * 1e6 / self.sample_rate_hz
        return abs(block.utime - expected) <= max(0.5e6 / self.sample_rate_hz, ROUNDING_US)

    def _blocks(self, sound: F32) -> list[Block]:
        if len(sound) == 0:
            return []
        utime = round(self._zero_utime + self._given * 1e6 / RATE_HZ)
        follows = not self._is_new_run
        if not self._started:  # nothing was before it
            follows, self._started = True, True
        self._given += len(sound)
        self._is_new_run = False
        return [Block(sound, utime, follows)]

    def _finite(self, samples: F32) -> F32:
        is_good = np.abs(samples) <= LOUDEST  # NaN is not
        if is_good.all():
            return samples
        self.num_bad_samples += int(np.count_nonzero(~is_good))
        return np.where(is_good, samples, np.float32(0.0))
