"""Strands of hair: narrow cards that follow the hair's surface and stand at its edge.

The fitted hair is a shell with a hard edge. Cards over it break its outline; cards that stand on
the skin before its edge, more of them towards it, make the hairline soft.
"""

import numpy as np
from scipy.spatial import cKDTree

from tools.heads.parts import Part, Person

VARIANTS = 8
"""Columns of strands in their picture; each card shows one."""
DOWN = np.array([0.0, -1.0, 0.0])


def unit(x):
    """Vectors of length 1."""
    return x / np.maximum(np.linalg.norm(x, axis=-1, keepdims=True), 1e-9)


def scattered(points, faces, count, rng, weight=None):
    """Random places on triangles, by area, their normals, and on which they are."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    area = np.linalg.norm(cross, axis=1) * (1 if weight is None else weight)
    chosen = rng.choice(len(faces), count, p=area / area.sum())
    u, v = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    place = (1 - u) * a[chosen] + u * (1 - v) * b[chosen] + u * v * c[chosen]
    return place, unit(cross[chosen]), chosen


def _down_picture(hair):
    """Direction on each triangle of a part in which its picture goes down."""
    a, b, c = (hair.uv[hair.faces[:, k]] for k in range(3))
    p, q, r = (hair.points[hair.drawn[hair.faces[:, k]]] for k in range(3))
    (ux, uy), (vx, vy) = (b - a).T[..., None], (c - a).T[..., None]
    return unit((vx * (q - p) - ux * (r - p)) * np.sign(ux * vy - uy * vx))


class Hair:
    """The surface of a person's hair, and the skin below it, to lay cards on.

    Parameters
    ----------
    alpha : array [shape=(A, A)]
        How much of the hair's picture is there, first row at the top.
    """

    def __init__(self, person: Person, alpha: np.ndarray) -> None:
        self.person, hair = person, person.parts["hair"]
        self.rng = np.random.default_rng(8)
        side = len(alpha)
        middle = hair.uv[hair.faces].mean(1)
        x = np.clip(middle[:, 0] * side, 0, side - 1).astype(int)
        y = np.clip((1 - middle[:, 1]) * side, 0, side - 1).astype(int)
        faces = hair.drawn[hair.faces]
        place, normal, chosen = scattered(hair.points, faces, 60_000, self.rng, alpha[y, x] > 0.5)
        axis = np.array([0.0, 3.0, -1.0])
        axis = np.where(place[:, 1:2] > 3, axis, place * [0, 1, 0] + [0, 0, -1.0])
        self.place = place
        flow = _down_picture(hair)[chosen] if person.look["flow"] == "picture" else DOWN
        self.flow = np.broadcast_to(flow, place.shape)
        self.normal = normal * np.sign(((place - axis) * normal).sum(1))[:, None]
        self.tree, self.skin = cKDTree(place), cKDTree(person.skin)

    def on(self, points, lift):
        """Points set on the hair's outer surface, `lift` over it, where it is near; its normals, its flow."""
        distance, near = self.tree.query(points, k=24)
        normal = unit(self.normal[near].mean(1))
        off = self.place[near] - points[:, None]
        high = np.einsum("pkc,pc->pk", off, normal)
        beside = np.sqrt(np.maximum((off**2).sum(-1) - high**2, 0))
        high = np.where(beside < 0.4, high, -np.inf).max(1)
        is_near = (distance[:, 0] < 0.7) & np.isfinite(high)
        points = points + np.where(is_near[:, None], normal * (high + lift)[:, None], 0)
        flow = self.flow[near[:, :4]].mean(1)
        flow = unit(flow - normal * (flow * normal).sum(1, keepdims=True))
        return points, normal, np.where(is_near[:, None], flow, DOWN), is_near

    def over_skin(self, points, lift):
        """Points kept out of the skin, and the skin's normals."""
        distance, near = self.skin.query(points, k=3)
        weight = 1 / (distance + 1e-3)
        weight /= weight.sum(1, keepdims=True)
        place, normal = (
            np.einsum("pkc,pk->pc", a[near], weight)
            for a in (self.person.skin, self.person.normals)
        )
        normal = unit(normal)
        high = ((points - place) * normal).sum(1)
        is_near = distance[:, 0] < 1.0
        up = np.where(is_near, np.maximum(lift - high, 0), 0)
        return points + normal * up[:, None], normal, is_near

    def curves(self, points, way, length, lift, hold, count=4):
        """Curves (N, count + 1, 3) along the hair from points, and the normals there."""
        found, across = [points], []
        step = (length / count)[:, None]
        for k in range(count + 1):
            share = k / count
            on, normal, fall, is_on = self.on(points, lift * (0.3 + share))
            off, of_skin, is_near = self.over_skin(on, 0.02 + 0.5 * lift * share)
            normal = np.where((is_near & ~is_on)[:, None], of_skin, normal)
            points = off
            found[-1] = points
            across.append(normal)
            way = way - normal * (way * normal).sum(1, keepdims=True) * is_on[:, None]
            way = unit(hold * unit(way) + (1 - hold) * fall)
            if k < count:
                found.append(points + way * step)
                points = found[-1]
        return np.stack(found, 1), np.stack(across, 1)

    def cards(self, curves, across, width, tone):
        """Two strips of triangles along each curve: points, places in the picture, faces, tones."""
        count, n = curves.shape[:2]
        along = unit(np.gradient(curves, axis=1))
        side = unit(np.cross(across, along)) * (0.5 * width)[:, None, None]
        points = np.stack([curves - side, curves + side], 2).reshape(-1, 3)
        variant = self.rng.integers(VARIANTS, size=count)
        turned = self.rng.random(count) < 0.5
        u = np.stack([variant + turned, variant + 1 - turned], 1) / VARIANTS
        uv = np.empty((count, n, 2, 2))
        uv[..., 0], uv[..., 1] = u[:, None], 1 - np.linspace(0, 1, n)[:, None]
        first = (np.arange(count)[:, None] * n + np.arange(n - 1)).reshape(-1, 1) * 2
        faces = np.concatenate([first + [0, 1, 2], first + [2, 1, 3]])
        return points, uv.reshape(-1, 2), faces, np.repeat(tone, 2 * n)

    def edge(self, look):
        """Roots on the skin before the hair's edge: places, ways into the hair, distances."""
        skin, faces = self.person.skin, self.person.base.skin_faces
        middle = skin[faces].mean(1)
        inside = (middle[:, 1] > look["edge_from"]) & (middle[:, 2] > -4)
        inside &= (np.abs(middle[:, 0]) < 6.9) | (middle[:, 1] > 5) | (middle[:, 2] > 3)  # no ear
        place, normal, _ = scattered(skin, faces, 60_000, self.rng, inside)
        distance, near = self.tree.query(place)
        way = self.place[near] - place
        over = [self.tree.query(place + h * normal)[0] for h in (0.0, 0.3, 0.6, 1.0, 1.5, 2.0)]
        keep = np.min(over, 0) > 0.22  # no hair over it
        keep &= distance < look["edge"] * self.rng.random(len(place)) ** 1.4
        place, way, normal = place[keep], way[keep], normal[keep]
        way = unit(way - normal * (way * normal).sum(1, keepdims=True))
        if self.person.look["flow"] == "picture":
            flow = self.flow[near][keep]
            way = unit(0.6 * way + flow - normal * (flow * normal).sum(1, keepdims=True))
        return place, way


