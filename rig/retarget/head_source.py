"""The embedded head as a source of shapes: its mesh, landmarks and baked rig."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from rig.arrays import Float32, Float64
from rig.controls import default_controls
from rig.face import build_head
from rig.mesh.shapes import ShapeSet
from rig.mesh.trimesh import TriMesh
from rig.retarget.bake import BakedRig, bake, face_correctives, moves_of

PARTS = ("cage", "eye_L", "eye_R", "teeth_upper", "teeth_lower", "tongue")
"""Parts that are carried to another head, without brows, lashes, ears and hair."""


@dataclass(frozen=True, eq=False)
class SourceHead:
    """A rigged head to take shapes from.

    Parameters
    ----------
    mesh : TriMesh
        `PARTS` of the embedded head, neutral, in cm; the cage is the first part.
    landmarks : dict of str to int
        All 26 of `rig.retarget.landmarks.LANDMARKS`.
    rig : BakedRig
        Its shapes for the 185 controls.
    """

    mesh: TriMesh
    landmarks: dict[str, int]
    rig: BakedRig[ShapeSet]


@lru_cache(maxsize=2)
def source_head(identity: int = 0) -> SourceHead:
    """Build the embedded head of an identity and bake its rig."""
    head = build_head(identity)
    kept = np.concatenate([np.arange(len(head.mesh.vertices))[head.slices[p]] for p in PARTS])
    new_index = np.full(len(head.mesh.vertices), -1, dtype=np.int64)
    new_index[kept] = np.arange(len(kept))
    others = head.mesh.faces[(head.mesh.faces >= head.slices["seam"].stop).all(axis=1)]
    faces = new_index[np.concatenate([head.cage.faces, others])]
    mesh = TriMesh(head.mesh.vertices[kept], faces[(faces >= 0).all(axis=1)])
    controls = default_controls()

    def pose(values: Float64) -> Float32:
        return head.pose(values)[:, kept]

    evaluate = moves_of(pose, mesh.vertices)
    rig = bake(mesh, evaluate, controls, correctives=face_correctives()).dense()
    return SourceHead(rig.shapes.neutral, head.landmarks, rig)
