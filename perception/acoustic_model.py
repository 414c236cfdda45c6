"""The acoustic model that the package pocketsphinx carries: sound in, likelihoods of senones out.

A phonetically tied mixture: every phone has one codebook of Gaussians per stream (cepstra, their
first and their second differences), and a senone, the state of a phone between two others, mixes
them by weights of its own. Evaluated as a few matrix products over a whole utterance, all Gaussians
of a codebook count, which the package's own decoder cannot afford frame by frame.
"""

from __future__ import annotations

import importlib.util
import math
import struct
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32

STATES = 3
"""Emitting states of a phone."""
SILENCE = "SIL"
VOICE_FILE = Path(__file__).parent / "data" / "recogniser_voice.npz"
"""How the means move for synthetic voices; `python -m downbeat.tools.adapt_recogniser` made it."""

_WORD_POSITIONS = {"inside": 0, "begin": 1, "end": 2, "single": 3}
_LOG_BASE = math.log(1.0001)
_MIXTURE_SHIFT = 10
_VARIANCE_FLOOR = 1e-4
_MAGIC = 0x11223344


@dataclass(frozen=True)
class AcousticModel:
    """What the files of the model hold.

    Attributes:
        phones: Names; the index is the phone's number.
        phone_of_senone: (s,) number of the phone whose codebook a senone mixes.
        order: (s,) senones sorted by their phones; the columns of `weights`.
        means: (phones, streams, densities, 13).
        precisions: As the means: 1 / variance.
        offsets: (phones, streams, densities) logarithm of a density at its mean.
        weights: (streams, densities, s) of the mixtures, columns in `order`.
        stay: (phones, 3) logarithm of staying in a state.
        leave: (phones, 3) logarithm of going on.
        triphones: (base, left, right, position) -> the senones of its three states.
    """

    phones: tuple[str, ...]
    phone_of_senone: NDArray[np.int64]
    order: NDArray[np.int64]
    means: F32
    precisions: F32
    offsets: F32
    weights: F32
    stay: F32
    leave: F32
    triphones: dict[tuple[int, int, int, int], tuple[int, int, int]]

    def senones(self, base: int, left: int, right: int, position: str) -> tuple[int, int, int]:
        """Return the senones of a phone between two others.

        Args:
            base: Its number.
            left: The one before it; silence at the beginning.
            right: The one after it.
            position: "begin", "inside" or "end" of a word, or "single".
        """
        wanted = _WORD_POSITIONS[position]
        for place in (wanted, *(p for p in _WORD_POSITIONS.values() if p != wanted)):
            if (found := self.triphones.get((base, left, right, place))) is not None:
                return found
        first = base * STATES
        return first, first + 1, first + 2

    def adapted(self, file: Path | None = None) -> AcousticModel:
        """Return the model for synthetic voices.

        Args:
            file: How the means move; None: the frozen one.

        Raises:
            PerceptionError: The file is missing or does not fit.
        """
        file = file or VOICE_FILE
        try:
            with np.load(file) as table:
                means = self.means + table["moved"].astype(np.float32)
        except (OSError, ValueError, KeyError) as error:
            raise PerceptionError(
                f"{file} is no adaptation of this acoustic model ({error!r}); "
                "`python -m downbeat.tools.adapt_recogniser` makes one."
            ) from error
        return replace(self, means=means)

    def all_senones(self) -> list[tuple[set[int], ...]]:
        """Return, of every phone, the senones of each state, whatever it stands between."""
        found = [
            tuple({base * STATES + k} for k in range(STATES)) for base in range(len(self.phones))
        ]
        for (base, *_), states in self.triphones.items():
            for known, senone in zip(found[base], states, strict=True):
                known.add(senone)
        return found

    def log_likelihoods(self, features: F32) -> F32:
        """Return how well every senone explains every frame.

        Args:
            features: (t, 3, 13) of `cepstra`.

        Returns:
            (t, s) natural logarithms.
        """
        streams = features.shape[1]
        total = np.zeros((len(features), len(self.order)), np.float32)
        sorted_phones = self.phone_of_senone[self.order]
        bounds = np.searchsorted(sorted_phones, np.arange(len(self.phones) + 1))
        for stream in range(streams):
            x = features[:, stream]  # (t, 13)
            flat = self.precisions[:, stream].reshape(-1, x.shape[1])  # (phones * densities, 13)
            mean = self.means[:, stream].reshape(flat.shape)
            far = (x * x) @ flat.T - 2.0 * (x @ (mean * flat).T) + (mean * mean * flat).sum(1)
            density = self.offsets[:, stream].reshape(-1) - 0.5 * far
            density = density.reshape(len(x), len(self.phones), -1)
            peak = density.max(axis=2, keepdims=True)
            likely = np.exp(density - peak)
            for phone in range(len(self.phones)):
                first, last = bounds[phone], bounds[phone + 1]
                mixed = likely[:, phone] @ self.weights[stream][:, first:last]
                total[:, first:last] += np.log(mixed + 1e-30) + peak[:, phone]
        result = np.empty_like(total)
        result[:, self.order] = total
        return result


def packaged_folder() -> Path:
    """Return the folder of the model in the installed package, which is not imported.

    Raises:
        PerceptionError: The package is missing.
    """
    spec = importlib.util.find_spec("pocketsphinx")
    for folder in (spec.submodule_search_locations or []) if spec else []:
        if (Path(folder) / "model" / "en-us" / "en-us" / "mdef").is_file():
            return Path(folder) / "model" / "en-us"
    raise PerceptionError(
        "The recogniser pocketsphinx is not installed; `pip install pocketsphinx` brings it, and "
        "backend = openai or whisper needs none."
    )


