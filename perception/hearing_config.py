"""hearing.toml: how a show hears and what it makes of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from downbeat.perception.conductor_config import ConductorConfig
from downbeat.perception.router import RouterConfig


@dataclass(frozen=True)
class RouterChoice:
    """Which router decides between music, speech and neither.

    Attributes:
        backend: "embedded" needs no download; "ast" needs `model`; "energy" takes all sound for
            music.
        model: ONNX file of `downbeat models export ast`.
        thresholds: Of the rule.
    """

    backend: Literal["embedded", "ast", "energy"] = "embedded"
    model: str = ""
    thresholds: RouterConfig = field(default_factory=RouterConfig)

    def __post_init__(self) -> None:
        if (self.backend == "ast") != bool(self.model):
            raise ValueError(
                f"model = '{self.model}' does not go with backend = '{self.backend}'; a model is "
                "the ONNX file that `downbeat models export ast` makes, for the backend ast alone"
            )


@dataclass(frozen=True)
class LikenessChoice:
    """What finds the most similar track of music that the catalogue lacks.

    Attributes:
        backend: "embedded", "clap" (needs `model`) or "none".
        model: Folder of `downbeat models export clap`.
    """

    backend: Literal["embedded", "clap", "none"] = "embedded"
    model: str = ""

    def __post_init__(self) -> None:
        if (self.backend == "clap") != bool(self.model):
            raise ValueError(
                f"model = '{self.model}' does not go with backend = '{self.backend}'; a model is "
                "the folder that `downbeat models export clap` makes, for the backend clap alone"
            )


@dataclass(frozen=True)
class HearingConfig:
    """Content of hearing.toml.

    Attributes:
        matcher: "alignment" (default) or "constellation", the paper's.
        router: Music, speech or neither.
        likeness: Resemblance of unknown music.
        sections: Whether changes inside unknown music are listened for.
        conductor: What the conductor makes of it.
    """

    matcher: Literal["alignment", "constellation"] = "alignment"
    router: RouterChoice = field(default_factory=RouterChoice)
    likeness: LikenessChoice = field(default_factory=LikenessChoice)
    sections: bool = True
    conductor: ConductorConfig = field(default_factory=ConductorConfig)

    def __post_init__(self) -> None:
        if self.matcher == "constellation" and self.conductor.mode != "chunks":
            raise ValueError(
                "matcher = 'constellation' judges chunks, it does not say from moment to moment "
                "whether a place still fits; it goes with conductor.mode = 'chunks', a lock needs "
                "'alignment'"
            )
