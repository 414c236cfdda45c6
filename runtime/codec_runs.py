"""Cut a layout into runs: stretches of the wire that one `struct` and one gather can move.

A run is everything up to the next string or variable array. Its scalars go through one `struct`,
with the length of a following string as a last item. Its arrays go through one gather: a table
that says, for every byte, where it comes from, so that any mix of element sizes is byte-swapped
and aligned in a single numpy call.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from downbeat.runtime.codec_layout import ITEM_SIZES, Layout, Leaf
from downbeat.runtime.codec_slow import FINGERPRINT_BYTES

Indices = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Block:
    """Arrays of one dtype and one NaN rule that lie side by side in the gathered bytes.

    Attributes:
        code: struct format character.
        nan_ok: Whether NaN is allowed; integers and strict floats: False.
        leaves: The arrays, in wire order.
        start: First byte in the gathered array.
    """

    code: str
    nan_ok: bool
    leaves: tuple[Leaf, ...]
    start: int

    @property
    def count(self) -> int:
        """Items of all arrays together."""
        return sum(leaf.count for leaf in self.leaves)

    @property
    def end(self) -> int:
        """Byte after the last."""
        return self.start + self.count * ITEM_SIZES[self.code]


@dataclass(frozen=True)
class Run:
    """Fixed-size fields, then at most one field of variable size.

    Attributes:
        fixed: Leaves of fixed size in wire order.
        variable: The string or variable array that follows, None at the end.
        is_first: Starts with the fingerprint.
    """

    fixed: tuple[Leaf, ...]
    variable: Leaf | None
    is_first: bool

    @property
    def scalars(self) -> tuple[Leaf, ...]:
        """Leaves that go through `struct`: scalars and fixed byte strings."""
        return tuple(leaf for leaf in self.fixed if leaf.kind in ("scalar", "bytes"))

    @property
    def arrays(self) -> tuple[Leaf, ...]:
        """Leaves that go through the gather."""
        return tuple(leaf for leaf in self.fixed if leaf.kind == "array")

    @property
    def has_text(self) -> bool:
        """Whether a string's length is the last item of the run."""
        return self.variable is not None and self.variable.kind == "string"

    @property
    def size(self) -> int:
        """Bytes on the wire, the string's length included."""
        head = FINGERPRINT_BYTES if self.is_first else 0
        return head + sum(leaf.size for leaf in self.fixed) + (4 if self.has_text else 0)

    def struct_format(self, padded: bool) -> str:
        """Format of the scalars.

        Args:
            padded: Skip the arrays with pad bytes (decode) or leave them out (encode).
        """
        parts = [">", f"{FINGERPRINT_BYTES}s" if self.is_first else ""]
        for leaf in self.fixed:
            if leaf.kind == "array":
                parts.append(f"{leaf.size}x" if padded else "")
            elif leaf.kind == "bytes":
                parts.append(f"{leaf.count}s")
            else:
                parts.append(leaf.code)
        parts.append("I" if self.has_text else "")
        return "".join(parts)

    def blocks(self) -> tuple[Block, ...]:
        """Group the arrays by dtype and NaN rule, widest items first, so that all are aligned."""
        keys = sorted(
            {(leaf.code, leaf.rule.nan_ok) for leaf in self.arrays},
            key=lambda key: (-ITEM_SIZES[key[0]], key),
        )
        blocks: list[Block] = []
        start = 0
        for code, nan_ok in keys:
            leaves = tuple(
                leaf for leaf in self.arrays if (leaf.code, leaf.rule.nan_ok) == (code, nan_ok)
            )
            blocks.append(Block(code, nan_ok, leaves, start))
            start = blocks[-1].end
        return tuple(blocks)

    def decode_gather(self) -> Indices:
        """Wire byte (from the start of the run) of every byte of the gathered arrays."""
        starts = self._wire_starts()
        pieces = [
            _swapped(starts[leaf.path], leaf) for block in self.blocks() for leaf in block.leaves
        ]
        return np.concatenate(pieces).astype(np.intp)

    def encode_gather(self) -> Indices:
        """Byte of (packed scalars + arrays in wire order) of every byte of the run."""
        packed = sum(leaf.size for leaf in self.scalars)
        packed += FINGERPRINT_BYTES if self.is_first else 0
        packed += 4 if self.has_text else 0
        next_scalar = FINGERPRINT_BYTES if self.is_first else 0
        next_array = packed
        pieces = [np.arange(next_scalar)]
        for leaf in self.fixed:
            if leaf.kind == "array":
                pieces.append(_swapped(next_array, leaf))
                next_array += leaf.size
            else:
                pieces.append(np.arange(next_scalar, next_scalar + leaf.size))
                next_scalar += leaf.size
        pieces.append(np.arange(next_scalar, packed))
        return np.concatenate(pieces).astype(np.intp)

    def _wire_starts(self) -> dict[tuple[str, ...], int]:
        starts: dict[tuple[str, ...], int] = {}
        offset = FINGERPRINT_BYTES if self.is_first else 0
        for leaf in self.fixed:
            starts[leaf.path] = offset
            offset += leaf.size
        return starts


def _swapped(start: int, leaf: Leaf) -> npt.NDArray[np.int64]:
    """Byte numbers of an array with the bytes of each item reversed."""
    item = ITEM_SIZES[leaf.code]
    numbers = start + np.arange(leaf.size).reshape(leaf.count, item)[:, ::-1]
    return numbers.reshape(-1).astype(np.int64)


def runs_of(layout: Layout) -> tuple[Run, ...]:
    """Cut a layout into runs; the last one may be empty."""
    runs: list[Run] = []
    fixed: list[Leaf] = []
    for leaf in layout.leaves:
        if leaf.is_variable:
            runs.append(Run(tuple(fixed), leaf, is_first=not runs))
            fixed = []
        else:
            fixed.append(leaf)
    if fixed or not runs:
        runs.append(Run(tuple(fixed), None, is_first=not runs))
    return tuple(runs)
