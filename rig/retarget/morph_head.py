"""The embedded head as one mesh with morph targets, for formats that carry a mesh."""

from functools import lru_cache

import numpy as np

from rig.arrays import Float32, Float64
from rig.controls import default_controls
from rig.mesh.shapes import ShapeSet
from rig.mesh.trimesh import TriMesh
from rig.retarget.bake import BakedRig, bake, face_correctives

METRES_PER_CM = 0.01


@lru_cache(maxsize=1)
def morph_head(identity: int | str = 0) -> tuple[BakedRig, Float64]:
    """Return the head baked to morph targets, in cm, and its linear vertex colours.

    Parameters
    ----------
    identity : int or str
        Number or name of an embedded head.

    Returns
    -------
    rig : BakedRig
        One shape per half of a control's range, and correctives.
    colours : array [shape=(V, 3), range 0 to 1]
        Linear, as glTF and USD take them.
    """
    from rig.face import build_head

    head = build_head(identity)
    mesh = TriMesh(head.mesh.vertices, head.mesh.faces)

    def evaluate(values: Float32) -> Float32:
        return np.asarray(head.pose(values))

    rig = bake(mesh, evaluate, default_controls(), correctives=face_correctives())
    return rig, srgb_to_linear(head.mesh.colors)


def srgb_to_linear(colours: Float64) -> Float64:
    """Return linear light of sRGB values (IEC 61966-2-1)."""
    low = colours <= 0.04045
    return np.where(low, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)


def in_metres(shapes: ShapeSet) -> ShapeSet:
    """Return shapes that are in cm in glTF's unit."""
    neutral = shapes.neutral.with_vertices(shapes.neutral.vertices * METRES_PER_CM)
    return ShapeSet(neutral, shapes.names, shapes.deltas * METRES_PER_CM)
