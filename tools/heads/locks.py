"""The picture of a person's hair: locks and wisps on cards, or squares of tight coils beside them."""

import numpy as np

from tools.heads import coils
from tools.heads.strands import VARIANTS, WISPS

SIDE = 1024
BELOW, SINGLE = 0.62, (0.86, 1.1)
"""Light of the lowest strands of a card for that of the highest, and of single ones for their lock's."""
ROUND = 0.3
"""How much darker the sides of a card are, whose strands turn away there."""
SWAY = np.array([0.05, 0.025])
"""How far locks and single strands bend to the sides, widths of a card."""
WISP = 2.6, 0.26
"""Thickness of a wisp's strands for that of others, and their coverage: they are finer than a texel."""


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
        count = 3 if is_wisp else look["hairs"]
        tones = rng.uniform(*look.get("shades", (0.7, 1.2)), look["locks"])
        phase = rng.uniform(0, 2 * np.pi, look["locks"])
        order = rng.permutation(look["locks"])
        between = width / look["locks"]
        for strand in range(count):
            turn, of = rng.uniform(0, 2 * np.pi, 2), order[strand * look["locks"] // count]
            middle = between * (0.5 + of + 0.45 * rng.normal() * (1 - look["gather"] * y**1.5))
            middle = (
                middle
                + width * np.sin(look.get("bends", 3) * y + [phase[of], turn[0]]) @ SWAY[:, None]
            )
            middle = middle + look["curl"] * np.sin(rng.uniform(14, 26) * y + turn[1])
            start, end = (
                rng.uniform(-0.06, look.get("starts", 0.03)),
                rng.uniform(look["ends"], 1.0),
            )
            thick = rng.uniform(*look["thick"]) * (WISP[0] if is_wisp else 1)
            thin = (1.1 - 0.5 * (y / end) ** 2).clip(0.6)  # towards its tip
            own = np.exp(-(((x - middle) / (thick * thin)) ** 2))
            own = own * np.clip((end - y) / tips, 0, 1) * np.clip((y - start) / fade, 0, 1)
            deep = 1 if is_wisp else BELOW + (1 - BELOW) * strand / count  # the first lie below
            shade = tones[of] * deep * rng.uniform(*SINGLE) + 0.05 * np.sin(9 * y + turn[1])
            own = own * (WISP[1] if is_wisp else 1)
            alpha = own + (1 - own) * alpha
            light = light + own / (alpha + 1e-6) * (shade - light)
        light = light * (1 - ROUND * (2 * x / width - 1) ** 2)
        inside = np.clip(np.minimum(x, width - x) / 3 - 0.4, 0, 1)
        columns.append(np.dstack([light, alpha * inside]))
    light, alpha = np.moveaxis(np.concatenate(columns, 1), -1, 0)
    light = light[..., None] ** [0.85, 1.0, 1.1]  # thin strands let red light through
    colour = np.array(look["hair_colour"]) / 255 * 1.25 * light
    return np.dstack([np.clip(colour, 0, 1), np.clip(1.4 * alpha, 0, 1)])
