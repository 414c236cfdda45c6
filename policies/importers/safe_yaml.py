"""Read the YAML of strangers: data only, bounded, no tag is ever constructed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from downbeat.policies.errors import PolicyError

MAX_BYTES = 1_000_000
MAX_DEPTH = 20
MAX_NODES = 100_000


class _DataLoader(yaml.SafeLoader):
    """SafeLoader that sees through unknown tags (`!!python/...`) to the plain data under them.

    Aliases are refused: no policy file needs them, and a handful of them can unfold to gigabytes.
    """

    depth = 0
    nodes = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("aliases are not allowed")
        self.depth += 1
        self.nodes += 1
        if self.depth > MAX_DEPTH or self.nodes > MAX_NODES:
            raise yaml.YAMLError("it is nested too deeply or too large")
        try:
            return super().compose_node(parent, index)  # type: ignore[no-untyped-call]
        finally:
            self.depth -= 1


def _plain(loader: Any, _suffix: str, node: Any) -> Any:
    if isinstance(node, yaml.MappingNode):
        return loader.construct_mapping(node, deep=True)
    if isinstance(node, yaml.SequenceNode):
        return loader.construct_sequence(node, deep=True)
    return loader.construct_scalar(node)


_DataLoader.add_multi_constructor("", _plain)  # type: ignore[no-untyped-call]


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a mapping.

    Raises:
        PolicyError: Missing, too large, not YAML, or not a mapping.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise PolicyError(f"{path} is larger than {MAX_BYTES} bytes.")
        data = yaml.load(path.read_text(encoding="utf-8"), _DataLoader)
    except OSError as error:
        raise PolicyError(f"{path} cannot be read: {error.strerror or error}.") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        line = " ".join(str(error).split())
        raise PolicyError(f"{path} is not valid YAML: {line}.") from error
    if not isinstance(data, dict):
        raise PolicyError(f"{path} is not a YAML mapping.")
    return data
