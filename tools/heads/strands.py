"""Hair grown from the scalp: narrow cards that follow a combed flow and fall where it ends.

The hairline is a line round the average head (`LINE`). Cards are rooted over it, thinner and
shorter ones before it; they rise to a layer over the scalp, outer layers first, so that what they
hide is left out early.
"""

import numpy as np
from scipy.spatial import cKDTree

from tools.heads.parts import Part, Person

VARIANTS = 8
"""Columns of strands in their picture; each card shows one, the last ones are wisps."""
WISPS = 2
LINE = np.array([
    (0, 10.1), (14, 10.0), (27, 9.5), (38, 8.8), (47, 7.5), (54, 5.8), (61, 4.4), (67, 2.6),
    (72, 0.9), (78, 0.7), (82, 3.2), (88, 5.4), (104, 5.6), (116, 2.8), (126, -1.0), (138, -3.6),
    (152, -4.8), (180, -5.2),
])  # fmt: skip
"""Height of the hairline, cm, by degrees round the head from the middle of the forehead."""
AXIS_Z, ROUND_CM = -0.8, 7.6
"""Depth of the axis of `LINE`, and how far it is from the skin."""
FINE = 3
"""Steps in which each part of a card is worked out."""
DOWN = np.array([0.0, -1.0, 0.0])


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
    angle, line = around(points), LINE.copy()
    line[:, 1] += look["line"] * smooth((75 - line[:, 0]) / 25)
    burns = (line[:, 0] > 66) & (line[:, 0] < 86)
    line[burns, 1] = np.maximum(line[burns, 1], look["burns"])
    slope = np.gradient(line[:, 1], np.radians(line[:, 0]) * ROUND_CM)
    high = points[..., 1] - np.interp(angle, *line.T)
    high = high / np.sqrt(1 + np.interp(angle, line[:, 0], slope) ** 2)
    far = np.abs(points[..., 0])
    is_ear = (far > 7.75) & (np.abs(points[..., 1] - 1.5) < 4.4) & (points[..., 1] < 5.4)
    return np.where(is_ear, -9.0, high)


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
        self.tree = cKDTree(person.skin)
        self.scale = person.size

    def surface(self, points, count=10):
        """Smooth normal of the skin near points, and their height over it."""
        distance, near = self.tree.query(points, k=count)
        weight = 1 / (distance + 0.3) ** 2
        weight /= weight.sum(1, keepdims=True)
        skin, normals = self.person.skin[near], self.person.normals[near]
        normal = unit(np.einsum("pkc,pk->pc", normals, weight))
        return (
            normal,
            np.einsum("pkc,pc,pk->p", points[:, None] - skin, normal, weight),
            distance[:, 0],
        )

    def roots(self, count, low, high, turns):
        """Random places of the scalp between two distances within the hairline, and two angles round it."""
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
        )
        face = self.rng.choice(len(faces), count, p=area / area.sum())
        u, v = np.sqrt(self.rng.random((count, 1))), self.rng.random((count, 1))
        place = (1 - u) * a[face] + u * (1 - v) * b[face] + u * v * c[face]
        return place, within[face]

    def flow(self, points, normal, style=None):
        """Direction in which hair is combed at points near the scalp."""
        look, s = self.look, self.scale
        x, y, z = points.T / s
        style = style or look["style"]
        if style == "long":  # away from a parting, back, and down the more the lower
            side = np.tanh((x - look["parting"]) / 0.25)
            steep = smooth((11.5 - y) / 7.0)
            front = smooth((z - 1.0) / 6)
            way = np.stack(
                [side * (1.1 - 0.8 * steep), -0.25 - 1.2 * steep, -0.5 - 0.25 * front], 1
            )
            near = self.tree.query(points)[1]  # at the forehead away from the hairline
            back = smooth(1 - self.high[near] / 3.2) * smooth(
                (70 - around(self.average[near])) / 30
            )
            off = np.stack([0.5 * side, 0.3 + 0 * x, -1 + 0 * x], 1)
            way = way * (1 - back[:, None]) + 1.4 * back[:, None] * off
        elif style == "fringe":  # forward and over the forehead
            way = np.stack([0.07 * x, np.full_like(x, -1.0), np.full_like(x, 0.4)], 1)
        else:  # short: swept over on top, down and back at the sides
            top = smooth((y + 0.25 * (z - 4) - 8.6) / 2.4)
            swept = np.stack([np.full_like(x, look["sweep"]), 0.12 + 0 * x, -0.42 + 0 * x], 1)
            sides = np.stack([0 * x, -1 + 0 * x, -0.45 + 0 * x], 1)
            way = top[:, None] * swept + (1 - top[:, None]) * sides
        return tangent(way, normal)

    def grown(self, points, heading, length, layer, *, rise, steps, style):
        """Curves (N, 3 steps + 1, 3) from roots and their headings, and the normals along them.

        They rise to the height `layer` (N,) over the scalp within `rise` cm.
        """
        normal, _, _ = self.surface(points)
        step = (length / (FINE * steps))[:, None]
        curve, across, before = [points], [normal], points
        for k in range(1, FINE * steps + 1):
            points = points + heading * step
            normal, high, distance = self.surface(points)
            far = k * step[:, 0]
            wanted = layer * smooth(far / rise) + 0.02
            is_near = distance < 1.6 + layer
            on_scalp = smooth((points[:, 1] / self.scale - self.look.get("falls", -99)) / 3.0)
            pull = np.where(high < wanted, 1, 0.5 * on_scalp) * is_near
            points = points + normal * ((wanted - high) * pull)[:, None]
            target = unit(
                on_scalp[:, None] * self.flow(points, normal, style)
                + (1 - on_scalp[:, None]) * (DOWN + 0.12 * normal)
            )
            heading = unit(0.6 * unit(points - before) + 0.4 * target)
            before = points
            curve.append(points)
            across.append(normal)
        return np.stack(curve, 1), np.stack(across, 1)

    def cards(self, curves, across, width, tone, wisps, roll):
        """Two strips of triangles along each curve: points, places in the picture, faces, tones."""
        count, n = curves.shape[:2]
        along = unit(np.gradient(curves, axis=1))
        side = unit(np.cross(across, along))
        turn = roll * self.rng.normal(size=(count, 1, 1))
        side = unit(side * np.cos(turn) + np.cross(along, side) * np.sin(turn))
        half = 0.5 * width[:, None] * (0.75 + 0.25 * np.linspace(0, 1, n))
        points = np.stack([curves - side * half[..., None], curves + side * half[..., None]], 2)
        first = VARIANTS - WISPS if wisps else 0
        variant = self.rng.integers(first, VARIANTS if wisps else VARIANTS - WISPS, size=count)
        turned = self.rng.random(count) < 0.5
        u = np.stack([variant + turned, variant + 1 - turned], 1) / VARIANTS
        uv = np.empty((count, n, 2, 2))
        uv[..., 0], uv[..., 1] = u[:, None], 1 - np.linspace(0, 1, n)[:, None]
        at = (np.arange(count)[:, None] * n + np.arange(n - 1)).reshape(-1, 1) * 2
        faces = np.concatenate([at + [0, 2, 1], at + [2, 3, 1]])
        far = np.linspace(0, 1, n)[:, None].repeat(2, 1)
        root = 1 if wisps else self.look["root"]
        tones = tone[:, None, None] * (root + (1 - root) * smooth(far / 0.35))
        return points.reshape(-1, 3), uv.reshape(-1, 2), faces, tones.ravel()


