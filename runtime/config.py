"""TOML into frozen dataclasses: the types are the schema, and every error says what is valid."""

from __future__ import annotations

import dataclasses
import tomllib
import types
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from downbeat.runtime.errors import DownbeatError, one_of

ConfigT = TypeVar("ConfigT")


class ConfigError(DownbeatError):
    """A configuration that is not valid; the message starts with file:key."""


def load_config(path: Path, cls: type[ConfigT]) -> ConfigT:
    """Read a TOML file into a frozen dataclass.

    Supported field types: bool, int, float, str, Path (relative ones are relative to the file),
    Literal, `X | None`, tuple[X, ...], dict[str, X], and dataclasses of these.

    Args:
        path: The file.
        cls: The dataclass; fields without a default are required.

    Raises:
        ConfigError: No such file, not TOML, an unknown or missing key, or a wrong type.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}.") from error
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path} is not TOML: {error}.") from error
    return config_from(table, cls, str(path), path.parent)


def config_from(
    table: Mapping[str, Any], cls: type[ConfigT], where: str, base_dir: Path | None = None
) -> ConfigT:
    """Build a dataclass from a table.

    Args:
        table: Keys and values.
        cls: The dataclass.
        where: For messages: the file.
        base_dir: What relative paths are relative to; None: left as they are.

    Raises:
        ConfigError: An unknown or missing key, or a wrong type.
    """
    return _Reader(where, base_dir).dataclass(table, cls, "")


def plain(config: Any) -> Any:
    """Turn a configuration into plain JSON values, for the journal's header."""
    if dataclasses.is_dataclass(config) and not isinstance(config, type):
        return {f.name: plain(getattr(config, f.name)) for f in dataclasses.fields(config)}
    if isinstance(config, Mapping):
        return {str(key): plain(value) for key, value in sorted(config.items())}
    if isinstance(config, (tuple, list)):
        return [plain(value) for value in config]
    return str(config) if isinstance(config, Path) else config


class _Reader:
    """Walks a table along the types."""

    def __init__(self, where: str, base_dir: Path | None) -> None:
        self._where = where
        self._base_dir = base_dir

    def _error(self, key: str, problem: str) -> ConfigError:
        return ConfigError(
            f"{self._where}:{key} {problem}." if key else f"{self._where} {problem}."
        )

    def dataclass(self, table: Any, cls: type[ConfigT], key: str) -> ConfigT:
        """Read a table into a dataclass."""
        if not isinstance(table, Mapping):
            raise self._error(key, f"is {table!r}, valid is a table")
        fields = {f.name: f for f in dataclasses.fields(cls) if f.init}  # type: ignore[arg-type]
        for name in table:
            if name not in fields:
                raise self._error(
                    _join(key, name), f"is not known here; known are {one_of(fields)}"
                )
        hints = get_type_hints(cls)
        values: dict[str, Any] = {}
        for name, field in fields.items():
            if name in table:
                values[name] = self.value(table[name], hints[name], _join(key, name))
            elif field.default is field.default_factory is dataclasses.MISSING:
                raise self._error(_join(key, name), f"is missing; it is {_name(hints[name])}")
        try:
            return cls(**values)
        except ValueError as error:
            # A dataclass may check itself in __post_init__.
            raise self._error(key, f"is not valid: {error}") from error

    def value(self, value: Any, hint: Any, key: str) -> Any:
        """Read one value of a type."""
        origin, args = get_origin(hint), get_args(hint)
        if isinstance(hint, type) and dataclasses.is_dataclass(hint):
            return self.dataclass(value, hint, key)
        if origin is Literal:
            if value in args and type(value) in {type(choice) for choice in args}:
                return value
            raise self._error(key, f"is {value!r}, valid is one of {one_of(args)}")
        if origin in (Union, types.UnionType):
            (inner,) = (arg for arg in args if arg is not types.NoneType)
            return self.value(value, inner, key)
        if origin is tuple:
            return self._tuple(value, args, key)
        if origin is dict:
            if not isinstance(value, Mapping):
                raise self._error(key, f"is {value!r}, valid is a table")
            return {
                name: self.value(item, args[1], _join(key, name)) for name, item in value.items()
            }
        return self._scalar(value, hint, key)

    def _tuple(self, value: Any, args: tuple[Any, ...], key: str) -> tuple[Any, ...]:
        if not isinstance(value, list):
            raise self._error(key, f"is {value!r}, valid is a list")
        if args[-1] is Ellipsis:
            args = (args[0],) * len(value)
        if len(value) != len(args):
            raise self._error(key, f"has {len(value)} items, valid is {len(args)}")
        items = zip(value, args, strict=True)
        return tuple(self.value(v, hint, f"{key}[{i}]") for i, (v, hint) in enumerate(items))

    def _scalar(self, value: Any, hint: Any, key: str) -> Any:
        if hint is Path and isinstance(value, str):
            return Path(value) if self._base_dir is None else self._base_dir / value
        if hint is float and type(value) is int:
            return float(value)
        if hint is Any or type(value) is hint:
            return value
        raise self._error(key, f"is {value!r}, valid is {_name(hint)}")


def _join(key: str, name: str) -> str:
    return f"{key}.{name}" if key else name


_NAMES = {bool: "true or false", int: "an integer", float: "a number", str: "text", Path: "a path"}


def _name(hint: Any) -> str:
    if hint in _NAMES:
        return _NAMES[hint]
    if dataclasses.is_dataclass(hint):
        return "a table"
    return "a list" if get_origin(hint) is tuple else str(hint)
