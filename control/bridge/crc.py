"""The checksum of LowCmd and LowState: CRC-32 over the words of a C struct.

Polynomial 0x04C11DB7, start 0xFFFFFFFF, most significant bit first in each 32-bit word, nothing
reflected, no final xor. That is the ordinary CRC-32 of the words with their bits reversed, read
backwards: `zlib.crc32` does in microseconds what a table in Python does in 0.2 ms.
"""

from __future__ import annotations

import zlib

import numpy as np

_REVERSED = bytes(int(f"{value:08b}"[::-1], 2) for value in range(256))
"""Every byte with its bits in the other order."""


def crc32_words(image: bytes) -> int:
    """Return the checksum of a struct image.

    Args:
        image: Little-endian 32-bit words, without the checksum itself; its length is a multiple
            of 4.
    """
    words = np.frombuffer(image.translate(_REVERSED), np.uint32).byteswap()
    plain = zlib.crc32(words.data) ^ 0xFFFFFFFF
    return int.from_bytes(plain.to_bytes(4, "little").translate(_REVERSED), "big")
