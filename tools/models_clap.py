"""`downbeat models export clap`: both towers of a CLAP as ONNX, checked against torch.

Of a transformers ClapModel everything comes out of its folder. A laion-clap checkpoint holds
weights alone: tools/models_clap_laion.py finds the architecture in their shapes.
"""

from __future__ import annotations

import shutil
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from downbeat.perception.clap_features import FrontEnd
from downbeat.perception.clap_model import (
    AUDIO_NAME,
    HEADER_NAME,
    MAX_TOKENS,
    TEXT_NAME,
    TOKENIZER_NAME,
    write_header,
)
from downbeat.perception.features import F32
from downbeat.tools.errors import ToolError

TOLERANCE = 1e-4
OPSET = 18
CHECKPOINT_SUFFIXES = (".pt", ".pth")


@dataclass(frozen=True)
class Towers:
    """What every checkpoint is reduced to.

    Attributes:
        audio: torch module, picture (1, 1, frames, bands) -> unit vector (1, dim).
        text: torch module, ids and mask (1, MAX_TOKENS) int64 -> unit vector (1, dim).
        tokenizer: Has `save_pretrained`.
        front: The picture.
        family: "laion-clap" or "transformers".
    """

    audio: Any
    text: Any
    tokenizer: Any
    front: FrontEnd
    family: str


def export_clap_command(source: str, out: Path, tokenizer: str) -> int:
    """`downbeat models export clap`."""
    if Path(source).suffix in CHECKPOINT_SUFFIXES:
        from downbeat.tools.models_clap_laion import laion_towers

        towers = laion_towers(Path(source), tokenizer)
    else:
        towers = transformers_towers(source)
    worst = export_towers(towers, out, source)
    print(f"largest difference between torch and ONNX Runtime: {worst:.2g} (at most {TOLERANCE:g})")
    print(f"written: {out} ({towers.family})")
    return 0


def transformers_towers(source: str) -> Towers:
    """Load a ClapModel with its feature extractor and tokeniser.

    Args:
        source: Folder or hub id.

    Raises:
        ToolError: A package is missing, or this is no unfused ClapModel.
    """
    try:
        from transformers import AutoTokenizer, ClapFeatureExtractor, ClapModel
    except ImportError as error:
        raise missing(error) from error
    try:
        model: Any = ClapModel.from_pretrained(source, attn_implementation="eager")
        extractor: Any = ClapFeatureExtractor.from_pretrained(source)
        tokenizer: Any = AutoTokenizer.from_pretrained(source)
    except (OSError, ValueError, KeyError) as error:
        raise ToolError(
            f"{source} cannot be loaded as a ClapModel ({str(error).splitlines()[0]}); valid are a "
            "folder with config.json, weights, preprocessor_config.json and the tokeniser, a hub "
            "id such as laion/clap-htsat-unfused, or a laion-clap checkpoint (.pt)."
        ) from error
    if model.config.audio_config.enable_fusion:
        raise fused(source)
    return Towers(*clap_modules(model.eval()), tokenizer, front_end_of(extractor), "transformers")


