"""Short tight coils: the scalp's own surface several times over it, each with fewer coils than the one below.

All of them show one square of coils that repeats, at the same places, so that a coil that is long
enough stands through them.
"""

import numpy as np
from scipy.ndimage import gaussian_filter

from tools.heads.base import triangles

SIDE, TEXELS = 512, 48
"""Texels of each square, and of a centimetre."""
MARGIN = 56
"""Texels of a square that repeat its other side, for triangles that lie across."""
LEVELS = (0.16, 0.46, 0.74)
"""Height of each square's coils, of the longest."""
PLACES, CARDS = ((0, 0), (1, 0), (0, 1)), (1, 1)
"""Column and row in the picture of hair of each square, and of what cards show."""
THIN = 0.8
"""How much fewer coils reach a surface at the hairline than where hair is full."""
FACINGS = np.array([[0, 1, 0], [1, 0, 0], [-1, 0, 0], [0, 0, -1], [0, 0, 1]])
"""Directions along which the square is laid on the scalp: each triangle takes the nearest."""


def squares(look):
    """Colours and alpha (512, 512, 4) of each of `LEVELS`."""
    side = SIDE - MARGIN
    high, light = _coils(side, look["coil"], np.random.default_rng(21))
    found = []
    for least in LEVELS:
        alpha = np.clip((high - least) / 0.10, 0, 1)
        shade = (0.42 + 0.75 * least + 0.35 * (high - least)) * light
        colour = np.array(look["hair_colour"]) / 255 * np.clip(shade, 0, 2)[..., None]
        found.append(np.pad(np.dstack([colour, alpha]), ((0, MARGIN), (0, MARGIN), (0, 0)), "wrap"))
    return found


def _coils(side, radius, rng):
    """Height, 0 to 1, and light of coils of a radius (cm) on a square that repeats."""
    high, light = np.zeros((side, side)), np.full((side, side), 0.6)
    clump = gaussian_filter(rng.normal(size=(side, side)), 0.16 * TEXELS, mode="wrap")
    clump = np.clip(0.5 + 0.25 * clump / clump.std(), 0, 1)
    reach = int(TEXELS * radius * 1.9) + 2
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    count = int(1.8 * (side / TEXELS / radius) ** 2)
    level = np.sort(rng.random(count))  # longer ones lie over the others
    for top in level:
        row, column = rng.integers(0, side, 2)
        own, turn = TEXELS * radius * rng.uniform(0.7, 1.2), rng.uniform(0, 2 * np.pi)
        bent = rng.uniform(0, 0.5)  # from a whole turn to half of one
        flat, tilt = rng.uniform(0.55, 1.0), rng.uniform(0, np.pi)
        along = (np.cos(tilt) * x + np.sin(tilt) * y) / flat
        across = np.cos(tilt) * y - np.sin(tilt) * x
        far, angle = np.hypot(along, across), np.arctan2(across, along)
        ring = own * (0.62 + 0.38 * ((angle + turn) % (2 * np.pi)) / (2 * np.pi))  # a spiral
        thick = TEXELS * 0.030
        strand = np.exp(-(((far - ring) / thick) ** 2))
        strand *= np.clip(4 * ((angle + turn) % (2 * np.pi) / (2 * np.pi) - bent), 0, 1)
        rows, columns = (row + y) % side, (column + x) % side
        value = (0.25 + 0.5 * top + 0.25 * clump[row, column]) * strand
        shade = 0.75 + 0.45 * np.cos(angle - turn) * (far / own) + 0.5 * (strand - 0.6)
        shown = value > high[rows, columns]
        high[rows, columns] = np.where(shown, value, high[rows, columns])
        light[rows, columns] = np.where(shown, shade, light[rows, columns])
    ground = gaussian_filter(high, 2.5, mode="wrap")  # what lies between strands
    return np.maximum(high, 0.75 * ground), light


def surfaces(person, hair):
    """Points, drawn ones, their places, triangles and tones of the surfaces, the highest first."""
    look, base, size = person.look, person.base, person.size
    skin, normals, full, length = person.skin, person.normals, hair.full, hair.length
    is_inner = (full[base.cage] == 1).all(1)  # finer triangles at the hairline
    edge = base.quads[np.repeat(~is_inner, 4)]
    faces = triangles(np.concatenate([base.cage[is_inner], edge[(full[edge] > 0).any(1)]]))
    cross = np.cross(*(skin[faces[:, k]] - skin[faces[:, 0]] for k in (1, 2)))
    axes = np.array([np.flatnonzero(way == 0) for way in FACINGS])[np.argmax(cross @ FACINGS.T, 1)]
    at = TEXELS * (np.take_along_axis(skin[faces], axes[:, None], 2) + 20.0)  # (N, 3, 2)
    period = SIDE - MARGIN
    at = at - period * np.floor(at.min(1, keepdims=True) / period)
    points, drawn, places, triangle, tones = [], [], [], [], []
    for share in look["surfaces"]:
        wanted = 0.75 * share + THIN * (1 - full[faces].mean(1))
        kept = wanted < LEVELS[-1]
        square = np.abs(wanted[kept, None] - LEVELS).argmin(1)
        place = (np.array(PLACES)[square][:, None] + at[kept] / SIDE) / 2
        high = size * (0.02 + share * length * (0.08 + 0.92 * full))
        triangle.append(np.arange(3 * kept.sum()).reshape(-1, 3) + sum(map(len, drawn)))
        drawn.append(faces[kept].ravel() + len(points) * base.n_skin)
        points.append(skin + normals * high[:, None])
        places.append(np.stack([place[..., 0], 1 - place[..., 1]], -1).reshape(-1, 2))
        tones.append(np.full((3 * kept.sum(), 3), 0.8 + 0.2 * share))
    points, drawn, places, triangle, tones = map(
        np.concatenate, (points, drawn, places, triangle, tones)
    )
    key = np.column_stack([drawn, np.round(places, 5)])
    _, first, new = np.unique(key, axis=0, return_index=True, return_inverse=True)
    return points, drawn[first], places[first], new.reshape(-1)[triangle], tones[first]
