"""Capital letters drawn as strokes, so that pictures can be labelled without a font file."""

from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rig.arrays import Float64

Picture = NDArray[np.uint8]

_STROKES = {
    # corners of strokes on a grid: column 0-4, row 0-6 from the top; a blank lifts the pen
    "A": "062046 1434", "B": "06003041423303 3344453606", "C": "4130100105163645",
    "D": "00062644422000", "E": "40000646 0333", "F": "400006 0333",
    "G": "41301001051636454323", "H": "0006 4046 0343", "I": "1030 2026 1636",
    "J": "4045361605", "K": "0006 400346", "L": "000646", "M": "0600234046",
    "N": "06004640", "O": "103041453616050110", "P": "06003041423303",
    "Q": "103041453616050110 2446", "R": "06003041423303 2346", "S": "413010010213334445361605",
    "T": "0040 2026", "U": "000516364540", "V": "002640", "W": "0016233640", "X": "0046 4006",
    "Y": "002340 2326", "Z": "00400646", "0": "103041453616050110 3214", "1": "112026 1636",
    "2": "01103041420646", "3": "004023334445361605", "4": "36300444", "5": "4000033344453606",
    "6": "40200205163645443303", "7": "004016", "8": "103041423313020110 13040516364544 4433",
    "9": "06264441301001021343", ".": "2526", "-": "1333", "+": "1333 2224", "_": "0646",
    "%": "0640 0011 3546", "(": "30121436", ")": "10323416", "/": "0640", "'": "2021",
    ",": "2516", "=": "1232 1434", ":": "2122 2425", "*": "1135 3115", "<": "411345",
    ">": "013305",
}  # fmt: skip


@lru_cache(maxsize=512)
def _glyph(character: str, height: int) -> Float64:
    """Coverage (height, width) 0..1 of one character."""
    width = round(height * 0.82)
    cover = np.zeros((height, width))
    y, x = np.mgrid[0:height, 0:width] + 0.5
    unit = (height - 2) / 6
    thick = max(0.55, height / 20)
    for stroke in _STROKES.get(character.upper(), "").split():
        points = np.array(
            [[int(a), int(b)] for a, b in zip(stroke[::2], stroke[1::2], strict=True)]
        )
        places = points * [unit, unit] + 1
        for (ax, ay), (bx, by) in pairwise(places):
            dx, dy = bx - ax, by - ay
            h = np.clip(((x - ax) * dx + (y - ay) * dy) / max(dx * dx + dy * dy, 1e-9), 0, 1)
            distance = np.hypot(x - ax - h * dx, y - ay - h * dy)
            cover = np.maximum(cover, np.clip(thick + 0.5 - distance, 0, 1))
    return cover


def text_width(text: str, height: int = 11) -> int:
    """Width in pixels that `write_text` needs."""
    return len(text) * round(height * 0.82)


def write_text(
    picture: Picture,
    text: str,
    place: tuple[int, int],
    *,
    height: int = 11,
    color: tuple[int, int, int] = (240, 242, 245),
) -> Picture:
    """A copy of `picture` (h, w, 3) with `text` in capitals, its top left at `place` (x, y)."""
    out = picture.copy()
    x, y = place
    for character in text:
        glyph = _glyph(character, height)
        window = out[max(y, 0) : y + glyph.shape[0], max(x, 0) : x + glyph.shape[1]]
        cover = glyph[: window.shape[0], : window.shape[1], None]
        window[:] = (window * (1 - cover) + np.array(color) * cover + 0.5).astype(np.uint8)
        x += glyph.shape[1]
    return out
