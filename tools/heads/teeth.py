"""Teeth and gums: each row is one surface over an arch, from the gum over the crowns inwards.

A row is a grid: columns along the arch, several for each tooth, and lines across it, from the fold
of the cheek over gum, crown and edge to the palate or the floor of the mouth. Its picture has the
same two coordinates, so gums, enamel and the shadow between teeth are painted where they are.
Widths of crowns are means of adults (Wheeler's Dental Anatomy), in cm; of the upper front teeth the
gum covers half a millimetre more than of its means.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter

PICTURE = 512
"""Side of the picture of both rows, texels: the upper row in its upper half."""
_MARGIN = 0.012
"""Of the picture that each row leaves free at its ends."""
_ACROSS = np.array([-1, -0.94, -0.78, -0.42, 0, 0.42, 0.78, 0.94])
"""Columns of a tooth, from one contact to the next; the last contact is the next tooth's."""


@dataclass(frozen=True)
class Row:
    """Crowns of one half of a row, from the middle to the second molar, cm.

    `width` is along the arch and `height` from the gum to the edge in the middle of a tooth; `edge`
    is how far that edge stands back towards the root, `thick` the edge's thickness, `round` how far
    the edge's corners stand back, `point` how far a point stands over its sides, `cusps` how many
    there are on the cheek's side. `root` is 1 where roots point up, else -1; `papilla` how far the
    gum reaches down between teeth; `arch` has places (x, z) of the crowns' fronts; `lean` is how
    far the gum recedes, `tip` how far an edge stands before its crown's neck, `stand` how far a
    tooth stands out of the arch and `turn` how far its far contact lies behind its near one;
    `crowded` is the deviation of single teeth from all this.
    """

    root: int
    width: tuple[float, ...]
    height: tuple[float, ...]
    edge: tuple[float, ...]
    thick: tuple[float, ...]
    round: tuple[float, ...]
    point: tuple[float, ...]
    cusps: tuple[int, ...]
    papilla: float
    arch: tuple[tuple[float, float], ...]
    lean: float
    tip: tuple[float, ...]
    stand: tuple[float, ...]
    turn: tuple[float, ...]
    crowded: float


ROWS = {
    "upper": Row(
        root=1, papilla=0.44, lean=0.16, crowded=0.012, tip=(0.09, 0.08, 0.06, 0.02, 0, 0, 0),
        stand=(-0.08, -0.13, -0.05, -0.02, 0, 0, 0), turn=(0.01, 0.02, 0.10, 0.03, 0, 0, 0),
        width=(0.87, 0.66, 0.77, 0.70, 0.68, 0.98, 0.95),
        height=(0.96, 0.83, 0.96, 0.82, 0.80, 0.76, 0.70),
        edge=(0.0, 0.095, 0.02, 0.12, 0.17, 0.24, 0.34),
        thick=(0.13, 0.13, 0.2, 0.56, 0.6, 0.8, 0.8),
        round=(0.10, 0.15, 0.11, 0.08, 0.07, 0.05, 0.05),
        point=(0, 0, 0.15, 0.10, 0.06, 0.05, 0.05), cusps=(1, 1, 1, 1, 1, 2, 2),
        arch=((0, 0), (0.45, -0.015), (0.85, -0.07), (1.3, -0.22), (1.72, -0.56), (2.08, -1.1),
              (2.32, -1.75), (2.5, -2.6), (2.6, -3.6), (2.6, -5.2)),
    ),
    "lower": Row(
        root=-1, papilla=0.34, lean=0.12, crowded=0.035, tip=(0.03, 0.03, 0.02, 0, 0, 0, 0),
        stand=(-0.02, 0.02, 0.03, 0, 0, 0, 0), turn=(0, 0.02, 0.07, 0.02, 0, 0, 0),
        width=(0.53, 0.58, 0.68, 0.70, 0.71, 1.08, 1.05),
        height=(0.86, 0.88, 1.0, 0.84, 0.8, 0.74, 0.7),
        edge=(0.0, 0.01, -0.02, 0.05, 0.08, 0.1, 0.1),
        thick=(0.11, 0.11, 0.18, 0.5, 0.55, 0.8, 0.8),
        round=(0.05, 0.07, 0.09, 0.07, 0.06, 0.05, 0.05),
        point=(0, 0, 0.08, 0.06, 0.05, 0.05, 0.05), cusps=(1, 1, 1, 1, 1, 2, 2),
        arch=((0, 0), (0.3, -0.005), (0.65, -0.04), (1.1, -0.15), (1.55, -0.47), (1.93, -1.02),
              (2.18, -1.7), (2.38, -2.6), (2.5, -3.6), (2.54, -5.2)),
    ),
}  # fmt: skip
_LINES = {
    "fold": 0.0, "gum": 0.11, "attached": 0.21, "free": 0.275, "margin": 0.30,
    "neck": 0.315, "bulge": 0.37, "middle": 0.46, "cut": 0.54, "low": 0.60, "tip": 0.64,
    "edge": 0.66, "fissure": 0.70, "inner": 0.74, "back": 0.80, "inside": 0.85, "base": 0.90,
    "slope": 0.95, "end": 1.0,
}  # fmt: skip
"""Lines of the grid and where each is in the picture, 0 to 1."""
_CROWN = {"neck": (0.02, 0.0), "bulge": (0.2, 0.055), "middle": (0.45, 0.065), "cut": (0.7, 0.045),
          "low": (0.88, 0.01), "tip": (0.97, -0.03), "edge": (1.0, -0.07)}  # fmt: skip
