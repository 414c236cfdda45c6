"""Let the kernel drop LCM channels that a process did not ask for.

LCM hears its whole group and looks at the channel name after the datagram has woken its thread:
500 states a second cost every process on the machine half a percent of a core, the bridge its own
ones too. A socket filter looks before that. It knows names only; what it lets through, LCM judges
as ever. Linux; elsewhere, and if anything is unexpected, everything is let through as before.
"""

from __future__ import annotations

import ctypes
import os
import socket
import struct
from collections.abc import Iterable
from pathlib import Path

SO_ATTACH_FILTER = 26
"""Linux, asm-generic/socket.h; Python does not name it."""
UDP_HEADER = 8
SHORT_MAGIC = 0x4C433032
"""LCM's UDP format: magic, 32-bit number, channel name with its zero, payload. What is longer than
a datagram comes in fragments with another magic and is let through."""
NAME = UDP_HEADER + 8
ALWAYS = ("LCM_SELF_TEST",)
_LOAD_WORD, _LOAD_HALF, _LOAD_BYTE = 0x20, 0x28, 0x30
_JUMP_EQUAL, _RETURN = 0x15, 0x06
_LOADS = {4: (_LOAD_WORD, ">I"), 2: (_LOAD_HALF, ">H"), 1: (_LOAD_BYTE, ">B")}
EVERYTHING = 0xFFFFFFFF

Instruction = tuple[int, int, int, int]


def program(channels: Iterable[str]) -> list[Instruction]:
    """Return classic BPF that keeps these channels, fragments, and LCM's test of itself.

    Args:
        channels: Names, not patterns.

    Returns:
        Instructions (code, jump if true, jump if false, operand).
    """
    code: list[Instruction] = [
        (_LOAD_WORD, 0, 0, UDP_HEADER),
        (_JUMP_EQUAL, 1, 0, SHORT_MAGIC),
        (_RETURN, 0, 0, EVERYTHING),
    ]
    for channel in sorted({*channels, *ALWAYS}):
        code += _keep(channel)
    return [*code, (_RETURN, 0, 0, 0)]


def _keep(channel: str) -> list[Instruction]:
    """Return the block that keeps one name and falls through to the next block otherwise."""
    text = channel.encode("ascii") + b"\0"
    parts = []
    at = 0
    while at < len(text):
        size = next(size for size in (4, 2, 1) if size <= len(text) - at)
        parts.append((at, size))
        at += size
    block: list[Instruction] = []
    for i, (at, size) in enumerate(parts):
        load, form = _LOADS[size]
        (operand,) = struct.unpack(form, text[at : at + size])
        left = 2 * (len(parts) - i - 1) + 1  # instructions until past the block's return
        block += [(load, 0, 0, NAME + at), (_JUMP_EQUAL, 0, left, operand)]
    return [*block, (_RETURN, 0, 0, EVERYTHING)]


def attach(descriptor: int, channels: Iterable[str]) -> bool:
    """Put the filter on a UDP socket, in place of an earlier one.

    Args:
        descriptor: Of the socket; stays the caller's.
        channels: Names to keep.

    Returns:
        Whether the kernel took it.
    """
    code = program(channels)
    packed = b"".join(struct.pack("=HBBI", *instruction) for instruction in code)
    buffer = ctypes.create_string_buffer(packed, len(packed))
    option = struct.pack("@HP", len(code), ctypes.addressof(buffer))
    try:
        with socket.socket(fileno=os.dup(descriptor)) as handle:
            handle.setsockopt(socket.SOL_SOCKET, SO_ATTACH_FILTER, option)
    except OSError:
        return False
    return True


def descriptors() -> set[int]:
    """Return the file descriptors that this process has open; none where nobody tells."""
    try:
        listed = [int(path.name) for path in Path("/proc/self/fd").iterdir()]
    except OSError:
        return set()
    # The listing itself was one of them; its number is free again.
    return {number for number in listed if _is_open(number)}


def _is_open(descriptor: int) -> bool:
    try:
        os.fstat(descriptor)
    except OSError:
        return False
    return True


def bound_to(candidates: Iterable[int], port: int) -> int | None:
    """Return the one UDP socket among descriptors that is bound to a port; None: not exactly one.

    Args:
        candidates: File descriptors; some may be closed by now.
        port: UDP port.
    """
    found = []
    for descriptor in candidates:
        try:
            with socket.socket(fileno=os.dup(descriptor)) as handle:
                is_udp = handle.family == socket.AF_INET and handle.type == socket.SOCK_DGRAM
                if is_udp and handle.getsockname()[1] == port:
                    found.append(descriptor)
        except OSError:
            continue
    return found[0] if len(found) == 1 else None
