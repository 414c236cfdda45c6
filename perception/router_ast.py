"""Router "ast": an Audio Spectrogram Transformer, exported once, run by ONNX Runtime.

`downbeat models export ast` writes the file; everything a window needs on its way in (mel bands,
normalisation, length) and out (which labels are music, which are speech) stands in its metadata.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
import onnxruntime
import scipy.fft

from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32
from downbeat.perception.router import SAMPLE_RATE_HZ, RouterConfig, Verdict, verdict
from downbeat.perception.vad import FRAME_SAMPLES, Vad, VadStream, voiced_fraction

METADATA_KEY = "downbeat_ast"
GROUPS = Path(__file__).parent / "data" / "audioset_groups.json"
FRAME, HOP, FFT = 400, 160, 512
"""25 ms, 10 ms."""
MEL_LOW_HZ = 20.0
PRE_EMPHASIS = 0.97
POWER_FLOOR = 1.192092955078125e-07
LEVEL_S = 1.0
Pooling = Literal["max", "sum"]


@dataclass(frozen=True)
class AstFront:
    """What stands in the file beside the network.

    Attributes:
        num_mels: Mel bands.
        frames: Length of the network's input, 10 ms each.
        mean: Of log mel values over its training set.
        spread: Twice their standard deviation, by which they are divided.
        music: Indices of the labels that count as music.
        speech: Indices of the labels that count as speech.
        source: What was exported.
    """

    num_mels: int
    frames: int
    mean: float
    spread: float
    music: tuple[int, ...]
    speech: tuple[int, ...]
    source: str

    def as_json(self) -> str:
        """Return the metadata."""
        return json.dumps(asdict(self))

    @staticmethod
    def from_json(written: str) -> AstFront:
        """Read the metadata back."""
        table = json.loads(written)
        groups = {name: tuple(table[name]) for name in ("music", "speech")}
        return AstFront(**{**table, **groups})

    @property
    def seconds(self) -> float:
        """How much sound fills the input [s]."""
        return (FRAME + (self.frames - 1) * HOP) / SAMPLE_RATE_HZ

    def prepare(self, samples: F32) -> F32:
        """Return the network's input, (1, frames, num_mels).

        Args:
            samples: (n,) mono, 16 kHz, full scale 1; the newest part fills the input, and what is
                missing stays empty.
        """
        kept = samples[-(FRAME + (self.frames - 1) * HOP) :]
        logs = log_mels(kept, self.num_mels)
        padded = np.zeros((self.frames, self.num_mels), np.float32)
        padded[: len(logs)] = logs
        return ((padded - self.mean) / self.spread)[None].astype(np.float32)


def log_mels(samples: F32, num_mels: int) -> F32:
    """Return log mel power as the transformer was trained with it, (frames, num_mels).

    Args:
        samples: (n,) mono, 16 kHz, full scale 1; there is a frame for every 25 ms that are whole.
        num_mels: Bands.
    """
    if len(samples) < FRAME:
        return np.zeros((0, num_mels), np.float32)
    frames = np.lib.stride_tricks.sliding_window_view(samples, FRAME)[::HOP].astype(np.float64)
    frames = frames - frames.mean(axis=1, keepdims=True)
    before = np.concatenate((frames[:, :1], frames[:, :-1]), axis=1)
    spectrum = scipy.fft.rfft((frames - PRE_EMPHASIS * before) * np.hanning(FRAME), FFT, axis=1)
    power = spectrum.real**2 + spectrum.imag**2  # (frames, 257)
    return np.log(np.maximum(power @ mel_weights(num_mels), POWER_FLOOR)).astype(np.float32)


@lru_cache(maxsize=2)
def mel_weights(num_mels: int) -> F32:
    """Return bands that are triangles on the mel axis, (257, num_mels)."""

    def mel(hertz: F32) -> F32:
        return 1127.0 * np.log(1.0 + hertz / 700.0)

    edges = np.linspace(*mel(np.array([MEL_LOW_HZ, SAMPLE_RATE_HZ / 2])), num_mels + 2)
    place = mel(np.arange(FFT // 2 + 1) * SAMPLE_RATE_HZ / FFT)[:, None]
    rising = (place - edges[:-2]) / (edges[1:-1] - edges[:-2])
    falling = (edges[2:] - place) / (edges[2:] - edges[1:-1])
    return np.maximum(0.0, np.minimum(rising, falling))


@lru_cache(maxsize=1)
def audioset_groups() -> tuple[tuple[int, ...], tuple[int, ...], dict[int, str]]:
    """Return AudioSet's labels that are music, those that are speech, and some names to check."""
    table = json.loads(GROUPS.read_text(encoding="utf-8"))
    music, speech = (
        tuple(index for first, last in table[name] for index in range(first, last + 1))
        for name in ("music", "speech")
    )
    return music, speech, {int(index): name for index, name in table["names"].items()}