"""Lines of the crown's front: way from gum to edge, and how far they stand out, cm."""
ENAMEL = {"upper": (1.0, 0.98, 0.95), "lower": (0.93, 0.885, 0.83)}
"""Factor on the person's colour of teeth: the lower row is in the shadow of the upper one."""
_SHOWN = (1.5, 1.4, 1.3, 1.0, 0.8, 0.55, 0.45)
"""Share of the picture that each tooth takes, for its width."""


class Columns:
    """Columns of both halves of a row, from the right to the left of the face."""

    def __init__(self, row: Row, across=_ACROSS) -> None:
        count = len(row.width)
        self.row = row
        self.tooth = np.append(np.repeat(np.arange(2 * count), len(across)), 2 * count - 1)
        self.across = np.append(np.tile(across, 2 * count), 1.0)
        """Place within the tooth, -1 to 1, from right to left."""
        self.place = np.abs(self.tooth - count + 0.5).astype(int)
        """Number of the tooth from the middle, 0 the first incisor."""
        self.side = np.where(self.tooth < count, -1, 1)
        self.aside = np.abs(self.across)
        """0 in the middle of the tooth, 1 at its contacts."""

    def of(self, values):
        """A value of each tooth, at contacts the mean of both neighbours'."""
        values = np.asarray(values, float)
        both = np.concatenate([values[::-1], values])
        mean = 0.5 * (both[:-1] + both[1:])
        right = np.insert(mean, 0, both[0])[self.tooth]
        left = np.append(mean, both[-1])[self.tooth]
        beside = np.where(self.across < 0, right, left)
        return both[self.tooth] + (beside - both[self.tooth]) * self.aside**6

    def along(self, values):
        """Sum of a width of each tooth from the middle to the columns, to the left positive."""
        values = np.asarray(values, float)
        both = np.concatenate([values[::-1], values])
        start = np.cumsum(both) - both - values.sum()
        return start[self.tooth] + 0.5 * (1 + self.across) * both[self.tooth]

    def places(self):
        """Where the columns are in the picture, 0 to 1."""
        shown = np.array(self.row.width) * _SHOWN
        return 0.5 + 0.5 * self.along(shown) / shown.sum()


def _arch(row, way):
    """Places (x, z) of the arch and unit vectors outwards, at distances from the middle, cm."""
    half = np.array(row.arch)
    points = np.concatenate([half[:0:-1] * [-1, 1], half])
    length = np.insert(np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)), 0, 0)
    curve = PchipInterpolator(length - length[-1] / 2, points)
    smooth = np.linspace(-0.3, 0.3, 7)
    at = np.mean([curve(way + s) for s in smooth], 0)
    step = np.mean([curve(way + s + 0.02) - curve(way + s - 0.02) for s in smooth], 0)
    step /= np.linalg.norm(step, axis=1, keepdims=True)
    return at, np.stack([-step[:, 1], step[:, 0]], 1)