def load_acoustic_model(folder: Path) -> AcousticModel:
    """Read the model's files.

    Raises:
        PerceptionError: One is missing, or is not of the kind that pocketsphinx 5 carries.
    """
    try:
        phones, phone_of_senone, triphones = _read_definition(folder / "mdef")
        means = _read_arrays(folder / "means", 3)
        variances = np.maximum(_read_arrays(folder / "variances", 3), _VARIANCE_FLOOR)
        weights = _read_weights(folder / "sendump")
        steps = _read_arrays(folder / "transition_matrices", 1)
    except (OSError, ValueError, struct.error, IndexError) as error:
        raise PerceptionError(
            f"{folder} is no acoustic model of pocketsphinx 5 ({error!r}); "
            "`pip install --force-reinstall pocketsphinx` brings it again."
        ) from error
    order = np.argsort(phone_of_senone, kind="stable")
    chance = steps / np.maximum(steps.sum(axis=2, keepdims=True), 1e-30)  # (phones, 3, 4)
    states = np.arange(STATES)
    return AcousticModel(
        phones=phones,
        phone_of_senone=phone_of_senone,
        order=order,
        means=means,
        precisions=(1.0 / variances).astype(np.float32),
        offsets=(-0.5 * np.log(2 * math.pi * variances).sum(axis=3)).astype(np.float32),
        weights=np.ascontiguousarray(weights[:, :, order]),
        stay=np.log(chance[:, states, states] + 1e-10).astype(np.float32),
        leave=np.log(chance[:, states, states + 1] + 1e-10).astype(np.float32),
        triphones=triphones,
    )


def _read_definition(
    file: Path,
) -> tuple[tuple[str, ...], NDArray[np.int64], dict[tuple[int, ...], tuple[int, ...]]]:
    raw = file.read_bytes()
    kind, _version, length = struct.unpack_from("<4sii", raw)
    if kind != b"BMDF":
        raise ValueError(f"{file.name} begins with {kind!r}")
    at = 12 + length
    count, phones, states, _ci, senones, _tmat, sequences, _ctx, tree, _sil = struct.unpack_from(
        "<10i", raw, at
    )
    at += 40
    begin = at
    names = []
    for _ in range(count):
        end = raw.index(b"\0", at)
        names.append(raw[at:end].decode("ascii"))
        at = end + 1
    at = begin + -(-(at - begin) // 4) * 4
    at += 8 * tree
    table = np.frombuffer(
        raw, np.dtype([("ssid", "<i4"), ("tmat", "<i4"), ("a", "u1", 4)]), phones, at
    )
    at += 12 * phones + 4  # the number of all states follows the phones
    sequence = np.frombuffer(raw, "<u2", sequences * states, at).reshape(sequences, states)
    owner = np.full(senones, -1, np.int64)
    triphones = {}
    for number, (ssid, _tmat, attributes) in enumerate(table.tolist()):
        found = tuple(sequence[ssid].tolist())
        if number < count:
            owner[list(found)] = number
            continue
        position, base, left, right = attributes
        owner[list(found)] = base
        triphones[base, left, right, position] = found
    if (owner < 0).any():
        raise ValueError(f"{file.name} has senones of no phone")
    return tuple(names), owner, triphones


def _read_arrays(file: Path, streams: int) -> F32:
    """Return (phones, streams, densities, 13) of Gaussians, or (phones, 3, 4) of transitions."""
    raw = file.read_bytes()
    at = raw.index(b"endhdr\n") + 7
    (magic,) = struct.unpack_from("<I", raw, at)
    if magic != _MAGIC:
        raise ValueError(f"{file.name} is of another byte order")
    if streams == 1:
        shape = struct.unpack_from("<3i", raw, at + 4)
        at += 20
        return np.frombuffer(raw, "<f4", math.prod(shape), at).reshape(shape)
    books, found, densities = struct.unpack_from("<3i", raw, at + 4)
    lengths = struct.unpack_from(f"<{found}i", raw, at + 16)
    if found != streams or len(set(lengths)) != 1:
        raise ValueError(f"{file.name} has streams of {lengths} values")
    shape = (books, found, densities, lengths[0])
    at += 16 + 4 * found + 4
    return np.frombuffer(raw, "<f4", math.prod(shape), at).reshape(shape)


def _read_weights(file: Path) -> F32:
    """Return (streams, densities, senones)."""
    raw = file.read_bytes()
    at = 0
    texts: dict[str, str] = {}
    while (length := struct.unpack_from("<i", raw, at)[0]) != 0:
        text = raw[at + 4 : at + 4 + length].rstrip(b"\0").decode("latin-1")
        key, _, value = text.rpartition(" ")
        texts[key] = value
        at += 4 + length
    densities, senones = struct.unpack_from("<2i", raw, at + 4)
    streams = int(texts.get("feature_count", "0"))
    if texts.get("cluster_count") != "0" or not streams:
        raise ValueError(f"{file.name} is of a clustered kind")
    codes = np.frombuffer(raw, np.uint8, streams * densities * senones, at + 12)
    table: Any = np.exp(-np.arange(256.0) * (1 << _MIXTURE_SHIFT) * _LOG_BASE).astype(np.float32)
    return table[codes].reshape(streams, densities, senones)
