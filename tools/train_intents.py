"""Trains the weights of `perception/intent_model.py`: `python -m downbeat.tools.train_intents`.

The sentences stand in `intent_sentences.tsv`; the phrases and descriptions of the manifests and the
embedded examples are added. None of the test half of the evaluation set is among them. Needs torch.
"""

from __future__ import annotations

import argparse
import csv
import math
import random
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from downbeat.perception.grounding import NOT_BY_VOICE, STAND
from downbeat.perception.grounding_examples import EXAMPLES
from downbeat.perception.grounding_talk import TALK
from downbeat.perception.intent_model import CHAT, SCALE, STOP, WEIGHTS, written
from downbeat.perception.sentence_model import SHA256, packaged_folder
from downbeat.policies.manifest import load_skills
from downbeat.tools.errors import ToolError

SENTENCES = Path(__file__).parent / "intent_sentences.tsv"
ADAPTED = ("attention.self.query", "attention.self.value", "attention.output.dense")
ADAPTED_WIDE = ("intermediate.dense", "output.dense")
BATCH, DROPOUT, SMOOTHING, WEIGHT_DECAY = 32, 0.1, 0.05, 0.01
UPDATE_RATE, HEAD_RATE = 2e-3, 5e-3
UPDATE_GAIN = 2.0
MAX_TOKENS = 48
OPENERS = (
    "hey robot", "okay robot", "robot", "please", "could you please", "um", "okay so", "alright",
    "now", "hey", "yo", "so", "hello robot", "dear robot", "well", "right then",
)  # fmt: skip
TAILS = (
    "please", "for us", "now", "robot", "for me", "would you", "thank you", "okay", "right now",
    "if you can", "my friend",
)  # fmt: skip


@dataclass(frozen=True)
class Labelled:
    """A sentence and what it wants: a class of `IntentModel`."""

    text: str
    wanted: str


