"""Arrays and facts as one text: JSON header, bytes, gzip, base64; ``packed.ts`` reads it."""

import base64
import gzip
import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

KINDS = ("float32", "uint16", "uint32", "int16", "uint8")


BEST = 9


def planes(data: bytes, size: int) -> bytes:
    """The first bytes of all numbers of `size` bytes, then the second ones, and so on."""
    return b"".join(data[k::size] for k in range(size))


def pack(arrays: dict[str, NDArray[Any]], facts: dict[str, Any]) -> str:
    """Pack arrays and facts as `pack_bytes`, as text."""
    return base64.b64encode(pack_bytes(arrays, facts)).decode()


def pack_bytes(
    arrays: dict[str, NDArray[Any]], facts: dict[str, Any], *, level: int = BEST
) -> bytes:
    """Pack arrays (flattened, little-endian) and JSON-ready facts; gzip of a level, 0 to 9.

    ::

        length of header | header (JSON) | padding to 8 | array | padding to 8 | array ...

    The bytes of an array are in planes: gzip makes the head a sixth smaller then.
    """
    entries, blobs, offset = [], [], 0
    for name, array in arrays.items():
        assert array.dtype.name in KINDS, (name, array.dtype)
        blob = np.ascontiguousarray(array).astype(array.dtype.newbyteorder("<")).tobytes()
        entries.append(
            {"name": name, "kind": array.dtype.name, "length": int(array.size), "offset": offset}
        )
        blob = planes(blob, array.itemsize)
        blob += b"\0" * (-len(blob) % 8)
        blobs.append(blob)
        offset += len(blob)
    header = json.dumps({"facts": facts, "arrays": entries}).encode()
    head = struct.pack("<I", len(header)) + header
    head += b"\0" * (-len(head) % 8)
    return gzip.compress(head + b"".join(blobs), level, mtime=0)
