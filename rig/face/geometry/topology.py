"""Vertices and triangles of the skin: loops of mouth, eyes and nostrils, a filler between them.

They are those of ``topology.npz``, alike for all identities: the embedded mesh models and users'
corpora number their vertices by them, so that proportions may change and triangles may not. Loops
are joined by strips of quads. The filler was made once: Poisson-disc points on the sphere of
directions, dense at mouth, nose and chin, mirrored in x = 0, relaxed and triangulated by Delaunay.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from rig.arrays import Float64, Int64
from rig.face.geometry import loops
from rig.face.geometry.mesh import adjacency, unit
from rig.face.identity import Identity

FILLER, MOUTH, EYE_L, EYE_R, NOSTRIL_L, NOSTRIL_R = range(6)
FACE_AXIS = unit(np.array([0, -0.33, 0.94]))
NECK_Y = -15.6


@dataclass(frozen=True)
class Topology:
    """The skin's directions for the reference identity and its triangles.

    `kind`, `ring`, `slot` (V,) are for each vertex its feature, its loop
    (0 is the rim) and which place on the loop; `mirror` (V,) is the vertex on the other side.
    """

    directions: Float64
    faces: Int64
    kind: Int64
    ring: Int64
    slot: Int64
    mirror: Int64


@lru_cache(maxsize=1)
def build_topology() -> Topology:
    """Read the directions and triangles of all skins."""
    with np.load(Path(__file__).with_name("topology.npz"), allow_pickle=False) as stored:
        directions = stored["directions"]
        labels = [
            stored[name].astype(np.int64) for name in ("faces", "kind", "ring", "slot", "mirror")
        ]
    return Topology(directions, *labels)


def loop_directions(identity: Identity) -> list[tuple[int, Float64]]:
    """Every feature's kind and its loops (loops, count, 3), the order vertices are stored in."""
    eye, nostril = loops.eye_directions(identity), loops.nostril_directions(identity)
    flip = np.array([-1, 1, 1])
    return [
        (MOUTH, loops.mouth_directions(identity)),
        (EYE_L, eye),
        (EYE_R, eye * flip),
        (NOSTRIL_L, nostril),
        (NOSTRIL_R, nostril * flip),
    ]


def directions_for(identity: Identity) -> Float64:
    """The topology's directions with the loops where `identity` has them.

    The filler follows the loops harmonically, so that triangles keep their shape.
    """
    topology = build_topology()
    rows = np.concatenate([r.reshape(-1, 3) for _, r in loop_directions(identity)])
    n, n_rows = len(topology.directions), len(rows)
    graph = adjacency(topology.faces, n)
    laplacian = sp.diags(np.asarray(graph.sum(1)).ravel()) - graph
    fixed = (np.arange(n) < n_rows) | (topology.directions[:, 2] < 0)
    shift = np.zeros((n, 3))
    shift[:n_rows] = rows - topology.directions[:n_rows]
    free = ~fixed
    matrix = laplacian.tocsr()
    shift[free] = splu(matrix[free][:, free].tocsc()).solve(
        -(matrix[free][:, fixed] @ shift[fixed])
    )
    return unit(topology.directions + shift)
