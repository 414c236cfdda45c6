"""The embedded descriptor: likeness of music without any download.

A linear map of `likeness_features.describe`, learned by `python -m downbeat.tools.train_likeness`
on whole recordings, with no label but which recording a window is of. It keeps the directions
in which recordings differ from each other more than windows of one recording do, be they heard
clean, in a room, through the robot's microphone or at another tempo (linear discriminant analysis).

Its limits: it hears sound and beat, not style, mood or words. Two pieces of one band with the same
instruments are close, a song and its cover by other instruments are not. It knows no words.
"""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32
from downbeat.perception.likeness_features import describe, to_descriptor_rate

WEIGHTS = Path(__file__).parent / "data" / "likeness.npz"
FORMAT = "downbeat-descriptor-1"
CLIP = 4.0
"""Deviations [sigma]: one absurd number must not decide."""


class EmbeddedDescriptor:
    """`Embedder` of likeness.py, by the name "embedded"."""

    name = "embedded"
    window_s = 5.0

    def __init__(self, weights: Path = WEIGHTS) -> None:
        """Load the learned map.

        Raises:
            PerceptionError: The file is missing or not made by the training script.
        """
        self._mean, self._deviation, self._map, self.digest = _load(weights)

    def embed(self, samples: F32, sample_rate_hz: int) -> F32:
        """Return the unit vector of a window of sound, (64,); 5 ms of one core for 5 s.

        Args:
            samples: (n,) mono, not silent, at least three seconds.
            sample_rate_hz: [Hz].
        """
        values = describe(to_descriptor_rate(samples, sample_rate_hz))
        return project(values, self._mean, self._deviation, self._map)

    def embed_texts(self, texts: Sequence[str]) -> F32:
        """Say that it has no words.

        Raises:
            PerceptionError: Always.
        """
        raise PerceptionError(
            "The embedded descriptor has no words, so skills are not found by their descriptions; "
            "export a CLAP with `downbeat models export clap` and choose the backend 'clap'."
        )


def project(values: F32, mean: F32, deviation: F32, mapping: F32) -> F32:
    """Return unit vectors of descriptors, (..., dim).

    Args:
        values: (..., n) descriptors.
        mean: (n,) over the training set.
        deviation: (n,) likewise.
        mapping: (n, dim).
    """
    standard = np.clip((values - mean) / deviation, -CLIP, CLIP)
    vectors = standard @ mapping
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(length, 1e-9), np.float32)


@lru_cache(maxsize=4)
def _load(path: Path) -> tuple[F32, F32, F32, str]:
    remedy = "`python -m downbeat.tools.train_likeness` makes one"
    try:
        with np.load(path, allow_pickle=False) as data:
            if str(data["format"]) != FORMAT:
                raise PerceptionError(
                    f"{path} is of format {data['format']}, not {FORMAT}; {remedy}."
                )
            parts = tuple(np.asarray(data[k], np.float32) for k in ("mean", "deviation", "mapping"))
    except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
        raise PerceptionError(f"{path} is no {FORMAT}, or is missing; {remedy}.") from error
    mean, deviation, mapping = parts
    if mean.shape != deviation.shape or len(mean) != len(mapping):
        raise PerceptionError(f"{path} is damaged; {remedy}.")
    state = hashlib.sha256(FORMAT.encode())
    for part in parts:
        state.update(part.tobytes())
    return mean, deviation, mapping, f"embedded-{state.hexdigest()[:16]}"
