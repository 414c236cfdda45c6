"""The G1's hand-held remote, as it lies in LowState: 40 bytes of buttons and sticks."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from downbeat.control.errors import ControlError
from downbeat.runtime.errors import one_of

FRAME_BYTES = 40
BUTTONS = (
    "R1",
    "L1",
    "start",
    "select",
    "R2",
    "L2",
    "F1",
    "F2",
    "A",
    "B",
    "X",
    "Y",
    "up",
    "right",
    "down",
    "left",
)
"""Bit 0 first, of the little-endian word at byte 2."""
_STICKS = struct.Struct("<2xHfff4xf")
_EMPTY = bytes(FRAME_BYTES)


def button_mask(names: tuple[str, ...]) -> int:
    """Return the bits of some buttons.

    Raises:
        ControlError: A name is no button.
    """
    for name in names:
        if name not in BUTTONS:
            raise ControlError(
                f"The remote has no button {name!r}; it has {one_of(BUTTONS)} (bridge settings)."
            )
    return sum(1 << BUTTONS.index(name) for name in names)


def pressed_names(buttons: int) -> tuple[str, ...]:
    """Return the names of the buttons whose bits are set."""
    return tuple(name for bit, name in enumerate(BUTTONS) if buttons >> bit & 1)


def is_silent(frame: bytes) -> bool:
    """Whether a frame is what the robot reports when it does not hear the remote."""
    return frame == _EMPTY


@dataclass(frozen=True, slots=True)
class Remote:
    """One frame.

    Attributes:
        buttons: Bits as in `BUTTONS`.
        left_stick: (x, y), right and forward positive, -1..1.
        right_stick: (x, y).
    """

    buttons: int
    left_stick: tuple[float, float]
    right_stick: tuple[float, float]


def parse_remote(frame: bytes) -> Remote:
    """Read a frame of 40 bytes."""
    buttons, left_x, right_x, right_y, left_y = _STICKS.unpack_from(frame)
    return Remote(buttons, (left_x, left_y), (right_x, right_y))


def buttons_of(frame: bytes) -> int:
    """Return the button bits alone: all that is needed 500 times a second."""
    return frame[2] | frame[3] << 8


def remote_frame(
    pressed: tuple[str, ...] = (),
    left_stick: tuple[float, float] = (0.0, 0.0),
    right_stick: tuple[float, float] = (0.0, 0.0),
) -> bytes:
    """Return the frame of a remote that is switched on: what a simulated robot reports."""
    frame = bytearray(FRAME_BYTES)
    _STICKS.pack_into(frame, 0, button_mask(pressed), left_stick[0], *right_stick, left_stick[1])
    frame[0:2] = b"\x55\x51"
    return bytes(frame)
