"""The picture of a person's hair: locks and wisps on cards, or squares of tight coils beside them."""

import numpy as np

from tools.heads import coils
from tools.heads.strands import VARIANTS, WISPS

SIDE = 1024


def hair(look):
    """Colours and alpha (1024, 1024, 4)."""
    if "surfaces" not in look:
        return strands(look, SIDE)
    out = np.zeros((SIDE, SIDE, 4))
    quarters = [*coils.squares(look), strands(look, SIDE // 2)]
    for (column, row), quarter in zip((*coils.PLACES, coils.CARDS), quarters, strict=True):
        out[coils.SIDE * row :, coils.SIDE * column :][: coils.SIDE, : coils.SIDE] = quarter
    return out


def strands(look, side):
    """Colours and alpha (side, side, 4) of columns of strands, roots at the top: locks, then wisps."""
    rng, width = np.random.default_rng(12), side // VARIANTS
    x, y = np.arange(width) + 0.5, (np.arange(side)[:, None] + 0.5) / side
    columns = []
    for k in range(VARIANTS):
        alpha, light = np.zeros((side, width)), np.full((side, width), 0.85)
        is_wisp = k >= VARIANTS - WISPS
        tips, fade = look.get("tips", 0.2), look.get("fade", (0.03, 0.03))[is_wisp]
        for strand in range(5 if is_wisp else look["hairs"]):
            turn = rng.uniform(0, 2 * np.pi, 2)
            edge = 0.1 * width
            middle = edge + (width - 2 * edge) * rng.beta(1.9, 1.9)  # denser in the middle
            middle = middle + rng.normal() * 0.05 * width * y
            lock = (strand % look["locks"] + 0.5) / look["locks"] * width  # to which tips gather
            middle = middle + look["gather"] * (lock - middle) * y**1.5
            middle = middle + 0.035 * width * np.sin(3 * y + turn[0])
            middle = middle + look["curl"] * np.sin(rng.uniform(14, 26) * y + turn[1])
            start, end = (
                rng.uniform(-0.06, look.get("starts", 0.03)),
                rng.uniform(look["ends"], 1.0),
            )
            thick = rng.uniform(*look["thick"]) * (0.8 if is_wisp else 1)
            thin = (1.1 - 0.75 * (y / end) ** 2).clip(0.3)  # towards its tip
            own = np.exp(-(((x - middle) / (thick * thin)) ** 2))
            own = own * np.clip((end - y) / tips, 0, 1) * np.clip((y - start) / fade, 0, 1)
            shade = rng.uniform(*look.get("shades", (0.64, 1.14))) + 0.05 * np.sin(9 * y + turn[1])
            light = light + own * (shade - light)
            alpha = alpha + own * (1 - alpha)
        inside = np.clip(np.minimum(x, width - x) / 3 - 0.4, 0, 1)
        columns.append(np.dstack([light, alpha * inside]))
    light, alpha = np.moveaxis(np.concatenate(columns, 1), -1, 0)
    light = light[..., None] ** [0.85, 1.0, 1.1]  # thin strands let red light through
    colour = np.array(look["hair_colour"]) / 255 * 1.25 * light
    return np.dstack([np.clip(colour, 0, 1), np.clip(1.75 * alpha, 0, 1)])
