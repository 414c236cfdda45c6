"""An exported CLAP, run by ONNX Runtime: sound and words in one space.

`downbeat models export clap SOURCE --out FOLDER` writes the folder from a laion-clap checkpoint or
a transformers ClapModel: clap.json, audio.onnx, text.onnx, tokenizer.json. No torch is needed here.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime

from downbeat.perception.clap_features import FrontEnd, clap_picture
from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32

FORMAT = "downbeat-clap-1"
HEADER_NAME, AUDIO_NAME, TEXT_NAME = "clap.json", "audio.onnx", "text.onnx"
TOKENIZER_NAME = "tokenizer.json"
MAX_TOKENS = 77
"""What text towers were trained with; every text is padded to it."""
WINDOW_S = 5.0
"""Heard at once: the same as of the default; the model repeats it to its ten seconds."""


class ClapEmbedder:
    """Both towers. `Embedder` of likeness.py, by the name "clap"."""

    name = "clap"

    def __init__(self, folder: Path, window_s: float = WINDOW_S) -> None:
        """Load an exported folder; about a second.

        Args:
            folder: As `downbeat models export clap` writes it.
            window_s: Length of the windows of a catalogue and of queries [s].

        Raises:
            PerceptionError: A file is missing, damaged or of another format.
        """
        header = read_header(folder)
        self.front = FrontEnd(**header["front_end"])
        self.window_s = window_s
        if not 0.0 < window_s <= self.front.clip_s:
            raise PerceptionError(
                f"CLAP cannot hear {window_s:g} s at once; valid are up to {self.front.clip_s:g} s."
            )
        joined = "".join(f"{name}{digest}" for name, digest in sorted(header["sha256"].items()))
        state = hashlib.sha256(f"{FORMAT}{window_s:g}{header['front_end']}{joined}".encode())
        self.digest = f"clap-{state.hexdigest()[:16]}"
        self._audio = _session(folder / AUDIO_NAME)
        self._text: Any = None
        self._tokenizer: Any = None
        self._folder = folder

    def embed(self, samples: F32, sample_rate_hz: int) -> F32:
        """Return the unit vector of a window of sound, (dim,); 90 ms of a core, HTSAT-base 190."""
        picture = clap_picture(samples, sample_rate_hz, self.front)[None, None]
        vectors: F32 = self._audio.run(None, {"picture": picture})[0]
        return vectors[0]

    def embed_texts(self, texts: Sequence[str]) -> F32:
        """Return unit vectors, (n, dim); the text tower is loaded at the first call."""
        if self._text is None:
            self._tokenizer = _tokenizer(self._folder / TOKENIZER_NAME)
            self._text = _session(self._folder / TEXT_NAME)
        rows = []
        for text in texts:
            coded = self._tokenizer.encode(text)
            ids = np.array([coded.ids], np.int64)
            mask = np.array([coded.attention_mask], np.int64)
            rows.append(self._text.run(None, {"ids": ids, "mask": mask})[0][0])
        return np.array(rows, np.float32)


def write_header(folder: Path, source: str, family: str, front: FrontEnd) -> None:
    """Write clap.json over the files of an export.

    Args:
        folder: Holds audio.onnx, text.onnx and tokenizer.json.
        source: What was exported.
        family: "laion-clap" or "transformers".
        front: What the checkpoint sees.
    """
    names = (AUDIO_NAME, TEXT_NAME, TOKENIZER_NAME)
    header = {
        "format": FORMAT,
        "source": source,
        "family": family,
        "front_end": asdict(front),
        "sha256": {name: _sha256(folder / name) for name in names},
    }
    (folder / HEADER_NAME).write_text(json.dumps(header, indent=2) + "\n", encoding="utf-8")


def read_header(folder: Path) -> dict[str, Any]:
    """Return clap.json of a folder whose files are whole.

    Raises:
        PerceptionError: See `ClapEmbedder`.
    """
    remedy = "`downbeat models export clap SOURCE --out FOLDER` makes one"
    path = folder / HEADER_NAME
    if not path.is_file():
        raise PerceptionError(f"{folder} is no exported CLAP (no {HEADER_NAME}); {remedy}.")
    try:
        header: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if header["format"] != FORMAT:
            raise PerceptionError(
                f"{path} is of format {header['format']}, not {FORMAT}; {remedy}."
            )
        FrontEnd(**header["front_end"])
        found = {name: _sha256(folder / name) for name in header["sha256"]}
    except (ValueError, KeyError, TypeError, AttributeError, OSError) as error:
        raise PerceptionError(f"{folder} is no whole exported CLAP: {error}; {remedy}.") from error
    for name in (AUDIO_NAME, TEXT_NAME, TOKENIZER_NAME):
        if found.get(name) != header["sha256"].get(name) or name not in found:
            raise PerceptionError(f"{folder / name} is damaged or of another export; {remedy}.")
    return header


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _session(path: Path) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # ONNX Runtime has exceptions of its own for every fault
        raise PerceptionError(f"{path} cannot be run: {error}.") from error


def _tokenizer(path: Path) -> Any:
    try:
        from tokenizers import Tokenizer
    except ImportError as error:
        raise PerceptionError(
            "CLAP's words need the package tokenizers; `pip install 'downbeat[speech]'` brings it."
        ) from error
    try:
        tokenizer = Tokenizer.from_file(str(path))
    except Exception as error:  # the tokeniser raises bare Exception
        raise PerceptionError(f"{path} is no tokeniser: {error}.") from error
    pad = tokenizer.token_to_id("<pad>")
    if pad is None:
        raise PerceptionError(f"{path} has no token <pad>; a RoBERTa tokeniser is expected.")
    tokenizer.enable_truncation(MAX_TOKENS)
    tokenizer.enable_padding(length=MAX_TOKENS, pad_id=pad, pad_token="<pad>")
    return tokenizer
