"""Speech segments: opened and closed by voice activity, gated before anything listens to them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32
from downbeat.perception.vad import FRAME_SAMPLES, FRAME_US, SAMPLE_RATE_HZ, Vad, VadStream

_GAP_US = 2 * FRAME_US
"""Sound that begins this much off the expected time does not continue what was heard."""


@dataclass(frozen=True, slots=True)
class SegmentConfig:
    """When a segment opens, closes and is forwarded.

    Attributes:
        open_probability: p(voice) of a frame at which speech is taken to begin.
        close_probability: Below this a frame is a pause; lower than to open (hysteresis).
        min_voiced_s: Voiced time below which a segment is a click and is dropped [s].
        hang_over_s: Pause that ends a segment [s]; it is most of the robot's time to react.
        early_s: Pause after which a segment is handed out before it is known to have ended, so that
            a recogniser can begin [s]; 0: never. What is said afterwards makes it worthless.
        sure_s: Pause that ends a segment in which somebody is sure to have heard all there was [s].
        pre_roll_s: Sound kept from before the opening [s]: first consonants are not voiced.
        max_s: A monologue is cut here [s].
        min_voiced_fraction: A segment needs this share of voiced frames to be forwarded.
        epsilon: It needs p_speech - p_music of at least this in one window of the router, if there
            is one. Far below zero, because who speaks over music shall be heard: the windows are
            longer than a command, and in them such a voice reaches -0.4 to -0.6, music alone -0.97.
    """

    open_probability: float = 0.5
    close_probability: float = 0.35
    min_voiced_s: float = 0.12
    hang_over_s: float = 0.22
    early_s: float = 0.0
    sure_s: float = 0.16
    pre_roll_s: float = 0.25
    max_s: float = 15.0
    min_voiced_fraction: float = 0.3
    epsilon: float = -0.8

    def __post_init__(self) -> None:
        """Refuse what cannot work.

        Raises:
            PerceptionError: A value is out of its range.
        """
        if not 0.0 < self.close_probability <= self.open_probability < 1.0:
            raise PerceptionError(
                f"open_probability {self.open_probability} and close_probability "
                f"{self.close_probability} are no thresholds; valid is 0 < close <= open < 1."
            )
        if not 0.0 <= self.early_s < self.hang_over_s:
            raise PerceptionError(
                f"early_s {self.early_s} is no pause within a segment; valid is 0 to below "
                f"hang_over_s {self.hang_over_s}."
            )
        if not 0.0 < self.hang_over_s < self.max_s or min(self.min_voiced_s, self.pre_roll_s) < 0:
            raise PerceptionError(
                f"hang_over_s {self.hang_over_s} and max_s {self.max_s} cannot end a segment; "
                "valid is 0 < hang_over_s < max_s, and no negative time."
            )


@dataclass(frozen=True, slots=True)
class Segment:
    """One utterance.

    Attributes:
        start_utime: First sample [us].
        end_utime: After the last sample [us]; the hang-over is not part of it.
        samples: (n,) mono, 16 kHz.
        voiced_fraction: Share of voiced frames in it.
        closed_utime: When it was known to have ended [us].
        cut: It was cut at its greatest length, and the speech went on.
        early: It may go on: the hang-over is not over yet.
        serial: Number of the pause that it ends with; an early one and the final one share it.
    """

    start_utime: int
    end_utime: int
    samples: F32
    voiced_fraction: float
    closed_utime: int = 0
    cut: bool = False
    early: bool = False
    serial: int = 0

    @property
    def duration_s(self) -> float:
        """Length [s]."""
        return len(self.samples) / SAMPLE_RATE_HZ


def refusal(
    segment: Segment, config: SegmentConfig, p_speech: float = math.nan, p_music: float = math.nan
) -> str:
    """Return why a segment is not forwarded to a recogniser; "" where it is.

    Args:
        segment: What was heard.
        config: The thresholds.
        p_speech: The router's score of speech over the segment; NaN: it has none.
        p_music: Its score of music.
    """
    if segment.voiced_fraction < config.min_voiced_fraction:
        return f"voiced {segment.voiced_fraction:.2f} < {config.min_voiced_fraction:.2f}"
    if math.isfinite(p_speech) and math.isfinite(p_music) and p_speech - p_music < config.epsilon:
        return f"speech - music {p_speech - p_music:.2f} < {config.epsilon:.2f}"
    return ""


class Segmenter:
    """Sound in pieces of any length, segments out as soon as they have ended."""

    def __init__(
        self,
        vad: Vad,
        config: SegmentConfig | None = None,
        on_open: Callable[[int], None] | None = None,
    ) -> None:
        """Begin in silence.

        Args:
            vad: The model.
            config: Thresholds and times.
            on_open: Told the time [us] at which speech began, when it is sure that it did (for
                barge-in: the robot falls silent before the sentence has ended).
        """
        self.config = config or SegmentConfig()
        self._stream = VadStream(vad)
        self._on_open = on_open or (lambda _utime: None)
        self._next_utime: int | None = None
        self._serial = 0
        self._clear()

    @property
    def is_open(self) -> bool:
        """True while somebody speaks."""
        return self._start is not None

    def push(self, samples: F32, utime: int) -> list[Segment]:
        """Hear on.

        Args:
            samples: (n,) mono, 16 kHz, full scale 1.
            utime: When samples[0] sounded [us]; after a gap the open segment ends.

        Returns:
            The segments that ended within these samples.
        """
        found: list[Segment] = []
        if self._next_utime is not None and abs(utime - self._next_utime) > _GAP_US:
            found += self.flush()
            self._next_utime = None
        if self._next_utime is None:
            self._frame_utime = utime
        self._next_utime = utime + round(len(samples) / SAMPLE_RATE_HZ * 1e6)
        self._rest = np.concatenate((self._rest, np.asarray(samples, np.float32)))
        for probability in self._stream.push(samples):
            frame, self._rest = self._rest[:FRAME_SAMPLES], self._rest[FRAME_SAMPLES:]
            found += self._hear(frame, float(probability))
            self._frame_utime += FRAME_US
        return found

    def end(self, serial: int) -> bool:
        """End the open segment now: somebody is sure about its early form.

        Args:
            serial: Of the early segment.

        Returns:
            False where the pause is over, or too short yet.
        """
        paused_us = self._pause * FRAME_US
        if not self.is_open or serial != self._serial or paused_us < self.config.sure_s * 1e6:
            return False
        rest = self._rest
        self._clear()
        self._rest = rest
        return True

    def flush(self) -> list[Segment]:
        """End the open segment, if any, and forget everything: the sound has ended."""
        found = self._close(cut=False) if self.is_open else []
        self._stream.reset()
        self._next_utime = None
        self._clear()
        return found

    def _clear(self) -> None:
        self._serial += 1
        self._rest = np.zeros(0, np.float32)
        self._frames: list[F32] = []
        self._voiced: list[bool] = []
        self._start: int | None = None
        self._pause = 0
        self._announced = False

    def _hear(self, frame: F32, probability: float) -> list[Segment]:
        config = self.config
        self._frames.append(frame)
        self._voiced.append(probability >= config.open_probability)
        if self._start is None:
            if not self._voiced[-1]:
                keep = math.ceil(config.pre_roll_s * 1e6 / FRAME_US)
                self._frames = self._frames[len(self._frames) - keep :] if keep else []
                self._voiced = self._voiced[len(self._voiced) - keep :] if keep else []
                return []
            self._start = self._frame_utime - (len(self._frames) - 1) * FRAME_US
        self._pause = self._pause + 1 if probability < config.close_probability else 0
        if not self._announced and self._voiced_s() >= config.min_voiced_s:
            self._announced = True
            self._on_open(self._start)
        if self._pause * FRAME_US >= config.hang_over_s * 1e6:
            return self._close(cut=False)
        if config.early_s and self._pause == math.ceil(config.early_s * 1e6 / FRAME_US):
            self._serial += 1
            return [self._segment(len(self._frames), early=True)] if self._announced else []
        if len(self._frames) * FRAME_US >= config.max_s * 1e6:
            return self._close(cut=True)
        return []

    def _voiced_s(self) -> float:
        return sum(self._voiced) * FRAME_US / 1e6

    def _close(self, cut: bool) -> list[Segment]:
        # Half of the pause stays: a recogniser needs some silence after the last word.
        segment = self._segment(len(self._frames) - self._pause // 2, cut=cut)
        enough = self._voiced_s() >= self.config.min_voiced_s
        rest = self._rest
        self._clear()
        self._rest = rest
        return [segment] if enough else []

    def _segment(self, length: int, cut: bool = False, early: bool = False) -> Segment:
        """Return the first `length` frames as a segment."""
        assert self._start is not None
        return Segment(
            start_utime=self._start,
            end_utime=self._start + length * FRAME_US,
            samples=np.concatenate(self._frames[:length]),
            voiced_fraction=float(np.mean(self._voiced[:length])),
            closed_utime=self._start + len(self._frames) * FRAME_US,
            cut=cut,
            early=early,
            serial=self._serial,
        )
