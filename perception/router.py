"""Music, speech or neither: the rule that decides, apart from the models that give it its numbers.

The paper's rule calls a window SPEECH if it is voiced and speech leads, MUSIC if music leads and it
is *not* voiced, SKIP otherwise. So it skips what is both: songs with vocals are voiced, and so is
somebody who talks over music of the same level, where neither leads by much. Here the voice has no
veto over music: a voiced window is speech if speech leads clearly, and else music if there is
enough of it. And where a locked track still fits, there is music, whatever else sounds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from downbeat.lcm_types import audio_class_t
from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32

SAMPLE_RATE_HZ = 16_000
SKIP, MUSIC, SPEECH = int(audio_class_t.SKIP), int(audio_class_t.MUSIC), int(audio_class_t.SPEECH)
LABEL_NAMES = {SKIP: "SKIP", MUSIC: "MUSIC", SPEECH: "SPEECH"}


@dataclass(frozen=True, slots=True)
class RouterConfig:
    """Thresholds of the rule.

    Attributes:
        v_frac_min: Share of voiced frames from which a window is voiced; a short command fills a
            tenth of five seconds.
        epsilon_sp: Speech leads if p_speech - p_music is at least this.
        p_speech_min: Speech that is less sure is none, even if it leads.
        p_speech_sure: Speech that is this sure, and leads by half, needs no voice: of somebody far
            away in a room the detector hears few frames.
        p_music_min: Music that is less sure is none.
        evidence_min: A locked track that is this similar to what sounds is still there: the right
            place correlates by 0.3 to 0.95, a wrong one by about 0.1.
        silence_dbfs: Below this level the newest second is SKIP [dB, full scale 0].
        window_s: What is judged at once [s].
    """

    v_frac_min: float = 0.1
    epsilon_sp: float = 0.1
    p_speech_min: float = 0.4
    p_speech_sure: float = 0.9
    p_music_min: float = 0.5
    evidence_min: float = 0.24
    silence_dbfs: float = -60.0
    window_s: float = 5.0

    def __post_init__(self) -> None:
        """Refuse what cannot work.

        Raises:
            PerceptionError: A value is out of its range.
        """
        for name in ("v_frac_min", "p_speech_min", "p_speech_sure", "p_music_min", "evidence_min"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise PerceptionError(
                    f"Router: {name} is {getattr(self, name)}; valid is above 0, at most 1."
                )
        if not -1.0 <= self.epsilon_sp <= 1.0:
            raise PerceptionError(f"Router: epsilon_sp is {self.epsilon_sp}; valid is -1 to 1.")
        if not 1.0 <= self.window_s <= 10.0:
            raise PerceptionError(f"Router: window_s is {self.window_s}; valid is 1 to 10 seconds.")
        if not -120.0 <= self.silence_dbfs < 0.0:
            raise PerceptionError(
                f"Router: silence_dbfs is {self.silence_dbfs}; valid is -120 to below 0."
            )


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a window is.

    Attributes:
        label: audio_class_t.SKIP, MUSIC or SPEECH.
        p_music: 0..1 how much of it is music, singing included; NaN: not known.
        p_speech: 0..1 how much of it is somebody talking; NaN: not known.
        v_frac: 0..1 share of voiced frames; NaN: there is no voice activity detector.
        model: What gave the numbers.
    """

    label: int
    p_music: float
    p_speech: float
    v_frac: float
    model: str


class Router(Protocol):
    """Hears on and judges the newest window when asked."""

    name: str

    def hear(self, samples: F32, first_utime: int) -> None:
        """Take in a block.

        Args:
            samples: (n,) mono, 16 kHz, full scale 1, directly after those before.
            first_utime: When samples[0] sounded [us].
        """
        ...

    def reset(self) -> None:
        """Forget everything heard: what follows is not a continuation."""
        ...

    def judge(self, evidence: float) -> Verdict:
        """Judge the newest window.

        Args:
            evidence: Similarity with which a locked track still fits; 0: there is no lock.
        """
        ...


def route(
    p_music: float, p_speech: float, v_frac: float, config: RouterConfig, evidence: float = 0.0
) -> int:
    """Return exactly one label.

    Args:
        p_music: 0..1; NaN: not known, then it is not MUSIC.
        p_speech: 0..1; NaN: not known, then it is not SPEECH.
        v_frac: 0..1; NaN: there is no voice activity detector, and it takes no part.
        config: Thresholds.
        evidence: Similarity with which a locked track still fits; 0: there is no lock.
    """
    if evidence >= config.evidence_min:
        return MUSIC
    margin = p_speech - p_music
    leads = margin >= config.epsilon_sp and p_speech >= config.p_speech_min
    is_sure = margin >= 0.5 and p_speech >= config.p_speech_sure
    if leads and (is_sure or not v_frac < config.v_frac_min):
        return SPEECH
    return MUSIC if p_music >= config.p_music_min and math.isfinite(p_speech) else SKIP


def paper_route(
    p_music: float, p_speech: float, v_frac: float, config: RouterConfig, evidence: float = 0.0
) -> int:
    """Return the label by the paper's rule; it knows no evidence. For comparison."""
    is_voiced = v_frac >= config.v_frac_min
    if is_voiced and p_speech - p_music >= config.epsilon_sp:
        return SPEECH
    if p_music > p_speech and p_music >= config.p_music_min and not is_voiced:
        return MUSIC
    return SKIP


def verdict(
    p_music: float,
    p_speech: float,
    v_frac: float,
    level_dbfs: float,
    config: RouterConfig,
    evidence: float,
    model: str,
) -> Verdict:
    """Return a verdict: silence first, then the rule."""
    label = SKIP
    if level_dbfs >= config.silence_dbfs:
        label = route(p_music, p_speech, v_frac, config, evidence)
    return Verdict(label, p_music, p_speech, v_frac, model)
