"""What a sentence wants, learned: the sentence model with a few weights of ours on top of it.

A sentence embedding knows what is talked about, not whether it is asked for: "I taught the waltz
for forty years" and "a waltz, if you please" are neighbours. So its transformer is adapted
(low-rank updates of its matrices; Hu et al. 2021, LoRA) to some thousand written sentences, and a
linear layer says how likely each of the bundled skills is, and "stop", "again", "faster",
"slower", "resume", something forbidden, and talk. `tools/train_intents.py` makes the weights.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32
from downbeat.perception.sentence_model import SHA256, SentenceModel

WEIGHTS = Path(__file__).parent / "data" / "intents.npz"
CHAT, NOT, STOP = "chat", "not", "stop"
AGAIN, FASTER, SLOWER, RESUME = "again", "faster", "slower", "resume"
FORMS = frozenset({CHAT, NOT, STOP, AGAIN, FASTER, SLOWER, RESUME})
"""Classes that are no skills."""
SCALE = 10.0
"""Unit vectors times this go into the linear layer: it is trained so."""
_MARKS = re.compile(r"[.;!?:…]+(?=\s|$)|\s[-–—]+\s|[()\"“”«»]")
_COMMAS = re.compile(r"[\s,]*,[\s,]*")


class IntentModel:
    """Text -> probabilities of what it wants."""

    def __init__(self, folder: Path | None = None, weights: Path = WEIGHTS) -> None:
        """Load the transformer, adapt it; takes about a second.

        Args:
            folder: Of the sentence model; None: the one in the installed package.
            weights: What `tools/train_intents.py` wrote.

        Raises:
            PerceptionError: Something is missing, or the weights belong to another transformer.
        """
        try:
            with np.load(weights, allow_pickle=False) as file:
                learned: dict[str, npt.NDArray[Any]] = dict(file)
            self.classes: tuple[str, ...] = tuple(str(one) for one in learned["classes"])
            self._head = learned["head.weight"].astype(np.float32).T
            self._bias = learned["head.bias"].astype(np.float32)
            base = str(learned["base"])
        except (OSError, ValueError, KeyError) as error:
            raise PerceptionError(
                f"{weights} holds no intents ({error}); `python -m downbeat.tools.train_intents` "
                "writes it."
            ) from error
        if base != SHA256:
            raise PerceptionError(
                f"{weights} was trained on the sentence model {base[:12]}..., here is "
                f"{SHA256[:12]}...; `python -m downbeat.tools.train_intents` makes them anew."
            )
        updates = {name: value for name, value in learned.items() if name.startswith("encoder.")}
        self._model = SentenceModel(folder, SHA256, updates)

    def judge(self, texts: Sequence[str]) -> F32:
        """Return (n, classes) probabilities, one row per text; 4 ms of one core each."""
        logits = SCALE * self.embed(texts) @ self._head + self._bias
        logits -= logits.max(axis=1, keepdims=True)
        likely = np.exp(logits)
        probabilities: F32 = likely / likely.sum(axis=1, keepdims=True)
        return probabilities

    def embed(self, texts: Sequence[str]) -> F32:
        """Return (n, dim) unit vectors of the adapted transformer."""
        return self._model.embed([written(text) for text in texts])

    def knows(self, word: str) -> bool:
        """Return whether a word is in the vocabulary; else only its pieces have a meaning."""
        return self._model.knows(word)


def written(text: str) -> str:
    """Return a text as the model was taught to read it: small letters, no marks but commas."""
    plain = _MARKS.sub(",", text.lower().replace("’", "'"))
    return " ".join(_COMMAS.sub(", ", plain).strip(", ").split())
