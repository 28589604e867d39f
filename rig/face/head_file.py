"""Files of heads: the embedded ones of `rig/face/data`, and a user's head in one NPZ.

A user's head has the arrays of `FIELDS`; what it has not (seal, lids that keep out of the eyes,
creases, followers) is empty in what `read_head` returns.
"""

from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rig.errors import FormatError, quoted
from rig.files import atomic_write
from rig.files.reading import read_npz
from rig.limits import HEAD_BYTES, HEAD_VERTICES, PICTURE_PIXELS

if TYPE_CHECKING:
    from PIL import Image

DATA = Path(__file__).parent / "data"
GRID = 800.0
"""Steps of stored points in a centimetre."""
CONVERGENCE_DEGREES = 1.6
"""Turn of each embedded eye inwards at rest: an adult's eyes meet 111 cm away."""
PICTURES = ("atlas", "creases", "pores")
"""Parts of `rig.face.mesh.Maps` that are WebP files."""
SMALL = "_small"
"""End of the name of an atlas of half the side."""
FIELDS = {
    "points": ("int16", "V3"), "uv": ("uint16", "V2"), "weld": ("uint16", "V"),
    "colour": ("uint8", "V3"), "gloss": ("uint8", "V"), "light": ("uint8", "V2"),
    "kind": ("uint8", "V"), "faces": ("uint16", "N3"), "eyes": ("float32", "24"),
    "stops": ("int64", "P"), "names": ("str", "K"), "count": ("int32", "K"),
    "columns": ("uint16", "E"), "values": ("int16", "3E"), "step": ("float32", ""),
    "atlas": ("uint8", "B"), "creases": ("uint8", "C"), "pores": ("uint8", "D"),
}  # fmt: skip
"""Type and shape of each array; a letter is a length that is the same wherever it stands."""
PARTS = ("skin", "seam", "eye_L", "eye_R", "hair")
"""Parts of a user's head, in their order: `stops` are their ends."""
Arrays = dict[str, NDArray[Any]]


@lru_cache(maxsize=1)
def _shared() -> Arrays:
    return _stored("head")


def _stored(name: str) -> Arrays:
    with np.load(DATA / f"{name}.npz") as stored:
        return {key: stored[key] for key in stored.files}


def embedded(name: str) -> Arrays:
    """All arrays of an embedded head but its pictures; `read_pictures` gives those."""
    shared, own = _shared(), _stored(name)
    both = [key for key in own if key in shared]
    joined = {key: np.concatenate([shared[key], own[key]]) for key in both}
    return shared | own | joined | {"convergence": np.array(CONVERGENCE_DEGREES)}


def embedded_pictures(name: str) -> dict[str, bytes]:
    """Files of an embedded head's `PICTURES`."""
    files = zip(PICTURES, (name, "creases", "pores"), strict=True)
    return {key: (DATA / f"{file}.webp").read_bytes() for key, file in files}


def small_atlas(name: str) -> bytes:
    """File of an embedded head's atlas of half the side."""
    return (DATA / f"{name}{SMALL}.webp").read_bytes()


def write_head(path: Path, arrays: Arrays) -> None:
    """Write the arrays of `FIELDS`."""
    with atomic_write(path) as beside, open(beside, "wb") as file:
        np.savez_compressed(file, **{name: arrays[name] for name in FIELDS})  # type: ignore[arg-type]


def read_head(path: Path) -> Arrays:
    """Read a user's head; arrays as of an embedded one.

    Raises
    ------
    FormatError
        If the file is no head.
    """
    arrays = read_npz(path, limit=HEAD_BYTES)
    lengths: dict[str, int] = {}
    for name, (kind, shape) in FIELDS.items():
        array = arrays.get(name)
        if array is None or not _fits(array, kind, shape, lengths):
            raise FormatError(
                f"{path.name} is no head: array {name!r} is missing or of a wrong shape; "
                "`deitalk face import face.glb` writes one"
            )
    vertices, stops = lengths["V"], arrays["stops"]
    starts = np.concatenate([[0], np.cumsum(arrays["count"], dtype=np.int64)])
    within = np.cumsum(arrays["columns"], dtype=np.int64)
    before = np.concatenate([[0], within])[starts[:-1].clip(0, len(within))]
    is_whole = (
        0 < vertices <= HEAD_VERTICES
        and len(stops) == len(PARTS)
        and bool((np.diff(stops, prepend=0) >= 0).all())
        and stops[-1] == vertices
        and bool((arrays["count"] > 0).all())
        and starts[-1] == lengths["E"]
        and int((within - np.repeat(before, arrays["count"])).max(initial=0)) < vertices
        and max(int(arrays[name].max(initial=0)) for name in ("faces", "weld")) < vertices
        and bool(np.isfinite(arrays["eyes"]).all() and 0 < arrays["step"] < 1)
        and int(arrays["kind"].max()) < 6
    )
    if not is_whole:
        raise FormatError(f"{path.name} is no whole head; import it again from its GLB")
    none, skin = np.zeros(0, np.int64), int(stops[0])
    return arrays | {
        "parts": np.array(PARTS), "convergence": np.array(0), "size": np.array(1.0),
        "purse": np.array(1.0), "blink": np.array(1.0), "creases": np.array(0),
        "crease_mask": np.zeros((10, skin)),
        "landmarks": none, "landmark_points": none, "follow": none,
        "near": np.zeros((0, 1), np.int64), "weight": np.zeros((0, 1)),
        "lip_columns": np.array([-1, 1], np.float32), "lip_fade": np.zeros(2, np.float32),
        **{f"{part}_{s}": none for part in ("lid", "lid_rim") for s in "LR"},
        **{f"rim_{lip}": none[:0] for lip in ("upper", "lower")},
        **{f"rim_{lip}_weight": np.zeros((2, 0), np.float32) for lip in ("upper", "lower")},
        **{f"reach_{lip}{what}": none for lip in ("upper", "lower")
           for what in ("", "_column", "_share")},
        **{f"picture.{name}": arrays[name] for name in PICTURES},
    }  # fmt: skip


def opened(data: bytes, name: str) -> "Image.Image":
    """Picture of a file of `PICTURES`, square, RGBA; `pores` without alpha.

    Raises
    ------
    FormatError
        If it is no picture, or too large.
    """
    from PIL.WebPImagePlugin import WebPImageFile  # alone: Image.open imports other formats first

    try:
        with WebPImageFile(BytesIO(data)) as image:
            if image.width != image.height or image.width**2 > PICTURE_PIXELS:
                raise ValueError("it is too large, or not square")
            image.load()
            mode = "RGB" if name == "pores" else "RGBA"
            return image if image.mode == mode else image.convert(mode)
    except (OSError, ValueError, SyntaxError) as error:
        raise FormatError(f"a head's picture {name!r} cannot be read: {quoted(error)}") from None


def _fits(array: NDArray[Any], kind: str, shape: str, lengths: dict[str, int]) -> bool:
    """Whether an array has a type and a shape; lengths that were open are set."""
    is_kind = array.dtype.kind == "U" if kind == "str" else array.dtype == kind
    if not is_kind or array.ndim != len(shape):
        return False
    wanted = [
        int(letter) if letter.isdigit() else lengths.setdefault(letter, size)
        for letter, size in zip(shape, array.shape, strict=True)
    ]
    return list(array.shape) == wanted
