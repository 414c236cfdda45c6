"""A laion-clap checkpoint as two torch modules, without its hub downloads.

The package's own loader fetches RoBERTa from the hub and wants torchvision, webdataset, wandb and
more. Its model code alone needs torch, transformers, torchlibrosa and h5py. So the model is built
here: audio architecture and size of the text tower are read off the shapes of the weights.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.machinery
import importlib.util
import json
import pickle
import sys
import types
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from downbeat.perception.clap_features import FrontEnd
from downbeat.tools.errors import ToolError
from downbeat.tools.models_clap import Towers, fused, missing

ARCHITECTURES = {96: "HTSAT-tiny", 128: "HTSAT-base", 256: "HTSAT-large"}
"""By the width of a patch."""
PATCH_KEY = "audio_branch.patch_embed.proj.weight"
FUSION_KEY = "audio_branch.patch_embed.mel_conv2d.weight"
POSITION_IDS_KEY = "text_branch.embeddings.position_ids"
"""A constant that transformers no longer keeps among the weights."""
HEAD_WIDTH = 64
"""Of RoBERTa, whatever its size."""


def laion_towers(checkpoint: Path, tokenizer: str) -> Towers:
    """Load a checkpoint of laion-clap.

    Args:
        checkpoint: .pt as its authors publish, or a state dict of their model.
        tokenizer: Folder or hub id of RoBERTa's tokeniser; a checkpoint holds none.

    Raises:
        ToolError: A package is missing, or this is no unfused HTSAT checkpoint.
    """
    try:
        from transformers import AutoTokenizer
    except ImportError as error:
        raise missing(error) from error
    model, config = laion_model(read_weights(checkpoint), str(checkpoint))
    try:
        words: Any = AutoTokenizer.from_pretrained(tokenizer)
    except (OSError, ValueError) as error:
        raise ToolError(
            f"No tokeniser at {tokenizer} ({str(error).splitlines()[0]}); valid is a folder or hub "
            "id of RoBERTa's, for example --tokenizer roberta-base."
        ) from error
    return Towers(*laion_modules(model), words, _front_end(config), "laion-clap")


def read_weights(checkpoint: Path) -> dict[str, Any]:
    """Return the state dict of a checkpoint; only tensors are read, no code is run.

    Raises:
        ToolError: It cannot be read, or holds something else.
    """
    try:
        import torch
    except ImportError as error:
        raise missing(error) from error
    try:
        content = torch.load(checkpoint, map_location="cpu", weights_only=True)
    except (OSError, RuntimeError, pickle.UnpicklingError, EOFError) as error:
        raise ToolError(
            f"{checkpoint} cannot be read as a checkpoint ({str(error).splitlines()[0]}); valid is "
            "a .pt of laion-clap; if it holds more than tensors, save its state_dict alone."
        ) from error
    weights = content.get("state_dict", content) if isinstance(content, dict) else {}
    weights = {name.removeprefix("module."): value for name, value in weights.items()}
    weights.pop(POSITION_IDS_KEY, None)
    if FUSION_KEY in weights:
        raise fused(str(checkpoint))
    if PATCH_KEY not in weights or len(weights[PATCH_KEY]) not in ARCHITECTURES:
        raise ToolError(
            f"{checkpoint} is no HTSAT checkpoint of laion-clap (no {PATCH_KEY} of width 96, 128 "
            "or 256); for a transformers model give its folder or hub id."
        )
    return weights


def laion_model(weights: Mapping[str, Any], where: str) -> tuple[Any, dict[str, Any]]:
    """Build laion-clap's model for these weights, and load them.

    Returns:
        The model in evaluation mode, and its configuration.

    Raises:
        ToolError: The weights do not fit.
    """
    architecture = ARCHITECTURES[len(weights[PATCH_KEY])]
    model, config = build_model(architecture, _roberta_config(weights, where))
    try:
        model.load_state_dict(dict(weights))
    except RuntimeError as error:
        raise ToolError(f"{where} does not fit {architecture}: {error}") from error
    return model.eval(), config


def build_model(architecture: str, text_config: Any) -> tuple[Any, dict[str, Any]]:
    """Build laion-clap's model with random weights.

    Args:
        architecture: One of `ARCHITECTURES`.
        text_config: A RobertaConfig.

    Returns:
        The model and its configuration.

    Raises:
        ToolError: A package is missing.
    """
    with _laion_code() as (code, folder):
        path = folder / "model_configs" / f"{architecture}.json"
        config = json.loads(path.read_text(encoding="utf-8"))
        config["text_cfg"]["model_type"] = "roberta"
        own = code.RobertaModel
        text = own(text_config)
        # Its constructor asks the hub for RoBERTa; it gets one of the right size.
        code.RobertaModel = types.SimpleNamespace(from_pretrained=lambda _name: text)
        try:
            return code.CLAP(**config), config
        finally:
            code.RobertaModel = own


def laion_modules(model: Any) -> tuple[Any, Any]:
    """Return the towers of laion-clap's model as modules that can be exported."""
    import torch

    class Audio(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.model = model

        def forward(self, picture: Any) -> Any:
            branch = self.model.audio_branch
            picture = branch.bn0(picture.transpose(1, 3)).transpose(1, 3)
            heard = branch.forward_features(branch.reshape_wav2img(picture))["embedding"]
            vector = self.model.audio_projection(heard)
            return torch.nn.functional.normalize(vector, dim=-1)

    class Text(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.model = model

        def forward(self, ids: Any, mask: Any) -> Any:
            read = self.model.text_branch(input_ids=ids, attention_mask=mask)
            vector = self.model.text_projection(read["pooler_output"])
            return torch.nn.functional.normalize(vector, dim=-1)

    return Audio().eval(), Text().eval()


def _front_end(config: Mapping[str, Any]) -> FrontEnd:
    audio = config["audio_cfg"]
    return FrontEnd(
        sample_rate_hz=audio["sample_rate"],
        window=audio["window_size"],
        hop=audio["hop_size"],
        mel_bands=audio["mel_bins"],
        min_hz=float(audio["fmin"]),
        max_hz=float(audio["fmax"]),
        clip_samples=audio["clip_samples"],
        is_quantised=True,
    )


def _roberta_config(weights: Mapping[str, Any], where: str) -> Any:
    """Return the size of the text tower from the shapes of its weights."""
    from transformers import RobertaConfig

    prefix = "text_branch."
    try:
        vocabulary, width = weights[f"{prefix}embeddings.word_embeddings.weight"].shape
        positions = len(weights[f"{prefix}embeddings.position_embeddings.weight"])
        inner = len(weights[f"{prefix}encoder.layer.0.intermediate.dense.weight"])
    except KeyError as error:
        raise ToolError(f"{where} has no RoBERTa text tower ({error} is missing).") from error
    layers = {name.split(".")[3] for name in weights if name.startswith(f"{prefix}encoder.layer.")}
    return RobertaConfig(
        vocab_size=vocabulary, hidden_size=width, intermediate_size=inner,
        num_hidden_layers=len(layers), num_attention_heads=width // HEAD_WIDTH,
        max_position_embeddings=positions, type_vocab_size=1, layer_norm_eps=1e-5,
        attn_implementation="eager",
    )  # fmt: skip


@contextlib.contextmanager
def _laion_code() -> Iterator[tuple[Any, Path]]:
    """Import the package's model code alone; yields its module and folder.

    Its modules call their folder `clap_module` and load everything at import. Two classes of
    torchvision stand in the code and are never used here: empty ones take their place.
    """
    spec = importlib.util.find_spec("laion_clap")
    if spec is None or not spec.submodule_search_locations:
        raise missing(ImportError("laion-clap", name="laion-clap"))
    folder = Path(spec.submodule_search_locations[0]) / "clap_module"
    importlib.import_module("transformers.models.roberta")  # before torchvision looks present
    package = types.ModuleType("clap_module")
    package.__path__ = [str(folder)]
    stand_ins = {"clap_module": package}
    for name in ("torchvision", "torchvision.ops", "torchvision.ops.misc"):
        stand_ins[name] = types.ModuleType(name)
        stand_ins[name].__spec__ = importlib.machinery.ModuleSpec(name, None)
    stand_ins["torchvision.ops.misc"].FrozenBatchNorm2d = type("FrozenBatchNorm2d", (), {})
    before = {name: sys.modules.get(name) for name in stand_ins}
    sys.modules.update(stand_ins)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # old escapes and deprecations of the package
            code = importlib.import_module("clap_module.model")
            yield code, folder
    except ImportError as error:
        raise missing(error) from error
    finally:
        for name in [n for n in sys.modules if n.startswith("clap_module.")]:
            del sys.modules[name]
        for name, module in before.items():
            if module is None:
                sys.modules.pop(name, None)
            else:
                sys.modules[name] = module