def grow(person: Person, hair: Hair) -> Part:
    """Hair of a person; `tone` (drawn points) multiplies the colour."""
    look, rng, s = person.look, hair.rng, person.size
    pieces = []
    for layer in look["layers"]:  # from the outside to the scalp
        count = layer["count"]
        points, within = hair.roots(
            count, layer.get("from", 0.25), layer.get("to", 99), layer.get("around", (0, 180))
        )
        style = layer.get("style")
        length = s * layer["length"] * rng.uniform(0.75, 1.15, count)
        if "sides" in layer:  # shorter there
            y = points[:, 1] / s + 0.25 * (points[:, 2] / s - 4)
            length *= layer["sides"] + (1 - layer["sides"]) * smooth((y - 6.5) / 3.5)
        normal, _, _ = hair.surface(points)
        comb = hair.flow(points, normal, style)
        if "back" in layer:
            comb = unit(comb + layer["back"] * tangent(np.array([0, 0.5, -1.0]), normal))
        way = unit(comb + layer.get("stray", 0.1) * rng.normal(size=points.shape)
                   + layer.get("up", 0) * normal)  # fmt: skip
        high = s * layer["lift"] * rng.uniform(0.6, 1.2, count)
        high *= np.clip(0.25 + within / 2.0, 0, 1)
        curves, across = hair.grown(
            points, way, length, high, rise=s * layer.get("rise", 2.0), steps=layer["steps"], style=style,
        )  # fmt: skip
        if "wave" in layer:  # neighbours wave together
            far = np.linspace(0, 1, curves.shape[1])[None, :, None] * length[:, None, None]
            turn = (points @ [[0.5, 0.9, 0.2], [0.7, 0.3, 0.6], [0.2, 0.8, 0.5]])[:, None]
            turn = turn + rng.normal(size=turn.shape) * 0.5
            curves = curves + layer["wave"] * np.clip(far / 8, 0, 1) * np.sin(far / 2.4 + turn)
        low = s * (layer.get("cut", -99) + rng.normal(size=count) * layer.get("ends", 0.5))
        curves, across = _cut(curves, across, low)
        width = s * layer["width"] * rng.uniform(0.7, 1.25, count)
        tone = layer.get("tone", 1.0) * rng.uniform(0.76, 1.0, count)
        is_wisp = layer.get("wisps", False)
        pieces.append(hair.cards(curves, across, width, tone, is_wisp, layer.get("roll", 0.2)))
    points, uv, faces, tone, first = [], [], [], [], 0
    for own, places, triangles, tones in pieces:
        points.append(own)
        uv.append(places)
        faces.append(triangles + first)
        tone.append(tones)
        first += len(own)
    points = np.concatenate(points)
    part = Part(points, np.arange(len(points)), np.concatenate(uv), np.concatenate(faces))
    part.tone = np.concatenate(tone)
    return part


def _cut(curves, across, low):
    """Curves and normals (N, n, 3) that end at heights (N,), with points closer at the roots."""
    count, last = curves.shape[0], curves.shape[1] - 1
    share = np.linspace(0, 1, last // FINE + 1) ** 1.35
    both = np.concatenate([curves, across], 2)
    found = np.empty((count, len(share), 6))
    for k in range(count):
        under = np.flatnonzero(curves[k, 1:, 1] < low[k])
        end = under[0] + 1 if len(under) else last
        found[k] = np.stack([np.interp(end * share, np.arange(last + 1), v) for v in both[k].T], 1)
    return found[..., :3], unit(found[..., 3:])
