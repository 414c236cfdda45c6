"""Our codec for the generated LCM classes: same bytes, faster, and it checks what it decodes.

lcm-gen's decoders accept NaN, trailing bytes and any enumeration value, and slow down fourfold on
numpy arrays. Here every payload is checked for fingerprint, exact length, finite values, ranges and
declared constants; arrays are numpy arrays in both directions.
"""

from __future__ import annotations

import struct
from functools import cache
from typing import Any

from downbeat.runtime.codec_compile import IS_SUPPORTED_MACHINE, compile_decode, compile_encode
from downbeat.runtime.codec_layout import LayoutError, layout_of
from downbeat.runtime.codec_slow import CodecError, decode_slow, encode_slow

__all__ = ["Codec", "CodecError", "LayoutError", "codec_for"]

_EXPECTED = (
    AttributeError,
    BufferError,
    IndexError,
    OverflowError,
    TypeError,
    ValueError,
    struct.error,
)
"""What the compiled functions raise on input they were not made for."""


class _BadPayloadError(Exception):
    """Leaves the compiled decode; the slow one then names the field."""


def _bad() -> None:
    raise _BadPayloadError


class Codec:
    """Encodes and decodes one generated class; get it from `codec_for`.

    Attributes:
        type: The generated class.
        name: Its name.
        source: Text of the two compiled functions.
    """

    def __init__(self, cls: Any) -> None:
        if not IS_SUPPORTED_MACHINE:
            raise LayoutError("The codec needs a little-endian machine, and this one is not.")
        self._layout = layout_of(cls)
        self.type = cls
        self.name = self._layout.name
        self._encode, encode_source = compile_encode(self._layout, self._encode_slow)
        self._decode, decode_source = compile_decode(self._layout, _bad)
        leaves = self._layout.leaves
        is_fixed = not any(leaf.is_variable for leaf in leaves)
        self._length = 8 + sum(leaf.size for leaf in leaves) if is_fixed else None
        self.source = encode_source + "\n\n" + decode_source

    def encode(self, msg: Any) -> bytes:
        """Encode, byte for byte as lcm-gen does.

        Args:
            msg: An instance of the generated class. Arrays may be numpy arrays, lists or tuples;
                numpy arrays of the wire's own dtype are the fast case.

        Raises:
            CodecError: A field has the wrong type or length.
        """
        try:
            return self._encode(msg)
        except _EXPECTED:
            return self._encode_slow(msg)

    def looks_valid(self, payload: bytes) -> bool:
        """Whether a payload has this type's fingerprint and, if that is fixed, its length.

        No value is looked at: for messages that may be overtaken before anybody wants them.
        """
        if self._length is not None and len(payload) != self._length:
            return False
        return payload[:8] == self._layout.fingerprint

    def decode(self, payload: bytes, channel: str = "") -> Any:
        """Decode and check.

        Args:
            payload: The whole message.
            channel: For the error's text; the type's name if empty.

        Returns:
            An instance of the generated class. Fixed and variable arrays of numbers are native
            numpy arrays, own copies; byte arrays are bytes; scalars are Python numbers.

        Raises:
            CodecError: Wrong fingerprint or length, a value that is not finite or outside its
                range, an undeclared constant, bad text.
        """
        try:
            return self._decode(payload)
        except (_BadPayloadError, *_EXPECTED):
            decode_slow(self._layout, payload, channel or self.name)
        raise CodecError(channel or self.name, "", type(payload).__name__, "bytes")

    def _encode_slow(self, msg: Any) -> bytes:
        return encode_slow(self._layout, msg)


@cache
def codec_for(cls: Any) -> Codec:
    """Return the codec of a generated class, compiled once.

    Raises:
        LayoutError: The class uses something that the codec does not support.
    """
    return Codec(cls)
