"""Which router hears: by name, with whatever it needs loaded."""

from __future__ import annotations

from pathlib import Path

from downbeat.perception.errors import PerceptionError
from downbeat.perception.router import RouterConfig
from downbeat.perception.router_ast import AstModel, AstRouter
from downbeat.perception.router_embedded import EmbeddedRouter
from downbeat.perception.vad import Vad

ROUTERS = ("embedded", "ast")


def make_router(
    name: str = "embedded", model: Path | None = None, config: RouterConfig | None = None
) -> EmbeddedRouter | AstRouter:
    """Load a router; where there is no voice activity detector it does without.

    Args:
        name: "embedded" or "ast".
        model: For "ast": what `downbeat models export ast` wrote.
        config: Thresholds.

    Raises:
        PerceptionError: There is no such router, or its model cannot be loaded.
    """
    if name not in ROUTERS:
        raise PerceptionError(
            f"There is no router {name!r}; valid are {', '.join(ROUTERS)} (router)."
        )
    try:
        vad: Vad | None = Vad()
    except PerceptionError:  # the package is optional: the network then decides alone
        vad = None
    if name == "embedded":
        return EmbeddedRouter(config, vad)
    if model is None:
        raise PerceptionError(
            "The router `ast` needs a model; `downbeat models export ast SOURCE --out FILE` writes "
            "it, and the router's model setting names it."
        )
    return AstRouter(AstModel(model), config, vad)
