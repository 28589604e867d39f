"""Tables of numbers as decimal text, fast: digits are laid out by array arithmetic, not by printf.

One hour of curves is 20 million numbers. Formatting them one by one takes half a minute and more;
this takes seconds and the memory of one chunk.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.arrays import Bool

CHUNK_CELLS = 30_000
"""Numbers formatted at once; about 1 MB, so that it stays in the cache."""
LARGEST = 9.0e17
"""Scaled numbers must fit into 64 bits."""


@dataclass(frozen=True)
class Block:
    """Neighbouring columns that are written alike.

    Parameters
    ----------
    values : array [shape=(T, C)]
        Finite numbers.
    decimals : int
        Digits after the point.
    trim : bool
        Whether trailing zeros, and a point without digits, are left out.
    """

    values: NDArray[np.generic]
    decimals: int
    trim: bool = True


@dataclass(frozen=True)
class Text:
    """A column of text.

    Parameters
    ----------
    characters : array of uint8 [shape=(T, width)]
        0 is no character: it is left out.
    """

    characters: NDArray[np.uint8]


def rows(
    blocks: Sequence[Block | Text],
    *,
    before: bytes = b"",
    after: bytes = b"\n",
    separator: bytes = b",",
) -> Iterator[bytes]:
    """Yield the text of a table, chunk by chunk.

    Numbers are rounded to the nearest last digit; -0 is written 0.

    Parameters
    ----------
    blocks : sequence of Block or Text
        Columns from left to right, all of the same number of rows.
    before, after : bytes
        Text around each row.
    separator : bytes
        One byte between numbers.
    """
    tables = [b.characters if isinstance(b, Text) else b.values for b in blocks]
    n_rows = len(tables[0])
    n_columns = sum(table.shape[1] for table in tables)
    step = max(1, CHUNK_CELLS // max(n_columns, 1))
    for start in range(0, n_rows, step):
        parts = [_cells(block, start, start + step, separator) for block in blocks]
        cells = np.concatenate([characters for characters, _ in parts], axis=1)[:, :-1]
        kept = np.concatenate([kept for _, kept in parts], axis=1)[:, :-1]
        head, tail = (np.tile(np.frombuffer(t, np.uint8), (len(cells), 1)) for t in (before, after))
        text = np.concatenate([head, cells, tail], axis=1)
        keep = np.concatenate([np.ones_like(head, bool), kept, np.ones_like(tail, bool)], axis=1)
        yield text[keep].tobytes()


def _cells(
    block: Block | Text, start: int, stop: int, separator: bytes
) -> tuple[NDArray[np.uint8], Bool]:
    """Return characters and whether each is kept [both shape=(rows, columns * width)]."""
    if isinstance(block, Text):
        part = block.characters[start:stop]
        text = np.concatenate([part, np.full((len(part), 1), ord(separator), np.uint8)], axis=1)
        return text, text != 0
    values = np.asarray(block.values[start:stop], dtype=np.float64)
    scaled = np.rint(np.abs(values) * 10.0**block.decimals)
    largest = scaled.max(initial=0.0)
    if not largest < LARGEST:
        raise OverflowError(f"{largest / 10.0**block.decimals:g} is too large to write")
    kind = np.int32 if max(largest, 10.0**block.decimals) < 2**31 else np.int64
    whole: NDArray[np.signedinteger] = scaled.astype(kind)
    n_integer = max(1, len(str(int(largest))) - block.decimals)
    width = 1 + n_integer + 1 + block.decimals + 1  # sign, digits, point, digits, separator
    text = np.empty((*values.shape, width), np.uint8)
    keep = np.ones((*values.shape, width), np.bool_)
    text[..., 0] = ord("-")
    keep[..., 0] = (values < 0) & (whole > 0)
    text[..., -1] = ord(separator)
    point = 1 + n_integer
    text[..., point] = ord(".")
    rest = whole
    is_kept = np.full(whole.shape, not block.trim)
    for place in range(point + block.decimals, point, -1):
        higher = rest // 10
        digit = rest - higher * 10
        rest = higher
        is_kept = is_kept | (digit > 0)
        text[..., place] = digit + ord("0")
        keep[..., place] = is_kept
    keep[..., point] = is_kept if block.decimals else False
    rest = whole // 10**block.decimals
    for place in range(n_integer, 0, -1):
        higher = rest // 10
        text[..., place] = rest - higher * 10 + ord("0")
        if place < n_integer:
            keep[..., place] = rest > 0
        rest = higher
    n_rows = len(values)
    return text.reshape(n_rows, -1), keep.reshape(n_rows, -1)
