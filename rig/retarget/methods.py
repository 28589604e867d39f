"""A take on a user's face: two methods, each from arrays to arrays.

(a) their blendshapes, driven by name: `rig.retarget.blendshapes`;
(b) their one neutral mesh: `shapes_for` registers the embedded head and bakes its shapes onto it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.spatial import KDTree

from rig.arrays import Float64, Int64
from rig.errors import MeshError
from rig.limits import RETARGET_VERTICES
from rig.mesh.shapes import ShapeSet
from rig.mesh.trimesh import TriMesh
from rig.retarget.bake import BakedRig
from rig.retarget.head_source import source_head
from rig.retarget.landmarks import CORNERS, nearest
from rig.retarget.lids import fit_lids
from rig.retarget.registration import POOR_MATCH, Registration, register
from rig.retarget.transfer import local_jacobians, transfer_displacements, transfer_gradients

# Pairs of points across the mouth's slit, and correction of the lips' contact after a transfer.
#
# Vertices of the upper and of the lower lip take their displacements from the source separately; an
# error of half a millimetre each is invisible on a cheek, but an open mouth on /m/.

_NEAR_SLIT = 0.03
"""Largest distance of a pair, in widths of the mouth; at least 1.5 times the gap."""
_REPAIR_REACH = 0.08
"""Reach of a correction of the rim over its lip, in widths of the mouth."""
_SMOOTHING = 0.04
"""Reach of the averaging of corrections along the slit, in widths of the mouth."""


@dataclass(frozen=True, eq=False)
class LipPairs:
    """Vertices that face one another across the closed mouth.

    Parameters
    ----------
    upper, lower : array [shape=(P,)]
        Vertices; pair i is upper[i] over lower[i].
    width : float
        Distance between the mouth's corners.
    """

    upper: Int64
    lower: Int64
    width: float

    def gaps(self, vertices: Any, up: Any = (0.0, 1.0, 0.0)) -> Float64:
        """Signed gap of each pair along `up` [shape=(..., P)]; negative where lips cross."""
        points = np.asarray(vertices, dtype=np.float64)
        apart = points[..., self.upper, :] - points[..., self.lower, :]
        direction = np.asarray(up, dtype=np.float64)
        return np.asarray(apart @ (direction / np.linalg.norm(direction)))


def lip_pairs(mesh: TriMesh, landmarks: Mapping[str, int], labels: Int64) -> LipPairs:
    """Pair the vertices along the slit of a neutral face with its mouth closed or nearly so.

    Parameters
    ----------
    mesh : TriMesh
        The neutral face.
    landmarks : mapping of str to int
        With both corners and both rims.
    labels : array of int [shape=(V,)]
        From `rig.retarget.registration.lip_labels`.

    Raises
    ------
    MeshError
        If the lips have no vertices near one another.
    """
    points = mesh.vertices
    width = float(np.linalg.norm(np.subtract(*(points[landmarks[c]] for c in CORNERS))))
    gap = float(np.linalg.norm(points[landmarks["upper_rim"]] - points[landmarks["lower_rim"]]))
    used = np.zeros(len(points), dtype=bool)
    used[mesh.faces.ravel()] = True
    upper, lower = (np.flatnonzero(np.asarray((labels == side) & used)) for side in (1, -1))
    if len(upper) == 0 or len(lower) == 0:
        raise MeshError("no lips found around the rim landmarks; check upper_rim and lower_rim")
    reach = max(1.5 * gap, _NEAR_SLIT * width)
    down, below = nearest(KDTree(points[lower]), points[upper])
    up, above = nearest(KDTree(points[upper]), points[lower])
    pairs = [(upper[i], lower[below[i]]) for i in np.flatnonzero(down <= reach)]
    pairs += [(upper[above[i]], lower[i]) for i in np.flatnonzero(up <= reach)]
    chosen = np.unique(np.array(pairs, dtype=np.int64).reshape(-1, 2), axis=0)
    if len(chosen) == 0:
        raise MeshError("the lips are nowhere near one another; the neutral mouth must be closed")
    return LipPairs(chosen[:, 0], chosen[:, 1], width)


def repair_lips(
    registration: Registration,
    source_pairs: LipPairs,
    target_pairs: LipPairs,
    source_deltas: Any,
    target_deltas: Any,
) -> Float64:
    """Correct the target's lip pairs to the gaps of the source's pairs.

    Each target pair takes the *relative* motion of the nearest source pairs, turned
    and scaled by the local Jacobian; half of the difference goes to each lip and fades over it.

    Parameters
    ----------
    registration : Registration
        Source over target.
    source_pairs, target_pairs : LipPairs
        Of the two neutral faces.
    source_deltas : array [shape=(K, V_source, 3)]
        Shapes as they are on the source.
    target_deltas : array [shape=(K, V_target, 3)]
        The same as transferred.

    Returns
    -------
    repaired : array [shape=(K, V_target, 3)]
    """
    source, result = np.asarray(source_deltas), np.array(target_deltas, dtype=np.float64)
    jacobian = local_jacobians(registration)
    middle = 0.5 * (jacobian[source_pairs.upper] + jacobian[source_pairs.lower])
    parting = source[:, source_pairs.upper] - source[:, source_pairs.lower]
    parting = np.einsum("pab,kpb->kpa", middle, parting)

    placed = registration.placed
    theirs = 0.5 * (placed[source_pairs.upper] + placed[source_pairs.lower])
    rest = registration.target.vertices
    ours = 0.5 * (rest[target_pairs.upper] + rest[target_pairs.lower])
    wanted = _inverse_distance(theirs, ours, parting)
    error = wanted - (result[:, target_pairs.upper] - result[:, target_pairs.lower])
    error = _along_slit(ours, error, _SMOOTHING * target_pairs.width)
    for vertices, sign, side in ((target_pairs.upper, 0.5, 1), (target_pairs.lower, -0.5, -1)):
        lip = np.flatnonzero(registration.target_labels == side)
        near, reach = KDTree(rest[vertices]), _REPAIR_REACH * target_pairs.width
        distance, _ = near.query(rest[lip])
        spread = np.exp(-((distance / reach) ** 2))
        correction = _inverse_distance(rest[vertices], rest[lip], sign * error)
        result[:, lip] += spread[:, None] * correction
    return result


def _along_slit(points: Float64, values: Float64, reach: float) -> Float64:
    """Gaussian mean of values [shape=(K, P, 3)] over the pairs about each: no ripples of one pair.

    Pairs near a corner see very different partings side by side; unsmoothed they stand out as
    spikes there.
    """
    apart = np.linalg.norm(points[:, None] - points[None], axis=-1)
    near = np.exp(-((apart / reach) ** 2))
    return np.asarray(np.einsum("pq,kqc->kpc", near / near.sum(axis=1, keepdims=True), values))


def _inverse_distance(points: Float64, queries: Float64, values: Float64) -> Float64:
    """Interpolate values [shape=(K, P, 3)] at points to queries by their four nearest."""
    count = min(4, len(points))
    distance, nearest = KDTree(points).query(queries, k=count)
    distance, nearest = (np.asarray(x).reshape(-1, count) for x in (distance, nearest))
    weight = 1.0 / np.maximum(distance, 1e-9) ** 2
    weight /= weight.sum(axis=1, keepdims=True)
    return np.asarray(np.einsum("qn,kqnc->kqc", weight, values[:, nearest]))


Method = Literal["displacements", "gradients"]

_VERTICES_AT_ONCE = 4_000_000
"""Shapes are carried in batches of about so many vertices altogether: some hundred MiB."""


@dataclass(frozen=True, eq=False)
class Carried:
    """Shapes of one head on another.

    Parameters
    ----------
    shapes : ShapeSet
        The source's names over the target's mesh.
    registration : Registration
    source_pairs, target_pairs : LipPairs
        Where the lips meet on each.
    """

    shapes: ShapeSet
    registration: Registration
    source_pairs: LipPairs
    target_pairs: LipPairs

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for an artist about the registration, one line each."""
        found, registration, pairs = [], self.registration, self.target_pairs
        if registration.residual > POOR_MATCH:
            off, most = 100 * registration.residual, 100 * POOR_MATCH
            found.append(
                f"the source head lies {off:.1f} % of the eye distance off the mesh (over "
                f"{most:.0f} %): check the landmarks, left is the subject's"
            )
        if registration.inside_out:
            found.append("the mesh's normals point inward; turned over for the matching only")
        if not 0.5 < registration.scale < 2.0:
            found.append(
                f"the mesh is {registration.scale:.3g} x the size of a head in centimetres"
            )
        gap = float(np.median(np.abs(pairs.gaps(registration.target.vertices))))
        if gap > 0.04 * pairs.width:
            found.append(
                f"the neutral mouth stands open ({gap / pairs.width:.0%} of its width): "
                "lips will not meet; give a mesh with its mouth closed"
            )
        return tuple(found)


