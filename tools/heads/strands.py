"""Hair grown from the scalp: narrow cards that follow a combed flow and fall where it ends.

The hairline is a line round the average head (`LINE`). Cards are rooted over it, thinner and
shorter ones before it; they rise to a layer over the scalp. Triangles lie in the order in which they
are blended, the innermost layer first. Long hair falls from a parting over temples and ears, evenly rooted.
"""

import numpy as np
from scipy.ndimage import gaussian_filter, gaussian_filter1d, map_coordinates
from scipy.spatial import cKDTree

from tools.heads import coils
from tools.heads.parts import Part, Person

VARIANTS = 16
"""Columns of strands in their picture; each card shows one, the last ones are wisps."""
WISPS = 4
LINE = np.array([
    (0, 10.1), (14, 10.0), (27, 9.5), (38, 8.8), (47, 7.5), (54, 5.8), (61, 4.4), (67, 2.6),
    (72, 0.9), (78, 0.7), (81, 2.6), (85, 4.5), (97, 4.7), (102, 3.6), (108, 0.6), (116, -2.0),
    (128, -3.8), (152, -4.8), (180, -5.2),
])  # fmt: skip
"""Height of the hairline, cm, by degrees round the head from the middle of the forehead."""
AXIS_Z, ROUND_CM = -0.8, 7.6
"""Depth of the axis of `LINE`, and how far it is from the skin."""
FINE = 3
"""Steps in which each part of a card is worked out."""
WAVE_CM, ALONG = 2.1, 0.8
"""Length of a wave of long hair, cm for a radian, and how much of it lies along the surface."""
DOWN = np.array([0.0, -1.0, 0.0])
FRONT = (-9.9, 4.7)
"""Height, cm, at which hair ends that hangs farther in front: below it no neck turns with the head."""

FACE = (5.0, 6.8, 5.0)
"""How near to the middle, below which height and in front of what depth no long hair falls, cm."""
FACE_EDGE = 1.8
"""How much farther from the middle some locks end, so that their border is uneven, cm."""


def unit(x):
    """Vectors of length 1."""
    return x / np.maximum(np.linalg.norm(x, axis=-1, keepdims=True), 1e-9)


def smooth(x):
    """0 below 0, 1 above 1, and a smooth cubic between."""
    x = np.clip(x, 0, 1)
    return x * x * (3 - 2 * x)


def around(points):
    """Angle round the head of points of the average head, degrees from the front."""
    return np.degrees(np.arctan2(np.abs(points[..., 0]), points[..., 2] - AXIS_Z))


def over_line(points, look):
    """How far points of the average head lie within the hairline, cm; ears do not."""
    line = np.array(look.get("hairline", LINE))
    line[:, 1] += look["line"] * smooth((75 - line[:, 0]) / 25)
    for name, low, high in (("burns", 66, 86), ("arch", 80, 112)):
        own = (line[:, 0] > low) & (line[:, 0] < high)
        line[own, 1] = np.maximum(line[own, 1], look.get(name, -9))
    angle, high = around(points), points[..., 1]
    side = np.sign(high - np.interp(angle, *line.T))
    across, line[:, 0] = np.radians(angle) * ROUND_CM, np.radians(line[:, 0]) * ROUND_CM
    far = np.full(high.shape, np.inf)
    for (x, y), (dx, dy) in zip(line[:-1], np.diff(line, axis=0), strict=True):
        share = np.clip(((across - x) * dx + (high - y) * dy) / (dx**2 + dy**2), 0, 1)
        far = np.minimum(far, np.hypot(across - x - share * dx, high - y - share * dy))
    return np.where(is_ear(points), -9.0, side * far)


def cloud(place, size, seed):
    """Noise at places (..., 3) with features of `size` cm, the same in all directions."""
    field = gaussian_filter(np.random.default_rng(seed).normal(size=(80, 80, 80)), 1, mode="wrap")
    at = np.moveaxis(place / size, -1, 0)
    return map_coordinates(field / field.std(), at, order=1, mode="grid-wrap")


