"""CLAP checkpoints with random weights, small text towers and a tokeniser trained on ten words."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import Any

import numpy as np

WORDS = ["dance to this music", "slow and sad", "a disco beat with strings", "salsa", "rock music"]
VOCABULARY = 300


def make_tokenizer(folder: Path) -> Any:
    """Save a byte-level tokeniser with RoBERTa's special tokens; return it for transformers."""
    from tokenizers import Tokenizer, decoders, models, pre_tokenizers, processors, trainers
    from transformers import PreTrainedTokenizerFast

    tokenizer = Tokenizer(models.BPE(unk_token="<unk>"))
    tokenizer.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    tokenizer.decoder = decoders.ByteLevel()
    special = ["<s>", "<pad>", "</s>", "<unk>", "<mask>"]
    trainer = trainers.BpeTrainer(
        vocab_size=VOCABULARY, special_tokens=special, show_progress=False,
        initial_alphabet=pre_tokenizers.ByteLevel.alphabet(),
    )  # fmt: skip
    tokenizer.train_from_iterator(WORDS, trainer)
    tokenizer.post_processor = processors.RobertaProcessing(("</s>", 2), ("<s>", 0))
    fast = PreTrainedTokenizerFast(
        tokenizer_object=tokenizer, bos_token="<s>", eos_token="</s>", sep_token="</s>",
        cls_token="<s>", unk_token="<unk>", pad_token="<pad>", mask_token="<mask>",
    )  # fmt: skip
    fast.save_pretrained(str(folder))
    return fast


def shake(model: Any, seed: int) -> None:
    """Draw the statistics and gains that random initialisation leaves at 0 and 1."""
    import torch

    torch.manual_seed(seed)
    with torch.no_grad():
        for module in model.modules():
            if isinstance(module, torch.nn.BatchNorm2d):
                module.running_mean.normal_(-30.0, 5.0)
                module.running_var.uniform_(100.0, 400.0)
            if isinstance(module, torch.nn.LayerNorm | torch.nn.BatchNorm2d):
                module.weight.uniform_(0.5, 1.5)
                module.bias.normal_(0.0, 0.2)
            if isinstance(module, torch.nn.Linear):
                module.weight.normal_(0.0, 1.5 / module.in_features**0.5)


def make_clap_model(folder: Path) -> tuple[Any, Any, Any]:
    """Save a transformers ClapModel; return model, feature extractor, tokeniser."""
    import torch
    from transformers import ClapConfig, ClapFeatureExtractor, ClapModel

    torch.manual_seed(3)
    text = {
        "vocab_size": VOCABULARY, "num_hidden_layers": 2, "hidden_size": 64,
        "num_attention_heads": 4, "intermediate_size": 128, "max_position_embeddings": 100,
    }  # fmt: skip
    audio = {"enable_fusion": False}
    with contextlib.redirect_stdout(io.StringIO()):
        model = ClapModel(ClapConfig(text_config=text, audio_config=audio)).eval()
    shake(model, 4)
    extractor = ClapFeatureExtractor(truncation="rand_trunc", frequency_min=50)
    model.save_pretrained(str(folder))
    extractor.save_pretrained(str(folder))
    return model, extractor, make_tokenizer(folder)


def make_laion_checkpoint(path: Path, architecture: str) -> Any:
    """Save a checkpoint as laion-clap's training does; return its model."""
    import torch
    from transformers import RobertaConfig

    from downbeat.tools.models_clap_laion import build_model

    torch.manual_seed(5)
    text = RobertaConfig(
        vocab_size=VOCABULARY, num_hidden_layers=2, max_position_embeddings=514,
        type_vocab_size=1, layer_norm_eps=1e-5, attn_implementation="eager",
    )  # fmt: skip
    model = build_model(architecture, text)[0].eval()
    shake(model, 6)
    weights = {f"module.{name}": value for name, value in model.state_dict().items()}
    weights["module.text_branch.embeddings.position_ids"] = torch.arange(514)[None]
    torch.save({"epoch": 1, "name": "test", "state_dict": weights}, path)
    return model


def some_sound(seed: int, seconds: float, sample_rate_hz: int) -> np.ndarray:
    """Chords with a beat and noise, (n,)."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * sample_rate_hz)) / sample_rate_hz
    tones = sum(np.sin(2 * np.pi * f * t) for f in rng.uniform(100, 3000, 5))
    beat = np.exp(-8.0 * (t * rng.uniform(1, 3) % 1.0))
    noise = rng.normal(size=len(t)) * 0.2
    return (0.1 * tones * beat + 0.1 * noise * beat).astype(np.float32)
