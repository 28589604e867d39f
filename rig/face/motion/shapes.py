"""Linear shapes of the face, made from a few numbers.

A shape is authored once, symmetric, on the character's left (x > 0). It states how the lips'
loops move, where some points of the face go, and where the skin folds; the rest follows as a
thin plate. Most shapes are then split into a left and a right half that add up to the whole.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import SuperLU, splu

from rig.arrays import Bool, Float64, Int64
from rig.face.geometry import topology
from rig.face.geometry.mesh import adjacency, smoothstep, vertex_normals
from rig.face.geometry.skin import Skin
from rig.face.geometry.topology import EYE_L, EYE_R, FILLER, MOUTH, NOSTRIL_L

Number = float | Float64
Triple = tuple[Number, Number, Number]


@dataclass(frozen=True)
class LipPoints:
    """Lip coordinates of the vertices, the input of a shape's formula.

    `u` (n,) is 0 in the middle and 1 at the corner; `ring` (n,) is the loop (0 the rim, -1 its
    wet side, 3 the edge of the red); `upper` (n,) is 1 on the upper lip, 0 on the lower and 0.5
    at the corner; `bell` is 1 - u**2 and `corner` is u**2.2.
    """

    u: Float64
    ring: Float64
    upper: Float64

    @property
    def bell(self) -> Float64:
        """1 in the middle of the lip, 0 at the corner."""
        return 1 - self.u**2

    @property
    def corner(self) -> Float64:
        """0 in the middle of the lip, 1 at the corner."""
        return np.asarray(self.u**2.2)

    @property
    def lower(self) -> Float64:
        """1 on the lower lip, 0 on the upper."""
        return 1 - self.upper

    def rings(self, **at: float) -> Float64:
        """Interpolate over loops; keys are ``r0``, ``r2``, ... and ``m1`` for loop -1."""
        where = [(-1 if k[0] == "m" else 1) * int(k[1:]) for k in at]
        return np.interp(self.ring, where, list(at.values()))


Crease = tuple[tuple[tuple[float, ...], ...], float, float]
"""A line of (x, y) points on the face, its depth (cm) and its half width (cm)."""


@dataclass(frozen=True)
class Shape:
    """One authored displacement at full strength, cm.

    `lips` gives (dx, dy, dz), dx away from the middle. `points` are (x, y, dx, dy, dz) on the
    left half of the face. `creases` fold the skin: a groove along the line and a soft roll above
    it. `is_split` makes two shapes with the suffixes _L and _R.
    """

    name: str
    lips: Callable[[LipPoints], Triple] | None = None
    points: tuple[tuple[float, ...], ...] = ()
    creases: tuple[Crease, ...] = ()
    is_split: bool = True
    reach: int = 5
    """Outermost loop of the mouth whose motion `lips` states; it stays still without `lips`."""


class ShapeMaker:
    """Turns authored shapes into displacements (V, 3) of one skin."""

    def __init__(self, skin: Skin) -> None:
        self.skin, self.plate = skin, ThinPlate(skin)
        v = skin.vertices
        self.normals = vertex_normals(v, skin.faces)
        self.left_share = smoothstep(0.5 + v[:, 0] / 1.3)
        self._t = np.where(skin.kind == MOUTH, skin.slot / topology.MOUTH_COUNT * 2 * np.pi, 0.0)
        is_eye = (skin.kind == EYE_L) | (skin.kind == EYE_R)
        self.lid = is_eye & (skin.ring <= 1)
        far = (v[:, 1] < -13.8) | (v[:, 2] < -1.8) | (v[:, 1] > 8.2) | (np.abs(v[:, 0]) > 6.75)
        self.still = far & (skin.kind == FILLER)
        # Tip and bridge of the nose, which no lip shape moves.
        rim = skin.vertices[skin.loop(NOSTRIL_L, 0)]
        x, y, z = np.abs(skin.vertices[:, 0]), skin.vertices[:, 1], skin.vertices[:, 2]
        front = (skin.kind == FILLER) & (x < 0.8) & (z > rim[:, 2].mean() - 0.2)
        self.nose = np.asarray(front & (y > rim[:, 1].mean()) & (y < -1.5))

    def make(self, shape: Shape) -> dict[str, Float64]:
        """Displacements by name: one for a whole shape, two for a split one."""
        whole = self._solve(shape) + sum(
            (self._fold(crease) for crease in shape.creases), np.zeros((1, 3))
        )
        whole = 0.5 * (whole + whole[self.skin.mirror] * [-1, 1, 1])
        if not shape.is_split:
            return {shape.name: whole}
        share = self.left_share[:, None]
        return {f"{shape.name}_L": whole * share, f"{shape.name}_R": whole * (1 - share)}

    def lip_points(self, chosen: Bool) -> LipPoints:
        """Lip coordinates of the chosen vertices."""
        t = self._t[chosen]
        upper = smoothstep(0.5 + 2.2 * np.sin(t))
        return LipPoints(np.abs(np.cos(t)), self.skin.ring[chosen].astype(float), upper)

    def _solve(self, shape: Shape) -> Float64:
        skin, n = self.skin, len(self.skin.vertices)
        fixed, values = self.still | self.lid, np.zeros((n, 3))
        lips = (skin.kind == MOUTH) & (skin.ring <= shape.reach)
        fixed = fixed | lips
        if shape.lips is not None:
            fixed = fixed | self.nose
            values[lips] = self._lip_motion(shape.lips, lips)
        for x, y, dx, dy, dz in shape.points:
            for side in (1, -1) if x else (1,):
                near = self._nearest(x * side, y)
                fixed[near], values[near] = True, [dx * side, dy, dz]
        if not shape.points and shape.lips is None:
            return values
        return self.plate.spread(fixed, values)

    def _lip_motion(self, lips: Callable[[LipPoints], Triple], chosen: Bool) -> Float64:
        """The formula on the lips; it fades out on the loops inside the mouth."""
        p = self.lip_points(chosen)
        capped = LipPoints(p.u, np.maximum(p.ring, -1), p.upper)
        motion = np.stack([np.broadcast_to(m, p.u.shape) for m in lips(capped)], -1).copy()
        motion[:, 0] *= np.sign(np.round(np.cos(self._t[chosen]), 6))
        fade = np.interp(-p.ring, [1, 2, 3, 4, 5], [1, 0.85, 0.5, 0.2, 0])
        return np.asarray(motion * fade[:, None])

    def _nearest(self, x: float, y: float, count: int = 3) -> Int64:
        """Vertices of the front of the face closest to (x, y)."""
        v = self.skin.vertices
        off = (v[:, 0] - x) ** 2 + (v[:, 1] - y) ** 2 + 100 * (v[:, 2] < 2) + 100 * self.lid
        off = off + 100 * ((self.skin.kind == MOUTH) & (self.skin.ring < 0))
        return np.argsort(off)[: count if x else 1].astype(np.int64)

    def _fold(self, crease: Crease) -> Float64:
        line, depth, width = crease
        v = self.skin.vertices
        point = np.stack([np.abs(v[:, 0]), v[:, 1]], -1)
        signed = _signed_distance(point, np.array(line))
        groove = -depth * np.exp(-((signed / width) ** 2))
        roll = 0.75 * depth * np.exp(-(((signed - 2.1 * width) / (1.5 * width)) ** 2))
        front = smoothstep((v[:, 2] - 1.5) / 2) * ~self.lid * (self.skin.ring >= 0)
        return np.asarray(((groove + roll) * front)[:, None] * self.normals)


def _signed_distance(points: Float64, line: Float64) -> Float64:
    """Distance to a polyline, positive on its left; grows fast beyond its ends."""
    best, sign = np.full(len(points), np.inf), np.ones(len(points))
    for k in range(len(line) - 1):
        a, axis = line[k], line[k + 1] - line[k]
        h = ((points - a) @ axis) / (axis @ axis)
        over = np.maximum(np.maximum(-h, h - 1), 0) * np.linalg.norm(axis)
        ends = over * ((k == 0) & (h < 0) | (k == len(line) - 2) & (h > 1))
        foot = a + np.clip(h, 0, 1)[:, None] * axis
        distance = np.linalg.norm(points - foot, axis=1) + 1.2 * ends
        side = np.sign(axis[0] * (points[:, 1] - a[1]) - axis[1] * (points[:, 0] - a[0]))
        closer = distance < best
        best, sign = np.where(closer, distance, best), np.where(closer, side, sign)
    return np.asarray(best * np.where(sign == 0, 1, sign))


# Displacements given at a few vertices, spread over the skin as a thin plate would.


class ThinPlate:
    """Solves the biharmonic equation on the skin.

    It follows the surface and so separates the lips, unlike a distance in space.

    Factorisations are kept, one for each set of fixed vertices.
    """

    def __init__(self, skin: Skin) -> None:
        n = len(skin.vertices)
        graph = adjacency(skin.faces, n).tocoo()
        length = np.linalg.norm(skin.vertices[graph.row] - skin.vertices[graph.col], axis=1)
        weight = sp.coo_matrix((1 / np.maximum(length, 0.05), (graph.row, graph.col)), (n, n))
        laplacian = sp.diags(np.asarray(weight.sum(1)).ravel()) - weight.tocsr()
        self._matrix = (laplacian.T @ laplacian + 1e-9 * sp.eye(n)).tocsc()
        self._factors: dict[bytes, tuple[SuperLU, sp.csc_matrix]] = {}

    def spread(self, fixed: Bool, values: Float64) -> Float64:
        """Keep `values` (V, k) where `fixed` (V,), and fill the rest in smoothly."""
        free = ~fixed
        key = np.packbits(fixed).tobytes()
        if key not in self._factors:
            rows = self._matrix[free]
            self._factors[key] = (splu(rows[:, free].tocsc()), rows[:, fixed])
        factor, coupling = self._factors[key]
        filled = values.astype(float).copy()
        filled[free] = factor.solve(-(coupling @ values[fixed]))
        return filled