def shapes_for(
    mesh: TriMesh, landmarks: Mapping[str, int], *, method: Method = "displacements"
) -> tuple[BakedRig, Carried]:
    """Bake the rig of the embedded head onto a neutral mesh of any topology.

    Parameters
    ----------
    mesh : TriMesh
        The user's face, mouth closed, eyes open; any units and pose.
    landmarks : mapping of str to int
        Its vertices for at least `rig.retarget.landmarks.NEEDED`.
    method : str
        "displacements" (default) or "gradients", see `rig.retarget.transfer`.

    Returns
    -------
    rig : BakedRig
        Shapes on the user's mesh with the drivers of the source.
    carried : Carried

    Raises
    ------
    MeshError
        If landmarks are missing, upper and lower lip cannot be separated, or the mesh is too large.
    """
    source = source_head()
    shapes = replace(source.rig.shapes, landmarks=source.landmarks)
    carried = carry_shapes(shapes, mesh, landmarks, method=method)
    return source.rig.on(mesh, carried.shapes.deltas).moving(), carried


def carry_shapes(
    source: ShapeSet,
    target: TriMesh,
    landmarks: Mapping[str, int],
    *,
    method: Method = "displacements",
) -> Carried:
    """Carry the shapes of any head with landmarks to another; lips meet as they do on the source.

    Parameters
    ----------
    source : ShapeSet
        With its landmarks.
    target : TriMesh
        A neutral face with its mouth closed.
    landmarks : mapping of str to int
        Of the target.
    method : str
        "displacements" or "gradients".
    """
    if len(target.vertices) > RETARGET_VERTICES:
        raise MeshError(
            f"the mesh has {len(target.vertices)} vertices; shapes are made for at most "
            f"{RETARGET_VERTICES}: decimate it"
        )
    registration = register(source.neutral, source.landmarks, target, landmarks)
    source_pairs = lip_pairs(source.neutral, source.landmarks, registration.source_labels)
    target_pairs = lip_pairs(target, landmarks, registration.target_labels)
    transfer = transfer_gradients if method == "gradients" else transfer_displacements
    carried = np.empty((len(source.names), len(target.vertices), 3), dtype=np.float32)
    batch = max(8, _VERTICES_AT_ONCE // len(target.vertices))
    for start in range(0, len(source.names), batch):
        some = slice(start, start + batch)
        deltas = source.deltas[some].astype(np.float64)
        moved = transfer(registration, deltas)
        moved = fit_lids(registration, source.landmarks, landmarks, moved)
        carried[some] = repair_lips(registration, source_pairs, target_pairs, deltas, moved)
    shapes = ShapeSet(target, source.names, carried, landmarks)
    return Carried(shapes, registration, source_pairs, target_pairs)
