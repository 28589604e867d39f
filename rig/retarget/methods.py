"""A take on a user's face: two methods, each from arrays to arrays.

(a) their blendshapes, driven by name: `rig.retarget.blendshapes`;
(b) their one neutral mesh: `shapes_for` registers the embedded head and bakes its shapes onto it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from rig.errors import MeshError
from rig.limits import RETARGET_VERTICES
from rig.mesh.shapes import ShapeSet
from rig.mesh.trimesh import TriMesh
from rig.retarget.bake import BakedRig
from rig.retarget.head_source import source_head
from rig.retarget.lids import fit_lids
from rig.retarget.lips import LipPairs, lip_pairs, repair_lips
from rig.retarget.registration import POOR_MATCH, Registration, register
from rig.retarget.transfer import transfer_displacements, transfer_gradients

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
) -> tuple[BakedRig[ShapeSet], Carried]:
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
