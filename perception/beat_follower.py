"""The beat of music nobody knows, while it plays: tempo, phase and how sure they are.

Two layers. The coarse one asks every quarter of a second which tempo and phase the last seconds
speak for (rhythm.py), remembers the answers for a while, and holds on to one beat until another
is clearly better: that guards against half-beat and octave flips. The fine one lays a straight line
through the onsets around that beat and is what others dance to: a clock, extrapolated to any time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
from scipy.special import logsumexp

from downbeat.perception.beat_line import BeatLine, LineFitter
from downbeat.perception.beat_surety import Surety, Witness, bundled_surety
from downbeat.perception.features import F32
from downbeat.perception.onset_stream import F64, SAMPLE_RATE_HZ, STEP_S, OnsetStream
from downbeat.perception.rhythm import (
    MAX_BPM,
    MIN_BPM,
    NUM_PHASES,
    NUM_TEMPOS,
    PERIODS_S,
    PHASES,
    BeatTemplate,
    Equaliser,
    RhythmBank,
    bundled_template,
)
from downbeat.perception.timeline import tempo_octave

GAP_US = 50_000
"""Stamps that jump by more begin a new piece of sound; smaller ones are a clock that drifts."""
LOOK_STEPS = 5
"""A look every 0.25 s."""
LOOK_S = LOOK_STEPS * STEP_S
FIRST_LOOK_S = 2.0
"""Three beats at the slowest tempo are the least that can be called a beat."""
MEMORY_S = 6.0
"""Looks count for the choice of the beat for so long, besides the bank's own memory."""
OFFBEAT_MEMORY_S = 24.0
"""For the choice between a beat and its offbeat they count for so long: music changes its tempo
when another piece begins, but it hardly ever moves by half a beat, though a fill or a bare hi-hat
speaks for that for many seconds."""
CLEAR_ON, CLEAR_OFF = 0.35, 0.15
"""Over that time a steady beat must stand so much above its offbeat, to become one and to stay one:
of those that do not, more than every third was wrong."""
EDGE = 1.03
"""80.0 BPM does not become 160 because it was measured as 79.9."""
SLACK = 1.005
"""A line this far outside the tempos that are known belongs to another octave."""
SAME_TEMPO, SAME_PHASE = 0.02, 0.09
"""Beats this close in log period and in beats are one."""
CHALLENGE, CHALLENGE_LOOKS = 0.3, 4
"""Another beat takes over when it leads by this score for so many looks."""
STEADY_ON, STEADY_OFF = 0.5, 0.3
STEADY_LOOKS = 2
"""Steady, and no longer steady, after so many looks on end. The lowest odds at which synthetic
voices, rooms and noise are called steady less than 0.7 % of the time."""
MIN_ACTIVITY = 0.06
"""Mean onset strength below this is no music but a quiet room; music has 0.1 to 0.3."""
MIN_CONFIDENCE = 0.15


@dataclass(frozen=True, slots=True)
class Beat:
    """A beat clock.

    Attributes:
        beat_utime: When a beat sounds or sounded [us]; the beat nearest to the time asked for.
        period_s: From beat to beat [s].
        phase_std_s: Uncertainty of beat_utime [s].
        confidence: 0..1, that this and no other beat is the beat.
        is_steady: The same beat was clear for some looks on end: fit to dance to.
    """

    beat_utime: int
    period_s: float
    phase_std_s: float
    confidence: float
    is_steady: bool


