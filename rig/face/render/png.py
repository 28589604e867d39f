"""Write a picture as PNG with nothing but the standard library."""

import struct
import zlib
from pathlib import Path

import numpy as np

from rig.errors import RigError
from rig.face.render.lettering import Picture
from rig.files import atomic_write


def png_bytes(picture: Picture) -> bytes:
    """PNG file of an RGB picture (h, w, 3) uint8.

    Raises
    ------
    RigError
        If the array is not such a picture.
    """
    if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8:
        raise RigError(
            f"picture of shape {picture.shape} and type {picture.dtype}; PNG needs (h, w, 3) uint8"
        )
    height, width = picture.shape[:2]
    left = np.zeros_like(picture)
    left[:, 1:] = picture[:, :-1]
    change = (picture - left).reshape(height, -1)  # filter 1: difference to the pixel on the left
    rows = np.concatenate([np.ones((height, 1), np.uint8), change], axis=1)

    def chunk(kind: bytes, data: bytes) -> bytes:
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(rows.tobytes(), 9))
        + chunk(b"IEND", b"")
    )


def write_png(path: Path | str, picture: Picture) -> None:
    """Write a picture (h, w, 3) uint8 to `path`, whole or not at all."""
    data = png_bytes(picture)
    with atomic_write(path) as beside:
        beside.write_bytes(data)
