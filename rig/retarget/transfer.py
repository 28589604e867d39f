"""Carry shapes, or frames, from a registered source head to the target.

Two ways. *Displacements* (default): each target vertex takes its source point's displacement,
turned and scaled by the registration's local Jacobian. *Gradients*: each target triangle takes
its source triangles' deformation gradient and the vertices are solved for (Sumner & Popovic 2004;
SDFA's use of Eq. 1-6 across topologies). The first is closer at the lips, where gradients of a
few thin rim triangles displace the whole lip (measured: docs/mesh.md).
"""

from functools import lru_cache

import numpy as np
from scipy.sparse import coo_array, csc_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components

from rig.arrays import Bool, Float64
from rig.mesh.closest import ClosestPoints
from rig.mesh.deformation import DeformationSolver, deformation_gradients, factored, similarity
from rig.mesh.trimesh import (
    TriMesh,
    adjacency,
    components,
    edges,
    triangle_normals,
    without_degenerate,
)
from rig.retarget.registration import Registration

_TRUSTED = 0.25
"""A correspondence further than this share of the eye distance is filled in from neighbours."""
_ON_SKIN = 0.05
"""A loose part this near the skin (brow, lash) moves with it; one further in (eye) is rigid."""
_NEAR_PART = 0.1
"""A loose part this near a loose part of the source (eye to eye) takes its motion."""
_RIGID = 0.1
"""A part that departs this far, of its motion, from the best rigid one bends: a tongue."""
_RIPPLE = 0.015
_SOFTENING = 2
_REGION = 0.3
_FITS = 300
_SAMPLES = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4], [2, 2, 2]]) / 6.0
"""Points of a target triangle whose source gradients are averaged."""


def transfer_displacements(registration: Registration, deltas: Float64) -> Float64:
    """Displacements of the target's vertices from those of the source's.

    Parameters
    ----------
    registration : Registration
        From `rig.retarget.registration`.
    deltas : array [shape=(K, V_source, 3)]
        Displacements from the source's neutral.

    Returns
    -------
    moved : array [shape=(K, V_target, 3)]
    """
    jacobian = local_jacobians(registration)
    mapped = np.einsum("vab,kvb->kva", jacobian, deltas)
    points = registration.correspondence
    faces = registration.source.faces[registration.skin_faces]
    result = np.stack([points.interpolate(faces, delta) for delta in mapped])
    trusted = points.allowed & (points.distances < _TRUSTED * registration.eyes)
    result = _soften(registration, _fill(registration.target, result, trusted))
    # Make loose parts of the target (eyes, teeth) move as one piece.
    labels = components(registration.target)
    if labels.max() == 0:
        return result
    loose = np.delete(registration.source.faces, registration.skin_faces, axis=0)
    skin = ClosestPoints(TriMesh(registration.placed, faces), candidates=8)
    inner = ClosestPoints(TriMesh(registration.placed, loose)) if len(loose) else None
    source_labels = components(registration.source)
    for label in range(1, int(labels.max()) + 1):
        part = np.flatnonzero(labels == label)
        rest = registration.target.vertices[part]
        to_skin = np.median(skin.query(rest).distances)
        near = None if inner is None else inner.query(rest)
        to_inner = np.inf if near is None else np.median(near.distances)
        if to_skin < min(to_inner, _ON_SKIN * registration.eyes):
            continue
        result[:, part] = 0.0
        if inner is None or near is None or to_inner > _NEAR_PART * registration.eyes:
            continue
        # Upper and lower teeth touch: only the part with most of the points determines the motion.
        owners = source_labels[inner.mesh.faces[:, 0]]
        leader = inner.mesh.faces[owners == np.bincount(owners[near.triangles]).argmax()]
        points = ClosestPoints(TriMesh(registration.placed, leader)).query(rest)
        for k, delta in enumerate(mapped):
            result[k, part] = _as_one_piece(rest, points.interpolate(leader, delta))
    return result


def transfer_gradients(registration: Registration, deltas: Float64) -> Float64:
    """Transfer shapes, or frames of a take, by deformation gradients; see `transfer_displacements`.

    Vertices whose source stays within 0.1 % of the head through all K are held there; each part
    without one is pinned by its displacement.
    """
    target = without_degenerate(registration.target)
    by_displacement = transfer_displacements(registration, deltas)
    motion = np.linalg.norm(by_displacement, axis=-1).max(axis=0)
    used = np.unique(target.faces)
    quiet = used[motion[used] < 1e-3 * registration.eyes]
    solver = DeformationSolver(target, pins=quiet)
    # Triangles of the source's skin under four points of each target triangle [shape=(N, 4)].
    corners = target.vertices[target.faces]
    sides = np.sign(registration.target_labels[target.faces].sum(axis=1))
    normals = triangle_normals(target)
    found = [
        registration.correspond_points(np.einsum("k,nkc->nc", w, corners), normals, sides)
        for w in _SAMPLES
    ]
    where = np.stack([points.triangles for points in found], axis=1)
    skin = TriMesh(registration.source.vertices, registration.source.faces[registration.skin_faces])
    rotation = registration.rotation
    result = np.empty_like(by_displacement)
    for k, delta in enumerate(deltas):
        gradients = deformation_gradients(skin, skin.vertices + delta)
        local = gradients[where].mean(axis=1)
        turned = rotation @ local @ rotation.T
        pins = target.vertices[solver.pins] + by_displacement[k, solver.pins]
        result[k] = solver.solve_gradients(turned[None], pin_positions=pins)[0] - target.vertices
    loose = components(registration.target) > 0
    result[:, loose] = by_displacement[:, loose]
    return result