def grid(name, seed):
    """Points (lines, columns, 3) of a row about the middle of its front edge, cm, and triangles.

    Small turns and shifts of single teeth are drawn from `seed`.
    """
    row = ROWS[name]
    columns = Columns(row)
    rng = np.random.default_rng(seed)
    q, far = columns.across, columns.aside
    away = q * columns.side  # 1 at the contact that is farther from the middle
    count = 2 * len(row.width)
    turned, pushed, longer = rng.normal(0, row.crowded, (3, count))[:, columns.tooth]
    is_front = columns.place < 5
    loose = (1 - far**4) * is_front
    height, back, thick = (columns.of(v) for v in (row.height, row.edge, row.thick))
    margin = height + back - row.papilla * far**2.4
    cusps = np.array(row.cusps)[columns.place]
    point = 0.5 - 0.5 * np.cos(np.pi * np.where(cusps > 1, 1.0 - 2 * np.abs(far - 0.5), far))
    edge = back + columns.of(row.round) * (far**4 + 0.5 * far**14) * np.where(away > 0, 1, 0.55)
    edge = edge + columns.of(row.point) * point * np.where(cusps > 1, 0.7, 1) + 0.5 * longer * loose
    out = -columns.of((0.08, 0.09, 0.14, 0.14, 0.12, 0.09, 0.08)) * far**2.4
    out = out + columns.of(row.stand) - np.array(row.turn)[columns.place] * away * loose
    out = out + (0.6 * turned * q + 0.5 * pushed) * loose
    groove = 0.04 * far**6 + 0.06 * far**16
    place, outward = _arch(row, columns.along(row.width))
    lines = {}

    def line(name, root, out):
        lines[name] = root, out

    root_bulge = 0.035 * (1 - far**2)
    line("fold", margin.mean() + 0.95 + 0 * far, -row.lean - 0.12 + 0 * far)
    line("gum", 0.4 * margin + 0.6 * margin.mean() + 0.5, -0.5 * row.lean + 0.6 * root_bulge)
    line("attached", margin + 0.22, -0.015 + root_bulge + 0.5 * out)
    line("free", margin + 0.05, 0.02 + 0.7 * root_bulge + 0.8 * out - 0.3 * groove)
    line("margin", margin - 0.015, 0.005 + out - 0.4 * groove)
    for crown, (way, more) in _CROWN.items():
        root = margin + (edge - margin) * way
        notch = groove * (0.5 + 0.9 * way**2)
        line(crown, root, out + more - notch + columns.of(row.tip) * way)
    tip = lines["edge"][1]
    is_broad = np.clip((thick - 0.25) / 0.25, 0, 1)
    line("fissure", edge + 0.10 * is_broad * (1 - 0.3 * far**2), tip - 0.5 * thick)
    line("inner", edge + 0.02 + 0.03 * is_broad, tip - thick + 0.02 * far**2)
    line(
        "back",
        0.55 * edge + 0.45 * margin,
        tip - thick - 0.10 - 0.06 * (1 - is_broad) + 0.05 * far**4,
    )
    line("inside", margin, tip - thick - 0.10 - 0.2 * (1 - is_broad) + 0.08 * far**4)
    line("base", margin.mean() + 0.25 + 0 * far, tip - thick - 0.35)
    assert list(lines) == list(_LINES)[: len(lines)]
    points = [
        np.stack(
            [place[:, 0] + o * outward[:, 0], row.root * r, place[:, 1] + o * outward[:, 1]], 1
        )
        for r, o in lines.values()
    ]
    for share, more in ((0.5, 0.55), (0.0, 0.75)):  # palate, or floor below the tongue
        base = points[-1] if share else points[-2]
        inner = base * [share, 1, 1]
        inner[:, 1] = row.root * (margin.mean() + 0.25 + more * (1 if row.root > 0 else 0.8))
        inner[:, 2] = np.minimum(base[:, 2], -0.9 - 0.9 * (1 - share))
        points.append(inner)
    points = np.stack(points)
    n, m = points.shape[:2]
    i = (np.arange(n - 1)[:, None] * m + np.arange(m - 1)).ravel()
    faces = np.concatenate([np.stack([i, i + m, i + 1], 1), np.stack([i + 1, i + m, i + m + 1], 1)])
    return points, faces if row.root > 0 else faces[:, ::-1]


def places(name):
    """Places (lines, columns, 2) of a row's points in the picture, v upwards."""
    u = Columns(ROWS[name]).places()
    v = np.array([*_LINES.values()])
    low = 0.5 if name == "upper" else 0.0
    v = low + _MARGIN + (0.5 - 2 * _MARGIN) * (1 - v)
    grid_u, grid_v = np.meshgrid(u, v)
    return np.stack([grid_u, grid_v], -1)