def strands(person: Person, hair: Hair) -> Part:
    """All cards of a person; `tone` (drawn points) multiplies the colour."""
    look, rng = person.look, hair.rng
    pieces = []
    for kind, count in (("over", look["cards"]), ("edge", look["edge_cards"])):
        if kind == "over":
            weight = 1 + 2 * np.clip(hair.normal @ [0, 0.4, 1], 0, 1)  # most where people look
            chosen = rng.choice(len(hair.place), count, replace=False, p=weight / weight.sum())
            points, _, way, _ = hair.on(hair.place[chosen], 0)
            length = look["strand"] * rng.uniform(0.6, 1.3, count)
            hold = 0.6
        else:
            points, way = hair.edge(look)
            chosen = rng.permutation(len(points))[:count]
            points, way = points[chosen], way[chosen]
            length, hold = rng.uniform(0.9, 2.0, len(points)) * look["edge_length"], 0.8
        way = unit(way + 0.35 * look["stray"] * rng.normal(size=way.shape))
        wide = look["width"] * rng.uniform(0.6, 1.3, len(points)) * (1 if kind == "over" else 0.6)
        lift = 0.05 + look["lift"] * rng.uniform(0.2, 1.0, len(points)) ** 3
        curves, across = hair.curves(points, way, length, lift, hold)
        tone = rng.uniform(0.75, 1.0, len(points))
        kept = hair.tree.query(curves[:, -1])[0] < 0.9  # none hangs alone
        pieces.append(hair.cards(curves[kept], across[kept], wide[kept], tone[kept]))
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
