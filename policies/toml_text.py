"""Write the few TOML shapes that manifests use; the standard library only reads TOML."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

INLINE_WIDTH = 100


def _scalar(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        text = f"{value:.10g}"
        text = text if float(text) == value else repr(value)
        return text if any(c in text for c in ".en") else text + ".0"
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
        return f'"{escaped}"'
    raise TypeError(f"toml_text writes bool, int, float and str, not {type(value).__name__}.")


def _value(value: object) -> str:
    if not isinstance(value, Sequence) or isinstance(value, str):
        return _scalar(value)
    items = [_scalar(item) for item in value]
    line = "[" + ", ".join(items) + "]"
    if len(line) <= INLINE_WIDTH:
        return line
    return "[\n" + "".join(f"  {item},\n" for item in items) + "]"


def _is_table_list(value: object) -> bool:
    return isinstance(value, Sequence) and bool(value) and isinstance(value[0], Mapping)


def _lines(table: Mapping[str, Any], path: str) -> list[str]:
    lines = [
        f"{key} = {_value(value)}"
        for key, value in table.items()
        if not isinstance(value, Mapping) and not _is_table_list(value)
    ]
    for key, value in table.items():
        inner = f"{path}.{key}" if path else key
        if isinstance(value, Mapping):
            lines += ["", f"[{inner}]", *_lines(value, inner)]
        elif _is_table_list(value):
            for item in value:
                lines += ["", f"[[{inner}]]", *_lines(item, inner)]
    return lines


def to_toml(table: Mapping[str, Any]) -> str:
    """Return `table` as TOML text.

    Values are str, int, float, bool, lists of those, nested tables and lists of tables.
    """
    return "\n".join(_lines(table, "")) + "\n"


def write_toml(path: Path, table: Mapping[str, Any]) -> None:
    """Write `table` to a file in one go: a reader sees the old or the new text, never half."""
    draft = path.with_suffix(".draft")
    draft.write_text(to_toml(table), encoding="utf-8")
    os.replace(draft, path)