def load_sentences(path: Path = SENTENCES) -> list[Labelled]:
    """Return what is trained on, each sentence once.

    Raises:
        ToolError: The file cannot be read, or has other columns.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file, delimiter="\t", quoting=csv.QUOTE_NONE))
        pairs = [(row["text"], row["expected"]) for row in rows]
    except (OSError, UnicodeDecodeError, KeyError) as error:
        raise ToolError(f"{path} is no set of sentences (expected, text): {error}.") from error
    for name, skill in sorted(load_skills().items()):
        if name not in NOT_BY_VOICE:
            pairs += [(one, name) for one in (skill.title, *skill.phrases, *skill.descriptions)]
    pairs += [(one, name) for name, texts in EXAMPLES.items() for one in texts]
    pairs += [(one, CHAT) for one in TALK]
    found: dict[str, str] = {}
    for text, wanted in pairs:
        found.setdefault(written(text), STOP if wanted == STAND else wanted)
    return [Labelled(text, wanted) for text, wanted in found.items() if text]


def varied(one: Labelled, rng: random.Random) -> str:
    """Return a sentence as somebody else might have said it."""
    words = one.text.split()
    if one.wanted != CHAT or rng.random() < 0.3:
        if rng.random() < 0.15:
            words = rng.choice(OPENERS).split() + words
        if rng.random() < 0.15:
            words += rng.choice(TAILS).split()
    if len(words) > 4 and rng.random() < 0.12:
        words.pop(rng.randrange(len(words)))
    text = " ".join(words)
    return text.replace(",", "") if rng.random() < 0.5 else text


class Trainee:
    """The transformer with low-rank updates and the linear layer, in torch."""

    def __init__(self, classes: Sequence[str], rank: int) -> None:
        """Load the frozen weights; updates begin at zero."""
        import torch
        from safetensors.numpy import load_file
        from tokenizers import Tokenizer

        self.torch, self.classes, self.is_training = torch, tuple(classes), True
        folder = packaged_folder()
        self._tokenizer: Any = Tokenizer.from_file(str(folder / "tokenizer.json"))
        self._tokenizer.enable_truncation(MAX_TOKENS)
        self._tokenizer.no_padding()
        loaded = load_file(folder / "model.safetensors")
        self._weights: dict[str, Any] = {k: torch.tensor(v) for k, v in loaded.items()}
        self.updates: dict[str, Any] = {}
        for layer in range(6):
            for part in (*ADAPTED, *ADAPTED_WIDE):
                name = f"encoder.layer.{layer}.{part}.weight"
                out, into = self._weights[name].shape
                down = torch.randn(rank, into) / math.sqrt(into)
                self.updates[name + ".down"] = down.requires_grad_()
                self.updates[name + ".up"] = torch.zeros(out, rank, requires_grad=True)
        self.head = torch.nn.Linear(len(loaded["embeddings.LayerNorm.bias"]), len(classes))

    def logits(self, texts: Sequence[str]) -> Any:
        """Return (n, classes)."""
        torch, weights = self.torch, self._weights
        coded = [one.ids for one in self._tokenizer.encode_batch(list(texts))]
        length = max(map(len, coded))
        ids = torch.tensor([one + [0] * (length - len(one)) for one in coded])
        mask = torch.tensor([[1.0] * len(one) + [0.0] * (length - len(one)) for one in coded])
        x = weights["embeddings.word_embeddings.weight"][ids]
        x = x + weights["embeddings.position_embeddings.weight"][:length]
        x = x + weights["embeddings.token_type_embeddings.weight"][0]
        x = self._drop(self._norm(x, "embeddings.LayerNorm"))
        bias = (1.0 - mask)[:, None, None, :] * -1e9
        for layer in range(6):
            x = self._layer(x, bias, f"encoder.layer.{layer}.")
        mean = (x * mask[:, :, None]).sum(1)
        return self.head(self._drop(SCALE * torch.nn.functional.normalize(mean, dim=1)))

    def _layer(self, x: Any, bias: Any, at: str) -> Any:
        torch = self.torch
        n, length, dim = x.shape

        def heads(name: str) -> Any:
            y = self._linear(x, at + "attention.self." + name)
            return y.view(n, length, dim // 32, 32).transpose(1, 2)

        scores = heads("query") @ heads("key").transpose(2, 3) / math.sqrt(32)
        attention = self._drop(torch.softmax(scores + bias, -1))
        mixed = (attention @ heads("value")).transpose(1, 2).reshape(n, length, dim)
        out = self._linear(mixed, at + "attention.output.dense")
        x = self._norm(x + self._drop(out), at + "attention.output.LayerNorm")
        wide = torch.nn.functional.gelu(self._linear(x, at + "intermediate.dense"))
        out = self._linear(wide, at + "output.dense")
        return self._norm(x + self._drop(out), at + "output.LayerNorm")

    def _linear(self, x: Any, name: str) -> Any:
        linear = self.torch.nn.functional.linear
        y = linear(x, self._weights[name + ".weight"], self._weights[name + ".bias"])
        if (down := self.updates.get(name + ".weight.down")) is not None:
            y = y + UPDATE_GAIN * linear(linear(x, down), self.updates[name + ".weight.up"])
        return y

    def _norm(self, x: Any, name: str) -> Any:
        gain, shift = self._weights[name + ".weight"], self._weights[name + ".bias"]
        return self.torch.nn.functional.layer_norm(x, gain.shape, gain, shift, 1e-12)

    def _drop(self, x: Any) -> Any:
        return self.torch.nn.functional.dropout(x, DROPOUT, self.is_training)

    def probabilities(self, texts: Sequence[str]) -> Any:
        """Return (n, classes) as numpy."""
        self.is_training = False
        with self.torch.no_grad():
            parts = [self.logits(texts[i : i + 64]) for i in range(0, len(texts), 64)]
        self.is_training = True
        return self.torch.softmax(self.torch.cat(parts), 1).numpy()

    def save(self, path: Path) -> None:
        """Write what `IntentModel` loads."""
        arrays = {name: value.detach().numpy() for name, value in self.updates.items()}
        arrays = {k: v * (UPDATE_GAIN if k.endswith(".up") else 1.0) for k, v in arrays.items()}
        arrays |= {"head.weight": self.head.weight.detach().numpy()}
        arrays |= {"head.bias": self.head.bias.detach().numpy()}
        halves: dict[str, Any] = {name: value.astype(np.float16) for name, value in arrays.items()}
        np.savez_compressed(path, classes=np.array(self.classes), base=np.array(SHA256), **halves)


def train(sentences: Sequence[Labelled], rank: int, epochs: int, seed: int) -> Trainee:
    """Return the trained model; 1.5 minutes of one core per epoch."""
    import torch

    torch.manual_seed(seed)
    rng = random.Random(seed)
    classes = sorted({one.wanted for one in sentences})
    trainee = Trainee(classes, rank)
    groups = [
        {"params": list(trainee.updates.values()), "lr": UPDATE_RATE},
        {"params": list(trainee.head.parameters()), "lr": HEAD_RATE},
    ]
    optimizer = torch.optim.AdamW(groups, weight_decay=WEIGHT_DECAY)
    steps = epochs * (len(sentences) // BATCH)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, [UPDATE_RATE, HEAD_RATE], total_steps=steps + 1, pct_start=0.1
    )
    for epoch in range(epochs):
        losses = []
        for batch in _batches(sentences, rng):
            wanted = torch.tensor([classes.index(one.wanted) for one in batch])
            logits = trainee.logits([varied(one, rng) for one in batch])
            loss = torch.nn.functional.cross_entropy(logits, wanted, label_smoothing=SMOOTHING)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
            losses.append(float(loss.detach()))
        print(f"epoch {epoch + 1} of {epochs}: loss {np.mean(losses):.3f}", flush=True)
    return trainee


def _batches(sentences: Sequence[Labelled], rng: random.Random) -> list[list[Labelled]]:
    """Return batches of sentences of about one length, in random order; the remainder is left."""
    order = list(sentences)
    rng.shuffle(order)
    pool = 20 * BATCH
    order = [
        one
        for at in range(0, len(order), pool)
        for one in sorted(order[at : at + pool], key=lambda one: len(one.text))
    ]
    batches = [order[at : at + BATCH] for at in range(0, len(order) - BATCH + 1, BATCH)]
    rng.shuffle(batches)
    return batches


def main() -> int:
    """Train on everything and write the weights."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else None)
    parser.add_argument("--sentences", type=Path, default=SENTENCES, help="expected TAB text")
    parser.add_argument("--out", type=Path, default=WEIGHTS, help="weights; what was there is lost")
    parser.add_argument("--rank", type=int, default=8, help="of the updates")
    parser.add_argument("--epochs", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    try:
        import torch  # noqa: F401
    except ImportError:
        print("Training needs torch, which is not installed; `pip install torch`.", file=sys.stderr)
        return 2
    try:
        sentences = load_sentences(chosen.sentences)
    except ToolError as error:
        print(error, file=sys.stderr)
        return 2
    print(f"{len(sentences)} sentences")
    train(sentences, chosen.rank, chosen.epochs, chosen.seed).save(chosen.out)
    print(f"{chosen.out}: {chosen.out.stat().st_size // 1024} KiB")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
