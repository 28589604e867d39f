"""Pairs of points across the mouth's slit, and correction of the lips' contact after a transfer.

Vertices of the upper and of the lower lip take their displacements from the source separately; an
error of half a millimetre each is invisible on a cheek, but an open mouth on /m/.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from rig.arrays import Float64, Int64
from rig.errors import MeshError
from rig.mesh.trimesh import TriMesh
from rig.retarget.landmarks import CORNERS, nearest
from rig.retarget.registration import Registration, inverse_distance
from rig.retarget.transfer import local_jacobians

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

    def gaps(self, vertices: Float64) -> Float64:
        """Signed height of each pair's gap [shape=(..., P)]; negative where lips cross."""
        return np.asarray(vertices[..., self.upper, 1] - vertices[..., self.lower, 1])


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
    wanted = inverse_distance(theirs, ours, parting)
    error = wanted - (result[:, target_pairs.upper] - result[:, target_pairs.lower])
    error = _along_slit(ours, error, _SMOOTHING * target_pairs.width)
    for vertices, sign, side in ((target_pairs.upper, 0.5, 1), (target_pairs.lower, -0.5, -1)):
        lip = np.flatnonzero(registration.target_labels == side)
        near, reach = KDTree(rest[vertices]), _REPAIR_REACH * target_pairs.width
        distance, _ = near.query(rest[lip])
        spread = np.exp(-((distance / reach) ** 2))
        correction = inverse_distance(rest[vertices], rest[lip], sign * error)
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