def uneven(points):
    """How far the hairline wanders at points of the average head, cm."""
    return 0.16 * cloud(points, 0.5, 41) + 0.12 * cloud(points, 0.15, 42)


def is_ear(points):
    """Which points of the average head are of its ears."""
    far, high = np.abs(points[..., 0]), points[..., 1]
    return (far > 7.75) & (np.abs(high - 1.5) < 4.4) & (high < 5.4)


def tangent(way, normal):
    """Vectors along a surface."""
    return unit(way - normal * (way * normal).sum(-1, keepdims=True))


class Hair:
    """The scalp of a person, and the flow of the hair on it."""

    def __init__(self, person: Person) -> None:
        self.person, self.look = person, person.look
        self.rng = np.random.default_rng(8)
        self.average = person.shapes.average[: person.base.n_skin]
        self.high = over_line(self.average, self.look)
        self.scale = person.size
        self.is_long = self.look["style"] == "long"
        kept = ~(is_ear(self.average) & self.is_long)  # long hair lies over ears
        self.skin, self.normals = person.skin[kept], person.normals[kept]
        self.inside, self.turn = self.high[kept], around(self.average[kept])
        self.tree = cKDTree(self.skin)
        soft = np.interp(around(self.average), *np.transpose(self.look.get("edges", [(0, 1.0)])))
        self.full = np.clip((self.high + uneven(self.average)) / soft, 0, 1)
        self.length = self.sides(person.skin, self.look)

    def sides(self, points, shorter):
        """Share of its length that hair has at points, which may be shorter at the sides."""
        high = (points[:, 1] + 0.25 * (points[:, 2] - 4 * self.scale)) / self.scale
        least = shorter.get("sides", 1)
        return least + (1 - least) * smooth((high - 6.5) / 3.5)

    def surface(self, points):
        """Smooth normal of the skin near points, and their height over it."""
        distance, near = self.tree.query(points, k=24 if self.is_long else 10)
        weight = 1 / (distance + 0.3) ** 2
        weight /= weight.sum(1, keepdims=True)
        skin, normals = self.skin[near], self.normals[near]
        normal = unit(np.einsum("pkc,pk->pc", normals, weight))
        if self.is_long:  # no strand gets round an ear
            aside = 3 * self.ear(points) * np.sign(points[:, 0])
            normal = unit(normal + aside[:, None] * [1, 0, 0])
        return (
            normal,
            np.einsum("pkc,pc,pk->p", points[:, None] - skin, normal, weight),
            distance[:, 0],
        )

    def roots(self, count, low, high, turns, part=99):
        """Random places of the scalp between two distances within the hairline, and two angles round it.

        They are at most `part` cm of the average head from the parting.
        """
        faces = self.person.base.skin_faces
        a, b, c = (self.person.skin[faces[:, k]] for k in range(3))
        cross = np.cross(b - a, c - a)
        within = self.high[faces].mean(1)
        turn = around(self.average[faces].mean(1))
        area = (
            np.linalg.norm(cross, axis=1)
            * (within > low)
            * (within < high)
            * (turn > turns[0])
            * (turn < turns[1])
            * (np.abs(self.average[faces, 0].mean(1) - self.look.get("parting", 0)) < part)
        )
        drawn = 8 * count if self.is_long else count
        face = self.rng.choice(len(faces), drawn, p=area / area.sum())
        u, v = np.sqrt(self.rng.random((drawn, 1))), self.rng.random((drawn, 1))
        place = (1 - u) * a[face] + u * (1 - v) * b[face] + u * v * c[face]
        kept = _far_apart(place, count)
        return place[kept], within[face[kept]]

    def flow(self, points, normal, style=None):
        """Direction in which hair is combed at points near the scalp."""
        look, s = self.look, self.scale
        x, y, z = points.T / s
        style = style or look["style"]
        if style == "long":  # away from a parting, over the temples, and down the more the lower
            side = np.tanh((x - look["parting"]) / 0.25)
            steep = smooth((11.0 - y) / 7.0)
            front = smooth((z + 4.5) / 10)
            way = np.stack([side * (1.1 - 0.75 * steep), -0.2 - 1.2 * steep, -0.5 + 0.6 * front], 1)
            near = self.tree.query(points)[1]  # at the forehead it rises off the hairline first
            edge = smooth(1 - self.inside[near] / 1.6) * smooth((55 - self.turn[near]) / 30)
            off = np.stack([0.9 * side, 0.3 + 0 * x, -0.5 + 0 * x], 1)
            way = way * (1 - edge[:, None]) + edge[:, None] * off
        elif style == "frame":  # from the parting forward over the corners of the forehead
            side = np.tanh((x - look["parting"]) / 0.25)
            steep = smooth((10.8 - y) / 5.0)
            way = np.stack(
                [side * (1.0 - 0.65 * steep), -0.15 - 1.2 * steep, 0.25 * (1 - steep)], 1
            )
        elif style == "fringe":  # forward and over the forehead
            way = np.stack([0.07 * x, np.full_like(x, -1.0), np.full_like(x, 0.4)], 1)
        else:  # short: swept over on top, down and back at the sides
            top = smooth((y + 0.25 * (z - 4) - 8.6) / 2.4)
            swept = np.stack([np.full_like(x, look["sweep"]), 0.12 + 0 * x, -0.42 + 0 * x], 1)
            sides = np.stack([0 * x, -1 + 0 * x, -0.45 + 0 * x], 1)
            way = top[:, None] * swept + (1 - top[:, None]) * sides
        return tangent(way, normal)

    def tones(self, points):
        """Colours (N, 3) of cards over that of their picture: neighbours differ little."""
        least = self.look.get("least", 0.86)
        share = 0.5 + 0.5 * np.sin(points @ [1.3, 0.7, 1.1]) * np.cos(points @ [-0.6, 1.2, 0.8])
        light = least + (1 - least) * (0.6 * share + 0.4 * self.rng.random(len(points)))
        warm = 0.03 * self.rng.normal(size=len(points))
        return light[:, None] * (1 + warm[:, None] * [1.0, 0.0, -1.2])

    def buried(self, points):
        """How deep points of the hair (N, 3) lie below those about them, 0 to 1."""
        _, high, _ = self.surface(points)
        near = cKDTree(points).query(points, k=48)[1]
        return np.clip((high[near] - high[:, None]) / (0.5 * self.scale), 0, 1).mean(1)

    def ear(self, points):
        """1 at the ears, 0 far from them."""
        _, y, z = points.T / self.scale
        return np.exp(-(((y - 1.0) / 7.0) ** 2) - ((z + 1.8) / 3.5) ** 2)

    def swell(self, points, far, layer):
        """What long hair lies higher over the skin, cm: over ears and cheeks, and `far` from its roots."""
        _, y, z = points.T / self.scale
        cheeks = 0.8 * smooth((z + 0.5) / 2.5) * smooth((4.5 - y) / 2.5)  # which rise in a smile
        side = self.look["volume"] * layer.mean() * smooth((far - 3) / 8) * smooth((3.5 - z) / 4)
        return smooth(far / 5) * (1.8 * self.ear(points) + side + cheeks)

    def grown(self, points, heading, length, layer, *, rise, steps, style):
        """Curves (N, 3 steps + 1, 3) from roots and their headings, and the normals along them.

        They rise to the height `layer` (N,) over the scalp within `rise` cm.
        """
        normal, _, _ = self.surface(points)
        step = (length / (FINE * steps))[:, None]
        curve, across, before = [points], [normal], points
        most, turn = (0.4 * step, 0.5) if self.is_long else (np.inf, 0.4)
        for k in range(1, FINE * steps + 1):
            points = points + heading * step
            normal, high, distance = self.surface(points)
            far = k * step[:, 0]
            wanted = layer * smooth(far / rise) + 0.02
            if self.is_long:
                wanted = wanted + self.swell(points, far, layer)
            is_near = distance < (3.0 if self.is_long else 1.6) + wanted
            on_scalp = smooth((points[:, 1] / self.scale - self.look.get("falls", -99)) / 3.0)
            pull = np.where(high < wanted, 1, 0.5 * on_scalp) * is_near
            rising = ((wanted - high) * pull)[:, None]
            points = points + normal * np.clip(rising, -most, most)
            out = 0.12
            if self.is_long:  # in front of the ears it hangs close to the cheeks
                out = 0.03 - 0.17 * smooth(points[:, 2:] / self.scale / 3)
            target = unit(
                on_scalp[:, None] * self.flow(points, normal, style)
                + (1 - on_scalp[:, None]) * (DOWN + out * normal)
            )
            heading = unit((1 - turn) * unit(points - before) + turn * target)
            before = points
            curve.append(points)
            across.append(normal)
        curve, across = np.stack(curve, 1), np.stack(across, 1)
        if self.is_long:
            curve = gaussian_filter1d(curve, 1.5, axis=1, mode="nearest")
        return curve, across

    def cards(self, curves, across, width, tone, wisps, roll, inset, taper):
        """Two strips of triangles along each curve: points, places in the picture, faces, tones."""
        count, n = curves.shape[:2]
        along = unit(np.gradient(curves, axis=1))
        side = unit(np.cross(across, along))
        turn = roll * self.rng.normal(size=(count, 1, 1))
        side = unit(side * np.cos(turn) + np.cross(along, side) * np.sin(turn))
        narrow = self.look.get("narrow", 0.75)
        along = np.linspace(0, 1, n)
        half = 0.5 * width[:, None] * (narrow + (1 - narrow) * smooth(along / 0.3))
        half = half * (1 - taper * smooth((along - 0.4) / 0.6))
        points = np.stack([curves - side * half[..., None], curves + side * half[..., None]], 2)
        first = VARIANTS - WISPS if wisps else 0
        variant = self.rng.integers(first, VARIANTS if wisps else VARIANTS - WISPS, size=count)
        turned = self.rng.random(count) < 0.5
        edge = np.where(turned, 1 - inset, inset)
        u = np.stack([variant + edge, variant + 1 - edge], 1) / VARIANTS
        uv = np.empty((count, n, 2, 2))
        uv[..., 0], uv[..., 1] = u[:, None], 1 - np.linspace(0, 1, n)[:, None]
        at = (np.arange(count)[:, None] * n + np.arange(n - 1)).reshape(-1, 1) * 2
        faces = np.concatenate([at + [0, 2, 1], at + [2, 3, 1]])
        far = np.linspace(0, 1, n)[:, None].repeat(2, 1)
        root = 1 if wisps else self.look["root"]
        far = smooth(far / 0.4)[..., None]  # locks differ from each other off the scalp
        tones = (root + (1 - root) * far) * (
            tone.mean() + far * (tone[:, None, None] - tone.mean())
        )
        if self.look["style"] == "coils":
            uv = (uv + [coils.CARDS[0], 1 - coils.CARDS[1]]) / 2
        points = points.reshape(-1, 3)
        return points, np.arange(len(points)), uv.reshape(-1, 2), faces, tones.reshape(-1, 3)