@lru_cache(maxsize=2)
def local_jacobians(registration: Registration) -> Float64:
    """Local Jacobian of the registration at each source vertex.

    Affine maps fitted to the placed skin about a few hundred of its vertices, within a Gaussian of
    `_REGION` eye distances, then blended. Gradients of single triangles would follow every
    wrinkle of the fit, and are undetermined across the skin.

    Returns
    -------
    jacobians : array [shape=(V_source, 3, 3)]
    """
    source = registration.source
    skin = np.flatnonzero(components(source) == 0)
    before, after = source.vertices[skin], registration.placed[skin]
    centres = before[:: max(1, len(skin) // _FITS)]
    reach = _REGION * registration.eyes / registration.scale
    near = _gaussian(centres, before, reach)
    near /= near.sum(axis=1, keepdims=True)
    mean_before, mean_after = near @ before, near @ after
    outer = [(x[:, :, None] * before[:, None, :]).reshape(-1, 9) for x in (before, after)]
    moments = np.stack([(near @ products).reshape(-1, 3, 3) for products in outer])
    moments[0] -= mean_before[:, :, None] * mean_before[:, None, :]
    moments[1] -= mean_after[:, :, None] * mean_before[:, None, :]
    # A patch of skin is nearly flat; along its normal the whole head determines the map.
    whole = registration.scale * registration.rotation
    ridge = 1e-3 * np.trace(moments[0], axis1=1, axis2=2)[:, None, None] * np.eye(3)
    fitted = (moments[1] + whole @ ridge) @ np.linalg.inv(moments[0] + ridge)
    blend = _gaussian(centres, source.vertices, 0.5 * reach) + 1e-12
    blend /= blend.sum(axis=0)
    return np.asarray((blend.T @ fitted.reshape(len(centres), 9)).reshape(-1, 3, 3))


def _gaussian(centres: Float64, points: Float64, reach: float) -> Float64:
    squared = (centres**2).sum(axis=1)[:, None] - 2 * centres @ points.T + (points**2).sum(axis=1)
    return np.asarray(np.exp(-np.maximum(squared, 0.0) / (2 * reach**2)))


def _fill(target: TriMesh, deltas: Float64, trusted: Bool) -> Float64:
    """Fill untrusted vertices harmonically from trusted ones of their part; parts without: 0."""
    links = adjacency(target)
    _, labels = connected_components(links, directed=False)
    reachable = np.isin(labels, np.unique(labels[trusted]))
    result = deltas.copy()
    result[:, ~trusted] = 0.0
    open_ = np.flatnonzero(~trusted & reachable)
    if len(open_) == 0:
        return result
    laplacian = csc_array(diags_array(np.asarray(links.sum(axis=1)).ravel()) - links)
    factors = factored(csc_array(laplacian[open_][:, open_]))
    coupling = laplacian[open_]
    for delta in result:
        delta[open_] = factors.solve(-(coupling @ delta))
    return result


def _soften(registration: Registration, deltas: Float64) -> Float64:
    """Smooth the registration's ripples: mix vertices with neighbours a millimetre or two off.

    A coarse mesh, whose edges are longer than the ripples, is left as it is.
    """
    target = registration.target
    ends = edges(target.faces)
    lengths = np.linalg.norm(np.subtract(*(target.vertices[ends[:, k]] for k in (0, 1))), axis=1)
    near = np.exp(-((lengths / (_RIPPLE * registration.eyes)) ** 2))
    count = len(target.vertices)
    one_way = csr_array(coo_array((near, (ends[:, 0], ends[:, 1])), shape=(count, count)))
    links = one_way.maximum(one_way.T)
    total = 1.0 + np.asarray(links.sum(axis=1)).ravel()
    mix = diags_array(1.0 / total) @ (links + diags_array(np.ones(count)))
    result = deltas
    for _ in range(_SOFTENING):
        result = np.stack([mix @ delta for delta in result])
    return result


def _as_one_piece(rest: Float64, delta: Float64) -> Float64:
    """The rigid motion nearest to a displacement; itself where it plainly bends."""
    _, turn, shift = similarity(rest, rest + delta, is_rigid=True)
    rigid = rest @ turn.T + shift - rest
    misfit = np.linalg.norm(delta - rigid, axis=1).max()
    return rigid if misfit < _RIGID * np.linalg.norm(delta, axis=1).max() else delta
