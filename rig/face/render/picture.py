"""Pictures (h, w, 3) uint8: text in them, by Pillow, and PNG files."""

import struct
import zlib
from functools import lru_cache
from math import ceil
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont


Picture = NDArray[np.uint8]

_SIZE = 1.4
"""Size of Pillow's own font over the height of its capitals."""


def png(picture: Picture) -> bytes:
    """PNG of a picture (h, w, 3), or (h, w, 4) with alpha (W3C PNG, sections 5, 9 and 11).

    Rows are stored as differences from the row above and packed by run lengths: half the time of
    Pillow's choice of a filter for each row.
    """
    height, width, channels = picture.shape
    rows = picture.reshape(height, -1)
    filtered = np.full((height, 1 + rows.shape[1]), 2, np.uint8)
    filtered[0, 1:] = rows[0]
    np.subtract(rows[1:], rows[:-1], out=filtered[1:, 1:])
    packer = zlib.compressobj(1, strategy=zlib.Z_RLE)
    kind = {3: 2, 4: 6}[channels]
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, kind, 0, 0, 0)),
        (b"IDAT", packer.compress(filtered.data) + packer.flush()),
        (b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        for name, data in chunks
    )


@lru_cache(maxsize=16)
def _font(height: int) -> "FreeTypeFont":
    """Return the font whose capitals are about `height` pixels tall."""
    from PIL import ImageFont

    font = ImageFont.load_default(_SIZE * height)
    assert isinstance(font, ImageFont.FreeTypeFont)  # as given a size
    return font


def text_width(text: str, height: int = 11) -> int:
    """Width of a text in pixels, rounded up."""
    return ceil(_font(height).getlength(text))


def write_text(
    picture: Picture,
    text: str,
    place: tuple[int, int],
    *,
    height: int = 11,
    color: tuple[int, int, int] = (240, 242, 245),
) -> Picture:
    """Return a copy of a picture with a line of text in it.

    Parameters
    ----------
    picture : ndarray of uint8 [shape=(h, w, 3)]
        Stays as it is.
    text : str
        What does not fit into the picture is cut off.
    place : (int, int)
        x and y of the top left of its capitals, pixels.
    height : int
        Of its capitals, pixels.
    color : tuple of int
        Red, green and blue, 0 to 255.
    """
    from PIL import Image, ImageDraw

    image = Image.fromarray(picture)
    x, y = place
    ImageDraw.Draw(image).text((x, y + height), text, color, font=_font(height), anchor="ls")
    return np.array(image)
