"""`downbeat models export ast`: a checkpoint of transformers becomes one ONNX file, checked."""

from __future__ import annotations

import importlib
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from downbeat.perception.features import F32
from downbeat.perception.router import SAMPLE_RATE_HZ
from downbeat.perception.router_ast import (
    FRAME,
    HOP,
    METADATA_KEY,
    AstFront,
    AstModel,
    audioset_groups,
)
from downbeat.tools.errors import ToolError

TOLERANCE = 1e-4
OPSET = 17
SECONDS = (1.0, 10.24)


def export_ast_command(source: str, out: Path, seconds: float) -> int:
    """`downbeat models export ast`."""
    worst, front = export_ast(source, out, seconds)
    print(f"window {front.seconds:.2f} s, {front.frames} frames of {front.num_mels} mel bands")
    print(f"labels: {len(front.music)} are music (singing too), {len(front.speech)} are speech")
    print(f"largest difference to torch on noise and tones: {worst:.2g}")
    print(f"written: {out}")
    return 0


def export_ast(source: str, out: Path, seconds: float) -> tuple[float, AstFront]:
    """Export and compare.

    Args:
        source: Folder of a checkpoint (config.json, model.safetensors, preprocessor_config.json),
            or a hub id.
        out: The file to write.
        seconds: Length of the window; never more than the checkpoint's own.

    Returns:
        The largest difference of a logit between torch and ONNX Runtime; what stands in the file.

    Raises:
        ToolError: torch or transformers is missing, the source is no such checkpoint, its labels
            are not AudioSet's, or the two do not agree.
    """
    torch, transformers = _libraries()
    if not SECONDS[0] <= seconds <= SECONDS[1]:
        raise ToolError(
            f"A window of {seconds:g} s cannot be exported; valid is {SECONDS[0]:g} to "
            f"{SECONDS[1]:g} s (--seconds)."
        )
    try:
        model = transformers.ASTForAudioClassification.from_pretrained(source).eval()
        extractor = transformers.ASTFeatureExtractor.from_pretrained(source)
    except (OSError, ValueError) as error:
        raise ToolError(
            f"{source} holds no Audio Spectrogram Transformer ({str(error).splitlines()[0]}); "
            "valid is a folder with config.json, model.safetensors and preprocessor_config.json, "
            "or a hub id that can be reached."
        ) from error
    if extractor.sampling_rate != SAMPLE_RATE_HZ:
        raise ToolError(
            f"{source} hears {extractor.sampling_rate} Hz; valid is {SAMPLE_RATE_HZ} Hz."
        )
    front = make_front(model.config, extractor, seconds, source)
    shorten(model, front.frames, torch)
    draft = out.with_name(f".{out.name}.draft")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        draft.write_bytes(to_onnx(model, front, torch))
        worst = largest_difference(model, AstModel(draft), torch)
        if not worst <= TOLERANCE:
            raise ToolError(
                f"{source} exported differs from torch by {worst:.2g}; at most {TOLERANCE:g} is "
                "valid; nothing was written."
            )
        os.replace(draft, out)
    except OSError as error:
        raise ToolError(f"{out} cannot be written: {error.strerror or error}.") from error
    finally:
        draft.unlink(missing_ok=True)
    return worst, front


def _libraries() -> tuple[Any, Any]:
    try:
        return importlib.import_module("torch"), importlib.import_module("transformers")
    except ImportError as error:
        raise ToolError(
            f"Exporting needs torch and transformers, and {error.name} is not installed; "
            "`pip install torch transformers` brings them (only for the export)."
        ) from error


def make_front(config: Any, extractor: Any, seconds: float, source: str) -> AstFront:
    """Return what goes into the file beside the network.

    Raises:
        ToolError: The labels are not those of AudioSet, in their order.
    """
    music, speech, names = audioset_groups()
    labels = {int(index): str(name) for index, name in config.id2label.items()}
    named = any(not name.startswith("LABEL_") for name in labels.values())
    for index, name in names.items():
        if index >= len(labels) or (named and labels[index].lower() != name.lower()):
            raise ToolError(
                f"Label {index} of {source} is {labels.get(index)!r}, in AudioSet it is {name!r}; "
                "valid is a checkpoint of AudioSet's 527 labels in their order."
            )
    frames = 1 + (round(seconds * SAMPLE_RATE_HZ) - FRAME) // HOP
    return AstFront(
        num_mels=int(config.num_mel_bins),
        frames=min(frames, int(config.max_length)),
        mean=float(extractor.mean),
        spread=2.0 * float(extractor.std),
        music=music,
        speech=speech,
        source=Path(source).name,
    )


def shorten(model: Any, frames: int, torch: Any) -> None:
    """Fit a model to a shorter input: its positions in time are interpolated."""
    embeddings = model.audio_spectrogram_transformer.embeddings
    bands, long = embeddings.get_shape(model.config)
    short = (frames - model.config.patch_size) // model.config.time_stride + 1
    model.config.max_length = frames
    if short == long:
        return
    old = embeddings.position_embeddings.data  # (1, 2 + bands * long, d)
    grid = old[:, 2:].reshape(1, bands, long, -1).permute(0, 3, 1, 2)
    fitted = torch.nn.functional.interpolate(
        grid, size=(bands, short), mode="bilinear", align_corners=False
    )
    patches = fitted.permute(0, 2, 3, 1).reshape(1, bands * short, -1)
    embeddings.position_embeddings = torch.nn.Parameter(torch.cat((old[:, :2], patches), dim=1))


def to_onnx(model: Any, front: AstFront, torch: Any) -> bytes:
    """Return the network with its metadata as the bytes of an ONNX file."""
    import onnx

    class Logits(torch.nn.Module):  # type: ignore[misc, name-defined]
        """The logits alone: an exporter has no use for a dictionary of outputs."""

        def __init__(self) -> None:
            super().__init__()
            self.model = model

        def forward(self, input_values: Any) -> Any:
            """Return (1, labels)."""
            return self.model(input_values).logits

    example = torch.zeros(1, front.frames, front.num_mels)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "ast.onnx"
        torch.onnx.export(
            Logits(), (example,), str(file), input_names=["input_values"],
            output_names=["logits"], opset_version=OPSET, dynamo=False,
        )  # fmt: skip
        made = onnx.load(str(file))
    onnx.helper.set_model_props(made, {METADATA_KEY: front.as_json()})
    return bytes(made.SerializeToString())


def largest_difference(model: Any, exported: AstModel, torch: Any, seed: int = 0) -> float:
    """Return the largest difference of a logit over sounds that are noise, tones and nothing."""
    worst = 0.0
    for samples in _sounds(exported.front.seconds, seed):
        with torch.no_grad():
            wanted = model(torch.from_numpy(exported.front.prepare(samples))).logits[0].numpy()
        difference = float(np.abs(exported.logits(samples) - wanted).max())
        worst = difference if not difference <= worst else worst  # a NaN stays
    return worst


def _sounds(seconds: float, seed: int) -> list[F32]:
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ
    sounds = (
        0.1 * rng.standard_normal(len(t)),
        0.2 * np.sin(2 * np.pi * 440.0 * t) + 0.001 * rng.standard_normal(len(t)),
        np.zeros(len(t)),
        0.1 * rng.standard_normal(len(t) // 2),
    )
    return [s.astype(np.float32) for s in sounds]