def clap_modules(model: Any) -> tuple[Any, Any]:
    """Return the towers of a ClapModel as modules that can be exported."""
    import torch

    class Audio(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.model = model

        def forward(self, picture: Any) -> Any:
            return self.model.get_audio_features(picture).pooler_output

    class Text(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.model = model

        def forward(self, ids: Any, mask: Any) -> Any:
            return self.model.get_text_features(ids, mask).pooler_output

    return Audio().eval(), Text().eval()


def front_end_of(extractor: Any) -> FrontEnd:
    """Return the picture that a ClapFeatureExtractor makes."""
    return FrontEnd(
        sample_rate_hz=int(extractor.sampling_rate),
        window=int(extractor.fft_window_size),
        hop=int(extractor.hop_length),
        mel_bands=int(extractor.feature_size),
        min_hz=float(extractor.frequency_min),
        max_hz=float(extractor.frequency_max),
        clip_samples=int(extractor.nb_max_samples),
    )


def export_towers(towers: Towers, out: Path, source: str) -> float:
    """Write the folder if ONNX Runtime says what torch says.

    Returns:
        The largest difference of a component of a unit vector.

    Raises:
        ToolError: They differ by more than 1e-4, or the folder cannot be written.
    """
    import torch

    if out.exists() and not (out / HEADER_NAME).is_file():
        raise ToolError(f"{out} exists and is no exported CLAP; name a new folder (--out).")
    ids, mask = torch.full((1, MAX_TOKENS), 5), torch.ones((1, MAX_TOKENS), dtype=torch.int64)
    picture = torch.from_numpy(_random_picture(towers.front, 0))
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        draft = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
    except OSError as error:
        raise ToolError(f"{out} cannot be written: {error.strerror or error}.") from error
    try:
        _to_onnx(towers.audio, (picture,), draft / AUDIO_NAME, ["picture"])
        _to_onnx(towers.text, (ids, mask), draft / TEXT_NAME, ["ids", "mask"])
        _save_tokenizer(towers.tokenizer, draft)
        write_header(draft, source, towers.family, towers.front)
        worst = largest_difference(towers, draft)
        if not worst <= TOLERANCE:
            raise ToolError(
                f"{source} exported differs from the original by {worst:.2g}; at most "
                f"{TOLERANCE:g} is valid; nothing was written."
            )
        if out.exists():
            shutil.rmtree(out)
        draft.rename(out)
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    return worst


def largest_difference(towers: Towers, folder: Path, seed: int = 1) -> float:
    """Return how far torch and ONNX Runtime are apart on random pictures and texts."""
    import onnxruntime
    import torch

    rng = np.random.default_rng(seed)
    audio, text = (
        onnxruntime.InferenceSession(str(folder / name), providers=["CPUExecutionProvider"])
        for name in (AUDIO_NAME, TEXT_NAME)
    )
    worst = 0.0
    for number in range(3):
        picture = _random_picture(towers.front, seed + number)
        ids = rng.integers(3, 200, (1, MAX_TOKENS))
        mask = np.ones((1, MAX_TOKENS), np.int64)
        length = int(rng.integers(3, MAX_TOKENS))
        ids[0, length:], mask[0, length:] = 1, 0  # as a text of that length is padded
        with torch.no_grad():
            wanted = [
                towers.audio(torch.from_numpy(picture)).numpy(),
                towers.text(torch.from_numpy(ids), torch.from_numpy(mask)).numpy(),
            ]
        found = [
            audio.run(None, {"picture": picture})[0],
            text.run(None, {"ids": ids, "mask": mask})[0],
        ]
        for one, other in zip(wanted, found, strict=True):
            difference = float(np.abs(one - other).max())
            worst = difference if not difference <= worst else worst  # a NaN stays
    return worst


def missing(error: ImportError) -> ToolError:
    """Return the error of a package that only exporting needs."""
    return ToolError(
        f"Exporting CLAP needs the package {error.name}, which is not installed; "
        "`pip install 'downbeat[models]'` brings torch and transformers, and "
        "`pip install --no-deps -r requirements-clap.txt` what laion-clap checkpoints need."
    )


def fused(source: str) -> ToolError:
    """Return the error of a checkpoint with feature fusion."""
    return ToolError(
        f"{source} is a fused CLAP, made for sound longer than ten seconds; valid are unfused "
        "ones, such as laion/clap-htsat-unfused, or 630k-audioset-best.pt of laion-clap."
    )


def _random_picture(front: FrontEnd, seed: int) -> F32:
    """Return decibels that vary as music does, (1, 1, frames, bands)."""
    rng = np.random.default_rng(seed)
    shape = (1, 1, front.frames, front.mel_bands)
    return (rng.normal(size=shape) * 15.0 - 30.0).astype(np.float32)


def _to_onnx(module: Any, inputs: tuple[Any, ...], path: Path, names: list[str]) -> None:
    import torch

    with warnings.catch_warnings(), torch.no_grad():
        # Tracing warns of every shape that becomes a constant: all shapes are fixed here.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            module, inputs, str(path), input_names=names, output_names=["vector"],
            opset_version=OPSET, dynamo=False,
        )  # fmt: skip


def _save_tokenizer(tokenizer: Any, folder: Path) -> None:
    tokenizer.save_pretrained(str(folder))
    if not (folder / TOKENIZER_NAME).is_file():
        raise ToolError(
            f"The tokeniser wrote no {TOKENIZER_NAME}; a fast RoBERTa tokeniser is expected."
        )
    for path in folder.iterdir():
        if path.name not in (AUDIO_NAME, TEXT_NAME, TOKENIZER_NAME):
            path.unlink()
