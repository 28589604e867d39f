"""Parts of one person on the base mesh: eyes, teeth, tongue, lashes, brows, shirt.

A part has its points, drawn points with picture coordinates of its own picture (v upwards),
triangles of those, and where it has any its own displacements.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from rig.face.mesh import smoothstep
from tools.heads.base import CM, Base, Proxy, eye_of, normals, split
from tools.heads.shapes import Shapes

IRIS = np.radians(23.5)
"""Angle of the iris's rim from the axis of the eye."""
EYE_EDGE = np.radians(105.0)
RINGS, SPOKES = 22, 36
BULGE = 0.06
"""Height of the cornea over the ball, in radii."""
_SETTLE = {"upper": (-0.24, 0.35), "lower": (-0.26, 0.60)}
"""Shift of each row of teeth upwards, and how far its front stands behind the middle of the line
where the lips meet, cm; small heads have more, for their lips move as far."""
_GUM = 0.05
"""How far gums stand back from where they are beside their teeth, cm."""
_TEETH = {
    "upper": [(1.0, 0.17, 0.012, 0), (0.86, 0.21, 0.01, 0), (0.97, 0.28, 0, 0.03), (1, 0.28, 0.03, 0.03),
              (1, 0.22, 0.03, 0.03), (1, 0.1, 0, 0)],
    "lower": [(0.88, 0.12, 0.01, 0), (0.94, 0.12, 0.015, 0), (1.02, 0.07, 0, 0.03), (1, -0.03, 0.03, 0.03),
              (1, -0.14, 0, 0), (1, -0.22, 0, 0), (1, -0.3, 0, 0), (1, -0.3, 0, 0)],
}  # fmt: skip
"""Teeth from the middle outwards: share of the width, added length, how far the corners of the edge
are rounded and how far its middle is a point, cm; the others as they are."""
_SQUARE = 0.14
"""How far the corners of all edges are filled first, cm: rows have no holes between teeth."""
_MIDLINE = 0.018
"""How far both halves of a row go to the middle, cm."""
_ENAMEL = {"upper": (1.0, 0.955, 0.895), "lower": (0.85, 0.775, 0.70)}
"""Colour of each row over its picture: lower teeth are in the shadow of the upper ones."""
_ASIDE = np.array([0.96, 0.945, 0.925])
"""Colour of a tooth over that of the one before it, from the lateral incisors on."""
_BETWEEN = 0.22
"""How much darker a tooth is beside the next one, where it turns back."""


@dataclass
class Part:
    """Points, which of them are drawn where, and triangles of drawn points."""

    points: np.ndarray
    drawn: np.ndarray
    uv: np.ndarray
    faces: np.ndarray
    deltas: dict[str, np.ndarray] = field(default_factory=dict)
    near: np.ndarray | None = None
    weight: np.ndarray | None = None
    proxy: object = None

    def chosen(self, is_kept):
        """The part with those triangles alone."""
        faces = self.faces[is_kept]
        used, faces = np.unique(faces, return_inverse=True)
        points, drawn = np.unique(self.drawn[used], return_inverse=True)
        of = {name: delta[points] for name, delta in self.deltas.items()}
        near, weight = (None if a is None else a[points] for a in (self.near, self.weight))
        return Part(
            self.points[points], drawn, self.uv[used], faces.reshape(-1, 3), of, near, weight
        )


