"""Parts of one person on the base mesh: eyes, teeth, tongue, lashes, brows, shirt.

A part has its points, drawn points with picture coordinates of its own picture (v upwards),
triangles of those, and where it has any its own displacements.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from tools.heads import teeth
from tools.heads.base import CM, Base, Proxy, averaged, eye_of, halved, normals, split
from tools.heads.shapes import Shapes

IRIS = np.radians(23.5)
"""Angle of the iris's rim from the axis of the eye."""
EYE_EDGE = np.radians(105.0)
RINGS, SPOKES = 22, 36
BULGE = 0.06
"""Height of the cornea over the ball, in radii."""
_BEHIND = {"upper": 0.35, "lower": 0.62}
"""How far the front of each row stands behind the middle of the line where the lips meet, cm."""
LASHES_FROM = 2.15
"""Least distance of lashes from the middle of the average face, cm: none at the inner corners."""
_EDGE = {"upper": -0.28, "lower": 0.25}
"""Height of the incisors' edges over that line, cm, the teeth together."""


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
        self.state = self._with_lids(shapes.rest_of(points), look.get("lids", (0, 0)))
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

    def _with_lids(self, state, risen):
        """A state whose upper and lower lids are so much higher, cm; they turn about the eyes."""
        out = state.copy()
        for s in "LR":
            center, radius = eye_of(state, self.base, s.lower())
            for unit, high in zip((f"eyeWide_{s}", f"lidD_{s}"), risen, strict=True):
                delta = self.shapes.units[unit]
                out += high / delta[:, 1].max() * delta
            near = np.linalg.norm(state - center, axis=1)
            share = np.clip(3 - 2 * near / radius, 0, 1)[:, None]
            off = out - center
            turned = off * (near / np.maximum(np.linalg.norm(off, axis=1), 1e-6))[:, None]
            out += share * (center + turned - out)
        return out

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
        for row in teeth.ROWS:
            found[f"teeth_{row}"] = self._teeth(row)
        found["tongue"] = self._tongue()
        lashes = self._proxy("eyelashes/eyelashes02/eyelashes02.json", moves=False)
        brows = self._proxy(
            "eyebrows/eyebrow{0}/eyebrow{0}.json".format(self.look["brow"]), moves=False
        )
        out = np.abs(brows.points[:, 0])
        brows.points[:, 1] += self.look.get("brow_tilt", 0) * (out - out.mean())
        self._lift(brows)
        self._follow_lids(lashes)
        self._follow_columns(brows)
        for name, both, least in (("lash", lashes, LASHES_FROM), ("brow", brows, 0)):
            average = both.proxy.fitted(CM * base.average)  # the same triangles of all people
            x = average[both.drawn[both.faces]].mean(1)[:, 0]
            for s, of_side in (("L", x > least), ("R", x <= -least)):
                found[f"{name}_{s}"] = both.chosen(of_side)
        for s in "LR":
            self._shorten(found[f"lash_{s}"])
            self._tweak(found[f"lash_{s}"], s)
        shirt = self._proxy("clothes/{0}/{0}.json".format(self.look["shirt"]), moves=False)
        x = shirt.points[shirt.drawn[shirt.faces]]
        shirt = shirt.chosen((x[..., 1].min(1) > -34) & (np.abs(x[..., 0]).max(1) < 30))
        shirt.points = self._outside(shirt.points, 0.3, 1.6)
        return found | {"shirt": shirt}

    def _teeth(self, name):
        """A row of teeth behind the lips; it moves as the base mesh's helper points do."""
        points, faces = teeth.grid(name, self.look["iris"])
        size = self.size**0.6
        place = self._lip_middle() + [0, _EDGE[name] * self.size, -_BEHIND[name] / size]
        points = size * points.reshape(-1, 3) + place
        part = Part(points, np.arange(len(points)), teeth.places(name).reshape(-1, 2), faces)
        at = self.base.at(f"helper-{name}-teeth")
        known, own = (np.insert(x, 0, 1, axis=1) for x in (self.state[at], points))
        for shape, delta in zip(self.shapes.names, self.shapes.deltas[:, at], strict=True):
            if np.abs(delta).max() > 1e-2:
                part.deltas[shape] = own @ np.linalg.lstsq(known, delta, rcond=None)[0]
        return part

    def _tongue(self):
        """The tongue with four times its triangles, low in the mouth."""
        part = self._proxy("tongue/tongue01/tongue01.json")
        welded, count = part.drawn[part.faces], len(part.points)
        by_half, faces = halved(welded, count)
        finer = averaged(faces, by_half.shape[0]) @ by_half
        halves, drawn_faces = halved(part.faces, len(part.drawn))
        drawn = np.empty(halves.shape[0], int)
        drawn[drawn_faces] = faces
        part.points = finer @ _rounded(part.points) + [0, 0, 0.6 * self._forward()]
        part.deltas = {name: finer @ delta for name, delta in part.deltas.items()}
        part.drawn, part.uv, part.faces = drawn, halves @ part.uv, drawn_faces
        return part

    def _lip_middle(self):
        """Middle of the line where the lips meet."""
        rim = self.shapes.rim_weights[0] @ self.state[self.shapes.rims[0]]
        return rim[len(rim) // 2]

    def _forward(self):
        """How far in front of its helper points the lower row stands, cm."""
        helper = self.state[self.base.at("helper-lower-teeth")]
        return self._lip_middle()[2] - _BEHIND["lower"] / self.size**0.6 - helper[:, 2].max()

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
            away = (skin[ids, 0] - x[own, :1]) / 0.6
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


def _rounded(tongue):
    """A tongue's points at rest: low in the mouth, round across, with a groove in the middle."""
    x, y, z = tongue.T
    back = (z.max() - z) / np.ptp(z)
    near = np.abs(z[:, None] - z) < 0.6
    half = np.where(near, np.abs(x), 0).max(1)
    low, high = np.where(near, y, np.inf).min(1), np.where(near, y, -np.inf).max(1)
    top = (y - low) / np.maximum(high - low, 1e-6)
    across = np.minimum(np.abs(x) / half, 1)
    fall = 0.15 + 0.85 * np.clip(back / 0.5, 0, 1) + 0.35 * across**2
    fall = fall + 0.16 * np.exp(-((x / 0.3) ** 2)) * np.clip(back / 0.2, 0.3, 1)
    tip = np.clip(1 - back / 0.4, 0, 1)
    narrow = np.stack([0.24 * tip**1.5 * x, 0 * x, 0.35 * tip * across**2], 1)
    return tongue - narrow - np.outer(np.clip(top, 0.2, 1) * fall, [0, 1, 0])


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
