"""Half the atlas of each embedded head, for small pictures and exports: ``python -m tools.heads.small``."""

import numpy as np
from PIL import Image

from rig.face.head_file import DATA, SMALL
from rig.face.identity import IDENTITIES

QUALITY = 92


def halved(picture):
    """Means of 2 x 2 texels (A, A, 4) of each channel alone; Pillow would weigh by alpha."""
    return picture.reshape(len(picture) // 2, 2, -1, 2, 4).mean((1, 3)).round().astype(np.uint8)


def write_small(name):
    """Write half of ``NAME.webp``."""
    with Image.open(DATA / f"{name}.webp") as image:
        picture = halved(np.asarray(image.convert("RGBA")))
    target = DATA / f"{name}{SMALL}.webp"
    Image.fromarray(picture).save(target, quality=QUALITY, method=6, exact=True)


if __name__ == "__main__":
    for person in IDENTITIES:
        write_small(person.name)