class Person:
    """State and parts of one person, cm, in the tool's own frame (`Base.origin`)."""

    def __init__(self, base: Base, shapes: Shapes, look: dict) -> None:
        self.base, self.shapes, self.look = base, shapes, look
        points = base.person(look["mix"], look["details"])
        self.state = shapes.rest_of(points)
        self.skin = self.state[: base.n_skin]
        self.normals = normals(self.skin, base.skin_faces)
        self.points = CM * points - base.origin(points)
        known = base.place >= 0
        self.points[known] = self.state[base.place[known]]
        corners = [np.linalg.norm(s[self.corner(1)] - s[self.corner(-1)])
                   for s in (self.state, shapes.rest)]  # fmt: skip
        eyes = [np.linalg.norm(self._middle(s, "l") - self._middle(s, "r"))
                for s in (self.state, shapes.rest)]  # fmt: skip
        self.size = 0.4 * eyes[0] / eyes[1] + 0.6 * corners[0] / corners[1]
        self.eyes = [eye_of(self.state, base, s) for s in "lr"]
        self.parts = self._parts()

    def corner(self, sign):
        """Point of the skin at the corner of the mouth, of the left (1) or the right (-1)."""
        x = self.shapes.rest[: self.base.n_skin]
        return int(np.argmin(np.linalg.norm(x - [2.56 * sign, -3.63, 9.49], axis=1)))

    def _middle(self, state, s):
        return state[self.base.at(f"helper-{s}-eye")].mean(0)

    def _parts(self):
        base, found = self.base, {}
        for name, (center, radius), sign in zip(
            ("eye_L", "eye_R"), self.eyes, (1, -1), strict=True
        ):
            found[name] = _ball(center, radius, f"CTRL_{name[-1]}_eye_pupil.ty", sign)
        teeth = self._proxy("teeth/Teeth_Base/Teeth_Base.json")
        is_low = np.isin(teeth.proxy.refs, base.group("helper-lower-teeth")).any(1)
        for row, of_row in (("upper", ~is_low), ("lower", is_low)):
            part = teeth.chosen(of_row[teeth.drawn[teeth.faces[:, 0]]])
            forward = self._set_teeth(part, row)
            found[f"teeth_{row}"] = part
        found["tongue"] = self._proxy("tongue/tongue01/tongue01.json")
        found["tongue"].points = _rounded(found["tongue"].points) + [0, 0, 0.6 * forward]
        lashes = self._proxy("eyelashes/eyelashes02/eyelashes02.json", moves=False)
        brows = self._proxy(
            "eyebrows/eyebrow{0}/eyebrow{0}.json".format(self.look["brow"]), moves=False
        )
        out = np.abs(brows.points[:, 0])
        brows.points[:, 1] += self.look.get("brow_tilt", 0) * (out - out.mean())
        self._lift(brows)
        self._follow_lids(lashes)
        self._follow_columns(brows)
        for name, both in (("lash", lashes), ("brow", brows)):
            x = both.points[both.drawn[both.faces]].mean(1)[:, 0]
            for s, of_side in (("L", x > 0), ("R", x <= 0)):
                found[f"{name}_{s}"] = both.chosen(of_side)
        for s in "LR":
            self._shorten(found[f"lash_{s}"])
            self._tweak(found[f"lash_{s}"], s)
        shirt = self._proxy("clothes/{0}/{0}.json".format(self.look["shirt"]), moves=False)
        x = shirt.points[shirt.drawn[shirt.faces]]
        shirt = shirt.chosen((x[..., 1].min(1) > -34) & (np.abs(x[..., 0]).max(1) < 30))
        shirt.points = self._outside(shirt.points, 0.3, 1.6)
        return found | {"shirt": shirt}

    def _set_teeth(self, part, row):
        """Shape single teeth and set the row behind the lip; how far it went forward, cm."""
        up, back = _SETTLE[row]
        sign = -1 if row == "upper" else 1  # of the way from a tooth's root to its edge
        labels = _pieces(part)
        gum = np.bincount(labels).argmax()
        teeth = [np.flatnonzero(labels == k) for k in np.unique(labels) if k != gum]
        points, part.tone = part.points.copy(), np.ones((len(part.points), 3))
        rng = np.random.default_rng(self.look["iris"])
        for side in (1, -1):
            own = [ids for ids in teeth if side * points[ids, 0].mean() > 0]
            own.sort(key=lambda ids: -points[ids, 2].max())
            ends = np.array([points[ids].mean(0) for ids in own])
            along = np.gradient(ends * [1, 0, 1], axis=0)
            along[0], moved = [side, 0, -0.15], _MIDLINE
            for k, ids in enumerate(own):
                shape = _TEETH[row][k] if k < len(_TEETH[row]) else (1, 0, 0, 0)
                tilt = rng.normal(0, [0.02, 0.03]) * (0 < k < 5)
                points[ids], edge, narrower = _shaped(points[ids], along[k], sign, shape, tilt)
                points[ids] -= (moved + narrower / 2) * along[k] / np.linalg.norm(along[k])
                moved += narrower
                part.tone[ids] = _tone(edge, k) * _ENAMEL[row] * _ASIDE ** max(k - 1, 0)
                beside = np.abs((points[ids] - points[ids].mean(0)) @ along[k])
                part.tone[ids] *= 1 - _BETWEEN * (beside / beside.max())[:, None] ** 6
        gum, depth = np.flatnonzero(labels == gum), points[:, 2].max() - points[:, 2]
        points[gum, 2] -= _GUM
        palate = smoothstep((depth - 0.8) / 0.8) * smoothstep((2.0 - np.abs(points[:, 0])) / 0.6)
        part.tone[gum] = 0.92 - 0.6 * palate[gum, None]
        size = self.size**0.6
        front = max(points[ids, 2].max() for ids in teeth)
        edge = sign * max(sign * points[ids, 1].mean() for ids in teeth)
        points = (points - [0, edge, front]) * size + [0, edge, front]
        rim = self.shapes.rim_weights[0] @ self.state[self.shapes.rims[0]]
        forward = rim[len(rim) // 2, 2] - back / size - front
        deep = smoothstep((sign * (edge - points[:, 1]) - 0.7) / 0.9)  # behind the chin, the nose
        part.points = points + [0, up * size, forward] - np.outer(deep, [0, 0, max(forward, 0)])
        return forward

    def _proxy(self, path, moves=True):
        proxy = Proxy(self.base, path)
        drawn, places, faces = split(proxy.faces, proxy.uv_faces)
        part = Part(proxy.fitted(self.points), drawn, proxy.uv[places], faces)
        part.proxy = proxy
        if moves:
            deltas = proxy.moved(self.base, self.shapes.deltas)
            moved = np.abs(deltas).max((1, 2)) > 1e-3
            part.deltas = {
                n: d for n, d, m in zip(self.shapes.names, deltas, moved, strict=True) if m
            }
        return part

    def _surface(self, points, count=4):
        """Nearest place of the skin, its normal, distance, and height over it."""
        distance, near = cKDTree(self.skin).query(points, k=count)
        weight = 1 / (distance + 1e-3) ** 2
        weight /= weight.sum(1, keepdims=True)
        place, normal = (
            np.einsum("pkc,pk->pc", a[near], weight) for a in (self.skin, self.normals)
        )
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        return normal, distance[:, 0], ((points - place) * normal).sum(1)

    def _outside(self, points, least, reach):
        for _ in range(3):
            normal, distance, height = self._surface(points)
            points = (
                points
                + normal * np.where(distance < reach, np.maximum(least - height, 0), 0)[:, None]
            )
        return points

    def _lift(self, brows):
        normal, _, height = self._surface(brows.points, 6)
        brows.points = brows.points + normal * (np.clip(height, 0.09, 0.16) - height)[:, None]

    def _follow_lids(self, lashes):
        near = np.zeros(len(self.skin), bool)
        for center, radius in self.eyes:
            far = np.linalg.norm(self.skin - center, axis=1)
            near |= (far < 1.16 * radius) & (self.skin[:, 2] > center[2] + 0.2 * radius)
        ids = np.flatnonzero(near)
        distance, nearest = cKDTree(self.skin[ids]).query(lashes.points, k=3)
        weight = np.exp(-((distance / 0.12) ** 2)) + 1e-9
        lashes.near, lashes.weight = ids[nearest], weight / weight.sum(1, keepdims=True)

    def _follow_columns(self, brows, count=16):
        """A brow's points go with the skin below the middle of the brow near their column: rigidly."""
        x, skin = brows.points, self.skin
        brows.near, brows.weight = np.zeros((len(x), count), int), np.zeros((len(x), count))
        front = np.flatnonzero(cKDTree(x).query(skin)[0] < 0.6)
        for sign in (1, -1):
            own = sign * x[:, 0] > 0
            middle = [np.polynomial.Polynomial.fit(x[own, 0], x[own, k], 3) for k in (1, 2)]
            at = np.linspace(x[own, 0].min(), x[own, 0].max(), count)
            line = np.stack([at, *(fit(at) for fit in middle)], 1)
            ids = front[cKDTree(skin[front]).query(line)[1]]
            away = (skin[ids, 0] - x[own, :1]) / 0.45
            brows.near[own] = ids
            brows.weight[own] = np.exp(-(away**2)) + 1e-9
        brows.weight /= brows.weight.sum(1, keepdims=True)

    def _shorten(self, lash):
        """Lashes end closer to the lid, most of all at the outer corner."""
        root = np.einsum("pkc,pk->pc", self.skin[lash.near], lash.weight)
        out = np.abs(lash.points[:, 0])
        along = (out - out.min()) / np.ptp(out)
        length = self.look.get("lash_length", 1.0) * (0.7 - 0.3 * along**3)
        lash.points = root + (lash.points - root) * length[:, None]

    def _tweak(self, lash, s):
        """Lashes turn about their roots: inner and outer half."""
        root = np.einsum("pkc,pk->pc", self.skin[lash.near], lash.weight)
        off = lash.points - root
        along = (np.abs(lash.points[:, 0]) - np.abs(lash.points[:, 0]).min()) / np.ptp(
            lash.points[:, 0]
        )
        down = 0.35 * np.stack([0 * along, -np.maximum(off[:, 2], 0.1), off[:, 1]], 1)
        for half, share in (
            ("In", np.clip(1 - 2 * along, 0, 1)),
            ("Out", np.clip(2 * along - 1, 0, 1)),
        ):
            name = f"CTRL_{s}_eyelashes_tweaker{half}.ty"
            lash.deltas[name], lash.deltas[f"{name}_negative"] = (
                down * share[:, None],
                -down * share[:, None],
            )


def _pieces(part):
    """Number of the connected piece that each point of a part belongs to."""
    a = part.drawn[part.faces]
    ends = a.ravel(), np.roll(a, 1, 1).ravel()
    count = len(part.points)
    return connected_components(coo_matrix((np.ones(a.size), ends), (count, count)), False)[1]


def _shaped(tooth, along, sign, shape, tilt):
    """Points of a tooth by a row of `_TEETH`, turned by two small angles; each one's way from the
    root (0) to the edge (1); how much narrower the tooth is, cm.
    """
    width, longer, rounded, pointed = shape
    middle, along = tooth.mean(0), along / np.linalg.norm(along)
    across = (tooth - middle) @ along
    share = np.abs(across) / np.abs(across).max()
    high = sign * (tooth[:, 1] - middle[1])
    edge = np.clip((high - high.min()) / np.ptp(high), 0, 1)
    corner = rounded * share**2 * np.where(across > 0, 1, 0.3)  # more away from the middle
    corner -= _SQUARE * share**4
    grown = longer * edge - (corner + pointed * share) * edge**2
    tooth = tooth + np.outer(sign * grown, [0, 1, 0])
    turn = (width - 1) * across + tilt[0] * sign * high + tilt[1] * (tooth - middle)[:, 2]
    return tooth + turn[:, None] * along, edge, (1 - width) * np.ptp(across)


def _tone(edge, place):
    """Colour of a tooth from root (0) to edge (1): warm by the gum, grey and blue at the edge."""
    warm = np.clip((0.85 - edge) / 0.5, 0, 1)[:, None] ** 1.3
    yellow = {2: 0.07}.get(place, 0.025 * (place > 2))
    tip = np.clip((edge - 0.85) / 0.15, 0, 1)[:, None] * (place < 2)
    return (
        (1 - warm * [0.16, 0.28, 0.36])
        * (1 - tip * [0.10, 0.07, 0.04])
        * [1, 1 - 0.4 * yellow, 1 - yellow]
    )


def _rounded(tongue):
    """A tongue's points at rest: low in the mouth, round across, with a groove in the middle."""
    x, y, z = tongue.T
    back = (z.max() - z) / np.ptp(z)
    near = np.abs(z[:, None] - z) < 0.6
    half = np.where(near, np.abs(x), 0).max(1)
    low, high = np.where(near, y, np.inf).min(1), np.where(near, y, -np.inf).max(1)
    top = (y - low) / np.maximum(high - low, 1e-6)
    across = np.minimum(np.abs(x) / half, 1)
    fall = 0.15 + 0.85 * np.clip(back / 0.5, 0, 1) + 0.6 * across**2
    fall = fall + 0.16 * np.exp(-((x / 0.3) ** 2)) * np.clip(back / 0.2, 0.3, 1)
    return tongue - np.outer(np.clip(top, 0.2, 1) * fall, [0, 1, 0])


def _ball(center, radius, pupil, sign):
    """An eye with a cornea; its picture shows angle from the axis as `eye_place`."""
    angle = EYE_EDGE * np.linspace(0, 1, RINGS) ** 1.35
    turn = np.linspace(0, 2 * np.pi, SPOKES, endpoint=False)
    a, b = np.meshgrid(angle, turn, indexing="ij")
    grow = 1 + BULGE * np.clip(1 - (a / (1.15 * IRIS)) ** 2, 0, 1)
    unit = np.stack([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)], -1)
    points = (radius * grow[..., None] * unit).reshape(-1, 3)
    far = 0.5 * eye_place(a)
    uv = np.stack([0.5 + far * np.cos(b) * sign, 0.5 + far * np.sin(b)], -1).reshape(-1, 2)
    i = np.arange(RINGS - 1)[:, None] * SPOKES + np.arange(SPOKES)
    j = np.arange(RINGS - 1)[:, None] * SPOKES + (np.arange(SPOKES) + 1) % SPOKES
    faces = np.concatenate([np.stack(t, -1).reshape(-1, 3)
                            for t in ((i, i + SPOKES, j), (j, i + SPOKES, j + SPOKES))])  # fmt: skip
    # A wide pupil moves the iris's points outwards; the picture goes with them.
    share = np.clip(a / (0.4 * IRIS), 0, 1) * np.clip((IRIS - a) / (0.6 * IRIS), 0, 1)
    out = np.stack([np.cos(a) * np.cos(b), np.cos(a) * np.sin(b), -np.sin(a)], -1)
    wide = (0.14 * radius * share[..., None] * out).reshape(-1, 3)
    deltas = {pupil: wide, f"{pupil}_negative": -0.7 * wide}
    return Part(center + points, np.arange(len(points)), uv, faces, deltas)


def eye_place(angle):
    """Distance from the middle of the eye's picture, 0 to 1, of an angle from the axis."""
    return (np.clip(angle, 0, EYE_EDGE) / EYE_EDGE) ** 0.7
