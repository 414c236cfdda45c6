"""An append-only journal: identical runs leave identical bytes.

One JSON object per line. The first is the header (versions, CPU, configuration); records carry the
show's time only, never the wall clock. `downbeat replay --verify` compares records, and the header
says whether two machines can be expected to agree at all.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, BinaryIO

from downbeat.runtime.errors import DownbeatError

JOURNAL_VERSION = 1
VERSIONED_PACKAGES = ("downbeat", "lcm", "mujoco", "numpy", "onnxruntime")
BUFFER_BYTES = 1 << 18

# Sorted keys and fixed separators: the bytes do not depend on how the record was built. Kept,
# because json.dumps with options builds an encoder anew for every record.
_ENCODER = json.JSONEncoder(sort_keys=True, separators=(",", ":"), ensure_ascii=False)


class JournalError(DownbeatError):
    """A journal that cannot be written or read."""


@dataclass(frozen=True, slots=True)
class Journal:
    """A journal read back.

    Attributes:
        header: The first record.
        records: All others, in order.
        is_complete: False if the last line was cut off (it is left out).
    """

    header: dict[str, Any]
    records: list[dict[str, Any]]
    is_complete: bool


def environment() -> dict[str, Any]:
    """Describe what bit-exact results depend on: versions and the CPU, no host name, no date."""
    versions: dict[str, str] = {"python": platform.python_version()}
    for package in VERSIONED_PACKAGES:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            versions[package] = ""
    return {"versions": versions, "cpu": _cpu()}


def _cpu() -> dict[str, Any]:
    found: dict[str, Any] = {"machine": platform.machine(), "model": "", "flags": []}
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return found
    for line in lines:
        key, _, value = line.partition(":")
        if key.strip() == "model name" and not found["model"]:
            found["model"] = value.strip()
        elif key.strip() in ("flags", "Features") and not found["flags"]:
            found["flags"] = sorted(value.split())
    return found


def _line(record: Mapping[str, Any]) -> bytes:
    return _ENCODER.encode(record).encode() + b"\n"


class JournalWriter:
    """Appends records; buffered, so that a record costs microseconds."""

    def __init__(self, path: Path, config: Mapping[str, Any]) -> None:
        """Create the file, replacing an older one, and write the header.

        Args:
            path: The file.
            config: The resolved configuration: plain JSON values.

        Raises:
            JournalError: It cannot be written, or the configuration is not plain JSON.
        """
        header = {"journal": JOURNAL_VERSION, "config": config, **environment()}
        try:
            first = _line(header)
        except (TypeError, ValueError) as error:
            raise JournalError(f"The header of {path} is not plain JSON: {error}.") from error
        try:
            self._file: BinaryIO | None = open(path, "wb", buffering=BUFFER_BYTES)  # noqa: SIM115
        except OSError as error:
            raise JournalError(f"Journal {path} cannot be written: {error}.") from error
        self._file.write(first)
        self.count = 0

    def write(self, record: Mapping[str, Any]) -> None:
        """Append one record: plain JSON values; floats keep all their digits."""
        if self._file is not None:
            self._file.write(_line(record))
            self.count += 1

    def close(self) -> None:
        """Finish the file; later writes are ignored."""
        if self._file is not None:
            self._file.close()
            self._file = None


def iterate_journal(path: Path) -> Iterator[dict[str, Any]]:
    """Yield header and records; stops at a last line that was cut off.

    Raises:
        JournalError: There is no such file, or a line inside it is not a record.
    """
    if not path.is_file():
        raise JournalError(f"There is no journal {path}; a run leaves `journal` in its folder.")
    with path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            if not line.endswith(b"\n"):
                return
            try:
                record = json.loads(line)
            except ValueError as error:
                raise JournalError(f"{path}:{number} is not a journal record: {error}.") from error
            if not isinstance(record, dict):
                raise JournalError(f"{path}:{number} is not a journal record: not an object.")
            yield record


def read_journal(path: Path) -> Journal:
    """Read a whole journal.

    Raises:
        JournalError: It is not one, or of another version.
    """
    lines = list(iterate_journal(path))
    if not lines or lines[0].get("journal") != JOURNAL_VERSION:
        raise JournalError(
            f"{path} does not start with the header of a version {JOURNAL_VERSION} journal."
        )
    data = path.read_bytes()
    return Journal(lines[0], lines[1:], is_complete=data.endswith(b"\n"))
