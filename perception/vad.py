"""Voice activity: Silero VAD from its installed package, run by ONNX Runtime alone."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import onnxruntime

from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32

SAMPLE_RATE_HZ = 16_000
FRAME_SAMPLES = 512
FRAME_US = FRAME_SAMPLES * 1_000_000 // SAMPLE_RATE_HZ
MAX_FRAMES = 512
"""Frames per model call (16.4 s); a longer chunk goes in several calls with the state kept."""

_CONTEXT_SAMPLES = 64
_STATE_SHAPE = (1, 1, 128)
_PACKAGE = "silero_vad"
_MODEL = "data/silero_vad_16k_sequence.onnx"


def packaged_model() -> Path:
    """Return the model file inside the installed package, which itself is never imported.

    Its Python code imports torch; the model file does not need it.

    Raises:
        PerceptionError: The package or its sequence model is missing.
    """
    spec = importlib.util.find_spec(_PACKAGE)
    for folder in (spec.submodule_search_locations or []) if spec else []:
        if (path := Path(folder) / _MODEL).is_file():
            return path
    raise PerceptionError(
        f"Voice activity detection needs {_MODEL} of the package silero-vad, which is "
        f"{'too old' if spec else 'not installed'}; `pip install --no-deps 'silero-vad>=6.2'` "
        "brings it (its Python dependencies are not used)."
    )


class Vad:
    """The model. One is shared by any number of streams; it holds no state of its own."""

    def __init__(self, path: Path | None = None) -> None:
        """Load the model.

        Args:
            path: A Silero sequence model of 16 kHz; None: the one in the installed package.

        Raises:
            PerceptionError: The file is missing or is no such model.
        """
        file = packaged_model() if path is None else path
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        options.log_severity_level = 3  # its unused initialisers are warned of at every load
        try:
            self._session = onnxruntime.InferenceSession(
                str(file), options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # the runtime raises a class per status, with no common base
            raise PerceptionError(f"{file} cannot be loaded as a VAD model: {error}.") from error
        names = {node.name for node in self._session.get_inputs()}
        if names != {"input", "h", "c"}:
            raise PerceptionError(
                f"{file} has the inputs {sorted(names)}; valid is Silero's sequence model with "
                "input, h and c."
            )

    def probabilities(self, samples: F32) -> F32:
        """Return p(voice) of each frame of 32 ms; the last frame is filled up with zeros.

        Args:
            samples: (n,) mono, 16 kHz, full scale 1.

        Returns:
            (ceil(n / 512),) in 0..1.
        """
        stream = VadStream(self)
        padding = -len(samples) % FRAME_SAMPLES
        return stream.push(np.pad(np.asarray(samples, np.float32), (0, padding)))

    def run(self, frames: F32, hidden: F32, cell: F32) -> tuple[F32, F32, F32]:
        """Run consecutive frames.

        Args:
            frames: (k, 576) each with the last 64 samples before it.
            hidden: (1, 1, 128) state.
            cell: (1, 1, 128) state.

        Returns:
            (k,) probabilities and both states after the last frame.
        """
        values, hidden, cell = self._session.run(
            ["speech_probs", "hn", "cn"], {"input": frames, "h": hidden, "c": cell}
        )
        return np.reshape(values, -1), hidden, cell


class VadStream:
    """Sound in pieces of any length; the same probabilities as in one piece."""

    def __init__(self, vad: Vad) -> None:
        """Begin in silence."""
        self._vad = vad
        self.reset()

    def reset(self) -> None:
        """Forget everything heard: what follows is not a continuation."""
        self._hidden = np.zeros(_STATE_SHAPE, np.float32)
        self._cell = np.zeros(_STATE_SHAPE, np.float32)
        self._context = np.zeros(_CONTEXT_SAMPLES, np.float32)
        self._rest = np.zeros(0, np.float32)

    def push(self, samples: F32) -> F32:
        """Return p(voice) of every frame that these samples complete.

        Args:
            samples: (n,) mono, 16 kHz, full scale 1, directly after those before.

        Returns:
            (k,) in 0..1; what is less than a frame waits for the next push.
        """
        heard = np.concatenate((self._rest, np.asarray(samples, np.float32)))
        count = len(heard) // FRAME_SAMPLES
        self._rest = heard[count * FRAME_SAMPLES :]
        frames = heard[: count * FRAME_SAMPLES].reshape(count, FRAME_SAMPLES)
        found = [
            self._block(frames[first : first + MAX_FRAMES]) for first in range(0, count, MAX_FRAMES)
        ]
        return np.concatenate(found) if found else np.zeros(0, np.float32)

    def _block(self, frames: F32) -> F32:
        contexts = np.vstack((self._context, frames[:-1, -_CONTEXT_SAMPLES:]))  # (k, 64)
        self._context = frames[-1, -_CONTEXT_SAMPLES:]
        found, self._hidden, self._cell = self._vad.run(
            np.hstack((contexts, frames)), self._hidden, self._cell
        )
        return found


def voiced_fraction(probabilities: F32, threshold: float = 0.5) -> float:
    """Return the share of frames at or above the threshold; 0 of nothing."""
    return float(np.mean(probabilities >= threshold)) if len(probabilities) else 0.0