def picture(look):
    """Colours (512, 512, 3), 0 to 1, of both rows."""
    return np.concatenate([_painted(name, look) for name in ("upper", "lower")])


def _painted(name, look):
    """One row (256, 512, 3)."""
    half, rng = PICTURE // 2, np.random.default_rng(look["iris"])
    v = (np.arange(half) + 0.5) / half
    v = ((v - 2 * _MARGIN) / (1 - 4 * _MARGIN))[:, None]
    enamel, gum = _enamel(name, look, v, rng), _gum(look, v, rng)
    is_gum = 1 / (1 + np.exp((v - _LINES["margin"]) / 0.004))
    is_gum = is_gum + 1 / (1 + np.exp((_LINES["inside"] - v) / 0.006))
    return np.clip(enamel + np.clip(is_gum, 0, 1)[..., None] * (gum - enamel), 0, 1)


def _enamel(name, look, v, rng):
    """Warm by the gum, clear and cooler at the edge, each tooth a little its own."""
    columns = Columns(ROWS[name], np.linspace(-1, 1, 65)[:-1])
    u = (np.arange(PICTURE) + 0.5) / PICTURE
    at = np.clip(np.searchsorted(columns.places(), u), 0, len(columns.across) - 1)
    far, place, tooth = columns.aside[at], columns.place[at], columns.tooth[at]
    way = np.clip((v - _LINES["margin"]) / (_LINES["edge"] - _LINES["margin"]), 0, 1)
    enamel = np.array(look.get("enamel", (0.94, 0.87, 0.775))) * ENAMEL[name]
    yellow = np.array([0.0, 0.01, 0.06, 0.035, 0.03, 0.03, 0.03])[place]
    yellow = yellow + np.abs(rng.normal(0, 0.008, 14))[tooth]
    colour = enamel * (1 - yellow[:, None] * [0.35, 0.9, 1.7])
    colour = colour * (1 - (1 - way[..., None]) ** 1.6 * [0.12, 0.19, 0.29])
    lobes = gaussian_filter(rng.normal(size=PICTURE), 2.5, mode="wrap")
    begin = 0.72 + 0.05 * lobes / lobes.std() - 0.12 * far**4
    clear = np.clip((way - begin) / (1 - begin), 0, 1)[..., None] ** 1.3 * (place < 3)[:, None]
    colour = colour * (1 - clear * [0.22, 0.20, 0.15])
    lobes = gaussian_filter(rng.normal(size=(len(v), PICTURE)), (20, 3), mode="nearest")
    colour = colour * (1 + 0.012 * lobes / lobes.std())[..., None]
    contact = 0.6 * np.exp(-(((1 - far) / 0.06) ** 2)) + 0.55 * far**3.5
    colour = colour * (1 - np.clip(contact, 0, 1)[:, None] * [0.22, 0.27, 0.31])
    by_gum = np.exp(-((np.maximum(v - _LINES["margin"], 0) / 0.02) ** 2))[..., None]
    colour = colour * (1 - by_gum * [0.20, 0.34, 0.36])
    fissure = np.exp(-(((v - _LINES["fissure"]) / 0.018) ** 2)) * (place > 2)
    colour = colour * (1 - fissure[..., None] * [0.28, 0.36, 0.42])
    inner = np.clip((v - _LINES["inner"]) / 0.08, 0, 1)[..., None]
    return colour * (1 - inner * [0.26, 0.34, 0.38])


def _gum(look, v, rng):
    """Pale and firm by the teeth, red and loose above."""
    gum = np.array(look.get("gum", (0.80, 0.50, 0.475)))
    loose = np.clip((_LINES["attached"] - v) / _LINES["attached"], 0, 1)[..., None] ** 0.8
    flesh = gum * (1 - loose * [0.16, 0.36, 0.34])
    inside = np.clip((v - _LINES["inside"]) / 0.1, 0, 1)[..., None]
    flesh = flesh * (1 - inside * [0.15, 0.25, 0.25])
    edge = np.exp(-(((v - _LINES["margin"] + 0.01) / 0.02) ** 2))[..., None]
    flesh = flesh * (1 - edge * [0.05, 0.14, 0.13])
    spots = gaussian_filter(rng.normal(size=(len(v), PICTURE)), 1.6, mode="nearest")
    return flesh * (1 + 0.03 * spots / spots.std())[..., None]
