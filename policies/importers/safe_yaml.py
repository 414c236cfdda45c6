"""Read the YAML of strangers: data only, bounded, no tag is ever constructed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from downbeat.policies.errors import PolicyError
from downbeat.policies.importers.files import checked_file

MAX_BYTES = 1_000_000
MAX_DEPTH = 20
MAX_NODES = 100_000
"""Counted with every alias written out: a handful of them can unfold to gigabytes."""


class _DataLoader(yaml.SafeLoader):
    """SafeLoader that sees through unknown tags (`!!python/...`) to the plain data under them."""

    depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise yaml.YAMLError(f"it is nested more than {MAX_DEPTH} deep")
        try:
            return super().compose_node(parent, index)  # type: ignore[no-untyped-call]
        finally:
            self.depth -= 1

    def construct_document(self, node: Any) -> Any:
        if _unfolded(node, {}, set()) > MAX_NODES:
            raise yaml.YAMLError(f"it unfolds to more than {MAX_NODES} values")
        return super().construct_document(node)  # type: ignore[no-untyped-call]


def _unfolded(node: Any, known: dict[int, int], open_nodes: set[int]) -> int:
    """Return how many values a node has when its aliases are written out."""
    key = id(node)
    if key in open_nodes:
        raise yaml.YAMLError("a value contains itself")
    if key not in known:
        open_nodes.add(key)
        children: list[Any] = []
        if isinstance(node, yaml.SequenceNode):
            children = node.value
        elif isinstance(node, yaml.MappingNode):
            children = [part for pair in node.value for part in pair]
        known[key] = 1 + sum(_unfolded(child, known, open_nodes) for child in children)
        open_nodes.discard(key)
    return known[key]


def _plain(loader: Any, _suffix: str, node: Any) -> Any:
    if isinstance(node, yaml.MappingNode):
        return loader.construct_mapping(node, deep=True)
    if isinstance(node, yaml.SequenceNode):
        return loader.construct_sequence(node, deep=True)
    return loader.construct_scalar(node)


_DataLoader.add_multi_constructor("", _plain)  # type: ignore[no-untyped-call]


def read_yaml(path: Path, folder: Path | None = None) -> dict[str, Any]:
    """Read a mapping.

    Args:
        path: The file.
        folder: What is imported; None: the file's own folder.

    Raises:
        PolicyError: Missing, outside the folder, too large, not YAML, or not a mapping.
    """
    checked_file(path, path.parent if folder is None else folder, MAX_BYTES)
    try:
        data = yaml.load(path.read_text(encoding="utf-8"), _DataLoader)
    except OSError as error:
        raise PolicyError(f"{path} cannot be read: {error.strerror or error}.") from error
    except (yaml.YAMLError, ValueError, TypeError, OverflowError, RecursionError) as error:
        line = " ".join(str(error).split())
        raise PolicyError(f"{path} is not valid YAML: {line}.") from error
    if not isinstance(data, dict):
        raise PolicyError(f"{path} is not a YAML mapping.")
    return data
