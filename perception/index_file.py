"""The index on disk: one file, mapped into memory, so that a query reads what it needs.

Layout: head (64 bytes: magic, version, fingerprint of the feature constants, place of the table),
sections (arrays, each from a multiple of 64 bytes), table (JSON: tracks, sections, checksums).
Every byte is under a checksum. The features of a large index are checked track by track when first
touched, everything else when it is opened: a robot does not read gigabytes before it hears.
"""

from __future__ import annotations

import json
import mmap
import os
import struct
import zlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from downbeat.perception import codes as cd
from downbeat.perception import features as ft
from downbeat.perception import index as ix
from downbeat.perception import landmarks as lm
from downbeat.perception.candidates import MAX_SCANNED_TRACKS
from downbeat.perception.codes import CodeTable, make_code_table
from downbeat.perception.errors import PerceptionError
from downbeat.perception.index import Array, Index, Parts
from downbeat.perception.passages import Passage

MAGIC = b"downbeat index\n\x1a"
VERSION = 3
"""1 and 2 were .npz files."""
HEAD = struct.Struct("<16sIIQQQI12s")  # magic, version, features, table at, its length, file, crc
TABLE_CRC = struct.Struct("<I8x")
ALIGN = 64
EAGER_BYTES = 256 << 20
"""Features up to this size are checked when the file is opened: 11 ms per 75 MB."""
REMEDY = "`downbeat catalog build` makes one"

NO_CODES = CodeTable(np.zeros(0, np.uint32), np.zeros(0, np.uint32))


def features_fingerprint() -> int:
    """Return a number that changes when features or landmarks would."""
    constants = [
        *(getattr(ft, name) for name in sorted(vars(ft)) if name.isupper() and name != "F32"),
        ix.PAD_FRAMES, ix.QUANTUM, ix.COARSE_FRAMES, ix.COARSE_BANDS, lm.CONSTANTS, cd.CONSTANTS,
    ]  # fmt: skip
    return zlib.crc32(repr(constants).encode())


class CheckedParts(Parts):
    """Parts of one mapped array, each held against its checksum when it is first asked for."""

    def __init__(
        self, whole: Array, lengths: Sequence[int], checks: Sequence[int], path: Path
    ) -> None:
        """Take the array, rows and checksum of each track, and the file, for the error."""
        super().__init__(whole, lengths)
        self._checks, self._path = checks, path
        self._is_good = bytearray(len(lengths))

    def __getitem__(self, number: Any) -> Any:
        """Return the rows of a track.

        Raises:
            PerceptionError: They are damaged.
        """
        part = super().__getitem__(number)
        if not isinstance(number, slice) and not self._is_good[number]:
            if zlib.crc32(part) != self._checks[number]:
                raise PerceptionError(
                    f"Track number {number} of {self._path} is damaged; {REMEDY}."
                )
            self._is_good[number] = 1
        return part


def write_index(index: Index, path: Path) -> None:
    """Write an index beside its place, then move it there.

    Raises:
        PerceptionError: It holds no track, or cannot be written there.
    """
    if not index.names:
        raise PerceptionError(f"Index {path} would hold no track; `add` at least one.")
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with temporary.open("wb") as file:
            _write(index, file)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        raise PerceptionError(f"Index {path} cannot be written: {error.strerror}.") from error
    finally:
        temporary.unlink(missing_ok=True)