def grow(person: Person, hair: Hair) -> Part:
    """Hair of a person; `tone` (drawn points, 3) multiplies the colour."""
    look, rng, s = person.look, hair.rng, person.size
    pieces = []
    for layer in look["layers"]:  # from the outside to the scalp
        count = layer["count"]
        points, within = hair.roots(
            count, layer.get("from", 0.25), layer.get("to", 99), layer.get("around", (0, 180)),
            layer.get("part", 99),
        )  # fmt: skip
        style = layer.get("style")
        length = s * layer["length"] * rng.uniform(0.75, 1.15, count)
        length *= hair.sides(points, layer)
        normal, _, _ = hair.surface(points)
        comb = hair.flow(points, normal, style)
        if "back" in layer:
            comb = unit(comb + layer["back"] * tangent(np.array([0, 0.5, -1.0]), normal))
        way = unit(comb + layer.get("stray", 0.1) * rng.normal(size=points.shape)
                   + layer.get("up", 0) * normal)  # fmt: skip
        uneven = (0.94, 1.04) if hair.is_long else (0.6, 1.2)
        high = s * layer["lift"] * rng.uniform(*uneven, count)
        if hair.is_long:  # what grows lower lies below what falls over it
            high *= 0.6 + 0.4 * smooth((points[:, 1] / s - 3) / 9)
        high *= np.clip(0.12 + within / 2.2, 0, 1)
        curves, across = hair.grown(
            points, way, length, high, rise=s * layer.get("rise", 2.0), steps=layer["steps"], style=style,
        )  # fmt: skip
        far = np.linspace(0, 1, curves.shape[1])[None, :, None] * length[:, None, None]
        if "fan" in layer:  # locks part from each other
            side = unit(np.cross(across, np.gradient(curves, axis=1)))
            curves = curves + side * smooth(far / 14) * rng.normal(0, layer["fan"], (count, 1, 1))
        if "wave" in layer:  # neighbours wave together
            turn = (points @ [[0.5, 0.9, 0.2], [0.7, 0.3, 0.6], [0.2, 0.8, 0.5]])[:, None]
            turn = turn + rng.normal(size=turn.shape) * 0.25
            wave = layer["wave"] * np.clip(far / 8, 0, 1) * np.sin(far / WAVE_CM + turn)
            wave -= ALONG * across * (wave * across).sum(-1, keepdims=True)
            curves = curves + wave
        if hair.is_long and style != "fringe":  # none falls over the face
            x, y, z = np.moveaxis(curves / s, -1, 0)
            edge = FACE[0] + rng.uniform(0, FACE_EDGE, (count, 1))
            off = ~((abs(x) < edge) & (y < FACE[1]) & (z > FACE[2])).any(1)
            curves, across, length, points = (a[off] for a in (curves, across, length, points))
            count = len(curves)
        arc = layer.get("arc", 0) * (points[:, 0] / (4 * s)) ** 2
        low = s * (layer.get("cut", -99) - arc + rng.normal(size=count) * layer.get("ends", 0.5))
        curves, across = _cut(curves, across, low)
        width = s * layer["width"] * rng.uniform(0.7, 1.25, count)
        tone = layer.get("tone", 1.0) * hair.tones(points)
        is_wisp = layer.get("wisps", False)
        roll, inset, taper = layer.get("roll", 0.2), layer.get("inset", 0), layer.get("taper", 0)
        pieces.append(hair.cards(curves, across, width, tone, is_wisp, roll, inset, taper))
    if "surfaces" in look:
        pieces.append(coils.surfaces(person, hair))
    points, drawn, uv, faces, tone = zip(*pieces, strict=True)
    first, first_drawn = (np.cumsum([0, *map(len, own[:-1])]) for own in (points, drawn))
    drawn = [own + k for own, k in zip(drawn, first, strict=True)]
    faces = [own + k for own, k in zip(faces, first_drawn, strict=True)]
    part = Part(*map(np.concatenate, (points, drawn, uv, faces)))
    part.faces = part.faces[::-1]
    part.tone = np.concatenate(tone)
    return part


def _far_apart(points, count):
    """Indices (count,) of points (N, 3) each of which is the farthest from those before it."""
    if count == len(points):
        return np.arange(count)
    kept, away = [0], np.full(len(points), np.inf)
    while len(kept) < count:
        away = np.minimum(away, np.linalg.norm(points - points[kept[-1]], axis=1))
        kept.append(int(np.argmax(away)))
    return np.array(kept)


def _cut(curves, across, low):
    """Curves and normals (N, n, 3) that end at heights (N,), with points closer at the roots."""
    count, last = curves.shape[0], curves.shape[1] - 1
    share = np.linspace(0, 1, last // FINE + 1) ** 1.35
    both = np.concatenate([curves, across], 2)
    found = np.empty((count, len(share), 6))
    for k in range(count):
        y, z = curves[k, 1:, 1:].T
        under = np.flatnonzero((y < low[k]) | (y < FRONT[0]) & (z > FRONT[1]))
        end = under[0] + 1 if len(under) else last
        found[k] = np.stack([np.interp(end * share, np.arange(last + 1), v) for v in both[k].T], 1)
    return found[..., :3], unit(found[..., 3:])