class BeatFollower:
    """Hears sound, knows the beat; causal, and the same for any size of blocks."""

    def __init__(
        self,
        tempo_range_bpm: tuple[float, float] = (80.0, 160.0),
        template: BeatTemplate | None = None,
        surety: Surety | None = None,
    ) -> None:
        """Begin in silence.

        Args:
            tempo_range_bpm: Tempos are halved or doubled towards it, as a skill needs them.
            template: What a beat looks like; omitted: the one in the wheel.
            surety: How sure evidence makes; omitted: the one in the wheel.
        """
        self._range_bpm = tempo_range_bpm
        self._template = template or bundled_template()
        self._surety = surety or bundled_surety()
        self._stream = OnsetStream()
        self.reset()

    def reset(self) -> None:
        """Forget everything: after a gap, or when another piece of music begins."""
        self._stream.reset()
        self._equaliser = Equaliser()
        self._bank = RhythmBank()
        self._fitter = LineFitter()
        self._scores = np.zeros((NUM_TEMPOS, NUM_PHASES))
        self._scores_weight = 0.0
        self._long = np.zeros_like(self._scores)
        self._long_weight = 0.0
        self._line: BeatLine | None = None
        self._octave = 1.0
        self._witness = Witness(LOOK_S)
        self.evidence: F64 | None = None
        self._confidence = 0.0
        self._lead = self._sure = self._unsure = 0
        self._steady = self._clear = False
        self._heard = 0
        self._steps = 0
        self._zero_utime: int | None = None

    def hear(self, samples: F32, first_utime: int) -> None:
        """Hear on.

        Args:
            samples: (n,) mono, 16 kHz, full scale 1; n may be anything.
            first_utime: When samples[0] sounded [us].
        """
        if len(samples) == 0:
            return
        if self._zero_utime is not None:
            expected = self._zero_utime + self._heard * 1_000_000 // SAMPLE_RATE_HZ
            late = first_utime - expected
            if abs(late) > GAP_US:
                self.reset()
            elif abs(late) > 1_000:
                self._zero_utime += late
        if self._zero_utime is None:
            self._zero_utime = first_utime
        self._heard += len(samples)
        for onsets in self._stream.push(samples):
            self.step(onsets)

    def beat(self, utime: int) -> Beat | None:
        """Return the clock, with the beat nearest to a time [us]; None while searching."""
        if self._line is None or self._zero_utime is None or self._confidence < MIN_CONFIDENCE:
            return None
        line = self._line
        period_s = line.period_s / self._octave
        time_s = (utime - self._zero_utime) * 1e-6
        first_s = line.beat_s - (line.number % 2) * line.period_s
        beat_s = first_s + round((time_s - first_s) / period_s) * period_s
        return Beat(
            self._zero_utime + round(beat_s * 1e6),
            period_s,
            line.std_s,
            self._confidence,
            self._steady,
        )

    @property
    def line(self) -> BeatLine | None:
        """The line through the beats, in seconds of the sound; None while there is none."""
        return self._line

    def step(self, onsets: F64) -> None:
        """Take one step of onsets, (STEP_FRAMES, NUM_GROUPS)."""
        strength = self._equaliser.push(onsets)
        self._bank.push(strength)
        self._fitter.push(strength)
        self._steps += 1
        if self._steps % LOOK_STEPS == 0:
            self._look(self._steps * STEP_S)

    def _look(self, now_s: float) -> None:
        score = self._bank.fill * self._template.score(self._bank.coefficients())
        score -= logsumexp(score)
        keep = math.exp(-LOOK_S / MEMORY_S)
        self._scores = keep * _turn(self._scores, LOOK_S) + (1.0 - keep) * score
        self._scores_weight = keep * self._scores_weight + 1.0 - keep
        keep = math.exp(-LOOK_S / OFFBEAT_MEMORY_S)
        self._long = keep * _turn(self._long, LOOK_S) + (1.0 - keep) * score
        self._long_weight = keep * self._long_weight + 1.0 - keep
        if self._equaliser.activity < MIN_ACTIVITY:
            self._line, self._confidence, self._steady = None, 0.0, False
            return
        if now_s < FIRST_LOOK_S:
            return
        scores = self._scores / self._scores_weight
        self._choose(scores, now_s)
        self._judge(scores, score, now_s)
        assert self._line is not None
        self._line = self._fitter.follow(self._line, now_s)
        self._set_octave(60.0 / self._line.period_s)

    def _set_octave(self, bpm: float) -> None:
        """Halve or double towards the range; at its edge, stay with what was."""
        low, high = self._range_bpm
        if not low / EDGE <= bpm * self._octave <= high * EDGE:
            self._octave = tempo_octave(bpm, self._range_bpm)

    def _choose(self, scores: F64, now_s: float) -> None:
        """Keep the beat, or take another."""
        best = np.unravel_index(int(scores.argmax()), scores.shape)
        other = BeatLine(now_s + PHASES[best[1]] * PERIODS_S[best[0]], float(PERIODS_S[best[0]]))
        if self._line is None:
            self._line, self._lead = self._fitter.begin(other, now_s), 0
            return
        mine = _same_beat(self._line, now_s)
        leads = bool(scores.max() > scores[mine].max(initial=-np.inf) + CHALLENGE)
        if leads and _same_beat(_offbeat(self._line), now_s)[best]:
            leads = self._lead_over_offbeat(mine, now_s) < 0.0
        self._lead = self._lead + 1 if leads else 0
        bpm = 60.0 / self._line.period_s
        lost = not MIN_BPM / SLACK <= bpm <= MAX_BPM * SLACK
        if lost or self._lead >= (CHALLENGE_LOOKS if self._steady else 1):
            self._line, self._lead = self._fitter.begin(other, now_s), 0
            self._steady, self._sure = False, 0

    def _judge(self, scores: F64, newest: F64, now_s: float) -> None:
        """Set the confidence, and whether the beat is steady."""
        assert self._line is not None
        mine = _same_beat(self._line, now_s)
        self.evidence = self._witness.look(scores, newest, mine, self._line, self._bank.fill)
        self._confidence = self._surety.chance(self.evidence)
        self._sure = self._sure + 1 if self._confidence >= STEADY_ON else 0
        self._unsure = self._unsure + 1 if self._confidence < STEADY_OFF else 0
        if self._sure >= STEADY_LOOKS:
            self._steady = True
        elif self._unsure >= STEADY_LOOKS:
            self._steady = False
        lead = self._lead_over_offbeat(mine, now_s)
        self._clear = lead >= (CLEAR_OFF if self._clear else CLEAR_ON)
        self._steady = self._steady and self._clear

    def _lead_over_offbeat(self, mine: np.ndarray, now_s: float) -> float:
        """Return how far the beat stands above its offbeat over OFFBEAT_MEMORY_S."""
        assert self._line is not None
        scores = self._long / self._long_weight
        other = scores[_same_beat(_offbeat(self._line), now_s)]
        least = float(scores.min())
        return float(scores[mine].max(initial=least) - other.max(initial=least))


def _offbeat(line: BeatLine) -> BeatLine:
    return replace(line, beat_s=line.beat_s + 0.5 * line.period_s)


def _turn(scores: F64, seconds: float) -> F64:
    """Return scores whose phases count from `seconds` later, exactly for smooth scores."""
    waves = scipy.fft.rfft(scores, axis=1)
    turns = np.outer(seconds / PERIODS_S, np.arange(waves.shape[1]))
    return np.asarray(scipy.fft.irfft(waves * np.exp(2j * np.pi * turns), NUM_PHASES, axis=1))


def _same_beat(line: BeatLine, now_s: float) -> np.ndarray:
    """Return which tempos and phases mean this beat, or every other of its beats."""
    period = PERIODS_S[:, None]
    octaves = np.log2(period / line.period_s)
    whole = np.maximum(np.round(octaves), 0.0)
    near = np.abs(octaves - whole) * math.log(2.0) <= SAME_TEMPO
    mine = line.period_s
    off = (now_s + PHASES * period - line.beat_s + 0.5 * mine) % mine - 0.5 * mine
    return np.asarray(near & (np.abs(off) <= SAME_PHASE * mine))