def _write(index: Index, file: BinaryIO) -> None:
    file.write(bytes(HEAD.size))
    landmarks = index.all_landmarks()
    is_large = len(index.names) > MAX_SCANNED_TRACKS
    codes = (index.codes or make_code_table(index.coarse)) if is_large else NO_CODES
    sections: dict[str, list[Any]] = {}
    frames = [len(fine) for fine in index.fine]
    shape = (sum(frames), ft.NUM_BANDS)
    sections["fine"], checks = _write_section(file, index.fine, "<i1", shape)
    for name, parts, kind, columns in (
        ("power", index.power, "<i4", ()),
        ("coarse", index.coarse, "<i1", (ft.NUM_BANDS // ix.COARSE_BANDS,)),
        ("landmarks", landmarks, "<u4", (2,)),
        ("code_starts", [codes.starts], "<u4", ()),
        ("code_places", [codes.places], "<u4", ()),
    ):
        shape = (sum(len(part) for part in parts), *columns)
        sections[name], _ = _write_section(file, parts, kind, shape)
    counts = [len(found) for found in landmarks]
    tracks = [list(row) for row in zip(index.names, index.sources, frames, counts, checks)]
    whole = {"tracks": tracks, "sections": sections}
    if index.shared is not None:
        number = {name: k for k, name in enumerate(index.names)}
        whole["shared"] = [
            [number[p.one], p.one_s, number[p.other], p.other_s, p.seconds] for p in index.shared
        ]
    table = json.dumps(whole, ensure_ascii=False).encode()
    at = file.tell()
    file.write(table)
    head = HEAD.pack(
        MAGIC, VERSION, features_fingerprint(), at, len(table), at + len(table),
        zlib.crc32(table), bytes(12),
    )  # fmt: skip
    file.seek(0)
    file.write(head[:-12] + TABLE_CRC.pack(zlib.crc32(head[:-12])))


def _write_section(
    file: BinaryIO, parts: Iterable[Array], kind: str, shape: tuple[int, ...]
) -> tuple[list[Any], list[int]]:
    """Write arrays one after the other; return the row of the table, and a checksum of each."""
    at, whole, checks = file.tell(), 0, []
    for part in parts:
        data = np.ascontiguousarray(part, kind)
        checks.append(zlib.crc32(data))
        whole = zlib.crc32(data, whole)
        file.write(data.data)
    file.write(bytes(-file.tell() % ALIGN))
    return [at, kind, list(shape), whole], checks


def read_index(path: Path) -> Index:
    """Map an index into memory.

    Raises:
        PerceptionError: The file is missing, foreign, of another version or damaged.
    """
    if not path.is_file():
        raise PerceptionError(f"Index {path} does not exist; {REMEDY}.")
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) if size else b""
    except OSError as error:
        raise PerceptionError(f"Index {path} cannot be read: {error.strerror}.") from error
    table = _read_table(data, path)
    try:
        return _map(data, table, path)
    except (ValueError, KeyError, TypeError, IndexError, OverflowError) as error:
        raise _damaged(path) from error


def _read_table(data: mmap.mmap | bytes, path: Path) -> dict[str, Any]:
    """Return the table of a file that is one of ours and whole."""
    if data[:2] == b"PK":
        raise PerceptionError(f"{path} is an index of an older version; {REMEDY}.")
    if data[: len(MAGIC)] != MAGIC:
        raise PerceptionError(f"{path} is not an index of Downbeat; {REMEDY}.")
    if len(data) < HEAD.size:
        raise _damaged(path)
    _, version, features, at, length, size, check, tail = HEAD.unpack(data[: HEAD.size])
    if zlib.crc32(data[: HEAD.size - 12]) != TABLE_CRC.unpack(tail)[0] or any(tail[4:]):
        raise _damaged(path)
    if version != VERSION:
        raise PerceptionError(f"{path} is an index of version {version}, not {VERSION}; {REMEDY}.")
    if features != features_fingerprint():
        raise PerceptionError(f"{path} was made with other features than today's; {REMEDY}.")
    table = data[at : at + length]
    if size != len(data) or zlib.crc32(table) != check:
        raise _damaged(path)
    found = json.loads(table)
    return dict(found)


def _map(data: mmap.mmap | bytes, table: dict[str, Any], path: Path) -> Index:
    sections: dict[str, Array] = {}
    for name, (at, kind, shape, check) in table["sections"].items():
        count = int(np.prod(shape, dtype=np.int64))
        part = np.frombuffer(data, kind, count, at).reshape(shape)
        stop = at + part.nbytes
        is_lazy = name == "fine" and part.nbytes > EAGER_BYTES
        if not is_lazy and zlib.crc32(part) != check or any(data[stop : stop + -stop % ALIGN]):
            raise _damaged(path)
        sections[name] = part
    names, sources, frames, counts, checks = (list(column) for column in zip(*table["tracks"]))
    is_lazy = sections["fine"].nbytes > EAGER_BYTES
    codes = CodeTable(sections["code_starts"], sections["code_places"])
    return Index(
        names,
        CheckedParts(sections["fine"], frames, checks, path)
        if is_lazy
        else Parts(sections["fine"], frames),
        Parts(sections["coarse"], [n // ix.FINE_PER_COARSE for n in frames]),
        Parts(sections["power"], frames),
        sources,
        Parts(sections["landmarks"], counts),
        codes if len(codes.starts) else None,
        _shared(table, names),
    )


def _shared(table: dict[str, Any], names: Sequence[str]) -> tuple[Passage, ...] | None:
    """Return what tracks share; None of an index that was made before anybody looked."""
    if "shared" not in table:
        return None
    return tuple(
        Passage(names[one], one_s, names[other], other_s, seconds)
        for one, one_s, other, other_s, seconds in table["shared"]
    )


def _damaged(path: Path) -> PerceptionError:
    return PerceptionError(f"{path} is damaged; {REMEDY}.")
