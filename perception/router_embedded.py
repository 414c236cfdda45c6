"""The default router: voice activity, a hundred numbers of a window, and a tiny network of ours.

Nothing is downloaded; the weights are checked in. `python -m downbeat.tools.train_router` makes
them, docs/router.md says from what and how well they do.
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32
from downbeat.perception.router import RouterConfig, Verdict, verdict
from downbeat.perception.router_features import MIN_FRAMES, NUM_FEATURES, window_features
from downbeat.perception.router_frames import (
    FRAME_RATE_HZ,
    NO_FRAMES,
    SAMPLE_RATE_HZ,
    WINDOW,
    Frames,
    FrameStream,
)
from downbeat.perception.vad import FRAME_SAMPLES, Vad, VadStream, voiced_fraction

WEIGHTS = Path(__file__).parent / "data" / "router.npz"
CLIP = 4.0
"""Standard deviations: what lies further out than this was hardly in the training set."""
LEVEL_S = 1.0
GAP_US = 2 * FRAME_SAMPLES * 1_000_000 // SAMPLE_RATE_HZ
"""Sound that begins this much off the expected time does not continue what was heard."""
PENDING_SAMPLES = SAMPLE_RATE_HZ
"""Blocks wait to be analysed together, but no more than a second of them."""


@dataclass(frozen=True)
class RouterNet:
    """Several small networks of one hidden layer; their log odds are averaged.

    Attributes:
        mean: (NUM_FEATURES,) of the training set.
        spread: (NUM_FEATURES,) standard deviation.
        hidden: (m, NUM_FEATURES, h).
        hidden_bias: (m, h).
        out: (m, h, 2).
        out_bias: (m, 2): music, speech.
    """

    mean: F32
    spread: F32
    hidden: F32
    hidden_bias: F32
    out: F32
    out_bias: F32

    def scores(self, values: F32) -> F32:
        """Return (p_music, p_speech) of windows, (n, 2).

        Args:
            values: (n, NUM_FEATURES); NaN: not known.
        """
        scaled = np.clip((values - self.mean) / self.spread, -CLIP, CLIP)
        scaled = np.where(np.isfinite(scaled), scaled, 0.0).astype(np.float32)
        hidden = np.maximum(np.matmul(scaled, self.hidden) + self.hidden_bias[:, None], 0.0)
        logits = (np.matmul(hidden, self.out) + self.out_bias[:, None]).mean(axis=0)  # (n, 2)
        return np.asarray(1.0 / (1.0 + np.exp(-logits)))

    def save(self, path: Path) -> None:
        """Write the weights."""
        np.savez_compressed(path, **vars(self))

    @staticmethod
    def load(path: Path = WEIGHTS) -> RouterNet:
        """Read weights.

        Raises:
            PerceptionError: The file is missing, is no weights file, or of other features.
        """
        try:
            with np.load(path) as data:
                net = RouterNet(**{name: data[name] for name in data.files})
        except (OSError, ValueError, TypeError, zipfile.BadZipFile) as error:
            raise PerceptionError(
                f"{path} holds no weights of the router ({error}); "
                "`python -m downbeat.tools.train_router` writes them."
            ) from error
        if net.mean.shape != (NUM_FEATURES,):
            raise PerceptionError(
                f"{path} holds weights for {net.mean.size} features, this version has "
                f"{NUM_FEATURES}; `python -m downbeat.tools.train_router` writes new ones."
            )
        return net


class EmbeddedRouter:
    """Router "embedded"."""

    name = "embedded"

    def __init__(
        self,
        config: RouterConfig | None = None,
        vad: Vad | None = None,
        net: RouterNet | None = None,
    ) -> None:
        """Load.

        Args:
            config: Thresholds.
            vad: Voice activity; None: there is none, the network alone decides and v_frac is NaN.
            net: Weights; None: those checked in.

        Raises:
            PerceptionError: There are no weights.
        """
        self.config = config or RouterConfig()
        self._net = net or RouterNet.load()
        self._frames_kept = round(self.config.window_s * FRAME_RATE_HZ)
        self._voice_kept = round(self.config.window_s * SAMPLE_RATE_HZ / FRAME_SAMPLES)
        self._stream = FrameStream()
        self._vad = None if vad is None else VadStream(vad)
        self.reset()

    def reset(self) -> None:
        """Forget everything heard."""
        self._stream.reset()
        if self._vad is not None:
            self._vad.reset()
        self._next_utime: int | None = None
        self._clear()

    def _clear(self) -> None:
        self._pending: list[F32] = []
        self._num_pending = 0
        self._frames: Frames = NO_FRAMES
        self._voice = np.zeros(0, np.float32)

    def hear(self, samples: F32, first_utime: int) -> None:
        """Take in a block; after a gap everything before it is forgotten."""
        if self._next_utime is not None and abs(first_utime - self._next_utime) > GAP_US:
            self.reset()
        self._next_utime = first_utime + round(len(samples) / SAMPLE_RATE_HZ * 1e6)
        # One NaN would stay in the detector's state for ever.
        clean = np.nan_to_num(np.asarray(samples, np.float32), posinf=0.0, neginf=0.0)
        self._pending.append(clean)
        self._num_pending += len(samples)
        if self._num_pending >= PENDING_SAMPLES:
            self._analyse()

    def judge(self, evidence: float) -> Verdict:
        """Judge the newest window of at most `window_s`; SKIP until a second was heard."""
        self._analyse()
        level = _level_dbfs(self._frames.last(round(LEVEL_S * FRAME_RATE_HZ)))
        v_frac = voiced_fraction(self._voice) if len(self._voice) else float("nan")
        p_music = p_speech = float("nan")
        if len(self._frames) >= MIN_FRAMES:
            values = window_features(self._frames, self._voice)
            p_music, p_speech = (float(p) for p in self._net.scores(values[None])[0])
        return verdict(p_music, p_speech, v_frac, level, self.config, evidence, self.name)

    def _analyse(self) -> None:
        if not self._pending:
            return
        heard = np.concatenate(self._pending)
        self._pending, self._num_pending = [], 0
        frames = self._stream.push(heard)
        self._frames = self._frames.followed_by(frames).last(self._frames_kept)
        if self._vad is not None:
            voice = np.concatenate((self._voice, self._vad.push(heard)))
            self._voice = voice[-self._voice_kept :]


def _level_dbfs(frames: Frames) -> float:
    """Return the level of frames [dB], full scale 0, at least -120."""
    if len(frames) == 0:
        return -120.0
    # Parseval: a Hann window of 1024 lets 3/8 of the power through, half of it in rfft's bins.
    power = float(frames.level.mean()) * 2.0 / (WINDOW * WINDOW * 3.0 / 8.0)
    return max(10.0 * float(np.log10(power + 1e-12)), -120.0)
