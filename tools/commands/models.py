"""`downbeat models`: learned models of hearing, exported to ONNX once; processes run them so."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class ExportAst:
    """Export an Audio Spectrogram Transformer: what a window of sound is (router `ast`)."""

    source: tyro.conf.Positional[str]
    """Checkpoint folder, or hub id such as MIT/ast-finetuned-audioset-10-10-0.4593."""
    out: Path
    """The ONNX file to write; it carries its front end's numbers and its label groups."""
    seconds: float = 5.0
    """Length of the window it will hear [s]; positions are interpolated to it."""

    def run(self) -> int:
        """Run it; 0 if ONNX Runtime says what torch says."""
        from downbeat.tools.models_ast import export_ast_command

        return export_ast_command(self.source, self.out, self.seconds)


@dataclass(frozen=True)
class ExportClap:
    """Export a CLAP checkpoint: how alike two sounds, or a sound and some words, are."""

    source: tyro.conf.Positional[str]
    """A laion-clap checkpoint (.pt), a folder of a transformers ClapModel, or its hub id."""
    out: Path
    """The folder to write: audio and text towers and what they need."""
    tokenizer: str = "roberta-base"
    """For laion-clap, whose checkpoints hold none: folder or hub id of RoBERTa's tokeniser."""

    def run(self) -> int:
        """Run it; 0 if ONNX Runtime says what torch says."""
        from downbeat.tools.models_clap import export_clap_command

        return export_clap_command(self.source, self.out, self.tokenizer)


@dataclass(frozen=True)
class Models:
    """Learned models of hearing: `export ast` and `export clap` write ONNX once."""

    action: tyro.conf.Positional[Literal["export"]]
    """Export a checkpoint to ONNX (needs the extra `models`: torch and transformers)."""
    what: (
        Annotated[ExportAst, tyro.conf.subcommand("ast")]
        | Annotated[ExportClap, tyro.conf.subcommand("clap")]
    )

    def run(self) -> int:
        """Run the chosen export."""
        return self.what.run()