class AstModel:
    """The network: sound in, (p_music, p_speech) out."""

    def __init__(self, path: Path, pooling: Pooling = "max") -> None:
        """Load.

        Args:
            path: What `downbeat models export ast` wrote.
            pooling: A group of labels is as sure as its surest label ("max"), or as the sum of all
                (the paper's; over 150 and over 8 labels that is not on one scale).

        Raises:
            PerceptionError: The file is missing, or was not written by that command.
        """
        self.pooling = pooling
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        hint = "`downbeat models export ast SOURCE --out FILE` writes such a file."
        if not path.is_file():
            raise PerceptionError(f"The router's model {path} does not exist; {hint}")
        try:
            self._session = onnxruntime.InferenceSession(
                str(path), options, providers=["CPUExecutionProvider"]
            )
            written = self._session.get_modelmeta().custom_metadata_map[METADATA_KEY]
            self.front = AstFront.from_json(written)
        except Exception as error:  # the runtime raises a class per status, with no common base
            raise PerceptionError(
                f"{path} is no model of the router `ast` ({error}); {hint}"
            ) from error

    def logits(self, samples: F32) -> F32:
        """Return the network's output for the newest sound, (labels,)."""
        found = self._session.run(None, {"input_values": self.front.prepare(samples)})
        return np.asarray(found[0][0])

    def scores(self, samples: F32) -> tuple[float, float]:
        """Return (p_music, p_speech)."""
        logits = self.logits(samples).astype(np.float64)
        sure = 1.0 / (1.0 + np.exp(-np.clip(logits, -60.0, 60.0)))
        groups = (sure[list(self.front.music)], sure[list(self.front.speech)])
        music, speech = (g.max() if self.pooling == "max" else g.sum() for g in groups)
        return float(music), float(speech)


class AstRouter:
    """Router "ast"."""

    name = "ast"

    def __init__(
        self, model: AstModel, config: RouterConfig | None = None, vad: Vad | None = None
    ) -> None:
        """Wire.

        Args:
            model: The exported transformer.
            config: Thresholds.
            vad: Voice activity; None: there is none and v_frac is NaN.
        """
        self.config = config or RouterConfig()
        self._model = model
        self._kept = round(self.config.window_s * SAMPLE_RATE_HZ)
        self._voice_kept = self._kept // FRAME_SAMPLES
        self._vad = None if vad is None else VadStream(vad)
        self.reset()

    def reset(self) -> None:
        """Forget everything heard."""
        if self._vad is not None:
            self._vad.reset()
        self._pending: list[F32] = []
        self._samples = np.zeros(0, np.float32)
        self._voice = np.zeros(0, np.float32)

    def hear(self, samples: F32, first_utime: int) -> None:
        """Take in a block."""
        # One NaN would stay in the detector's state for ever.
        clean = np.nan_to_num(np.asarray(samples, np.float32), posinf=0.0, neginf=0.0)
        self._pending.append(clean)
        if sum(len(p) for p in self._pending) >= SAMPLE_RATE_HZ:
            self._take_in()

    def judge(self, evidence: float) -> Verdict:
        """Judge the newest window; SKIP until a second was heard."""
        self._take_in()
        newest = self._samples[-round(LEVEL_S * SAMPLE_RATE_HZ) :].astype(np.float64)
        level = 10.0 * np.log10(newest.var() + 1e-12) if len(newest) else -120.0
        v_frac = voiced_fraction(self._voice) if len(self._voice) else float("nan")
        p_music = p_speech = float("nan")
        if len(self._samples) >= SAMPLE_RATE_HZ and level >= self.config.silence_dbfs:
            p_music, p_speech = self._model.scores(self._samples)
        return verdict(p_music, p_speech, v_frac, float(level), self.config, evidence, self.name)

    def _take_in(self) -> None:
        if not self._pending:
            return
        heard = np.concatenate(self._pending)
        self._pending = []
        self._samples = np.concatenate((self._samples, heard))[-self._kept :]
        if self._vad is not None:
            self._voice = np.concatenate((self._voice, self._vad.push(heard)))[-self._voice_kept :]
