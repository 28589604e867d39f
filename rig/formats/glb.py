"""GLB (glTF 2.0 binary): our head with morph targets and their animation.

Opens in Blender, three.js, Windows' viewer and Unreal. For a face of your own, see
``deitalk retarget``.
"""

from pathlib import Path

import numpy as np

from rig.curves import RigCurves
from rig.formats.morph_head import METRES_PER_CM, morph_head
from rig.mesh.glb import GlbBuilder, WeightAnimation, add_animation, write_container
from rig.mesh.trimesh import TriMesh, vertex_normals

ARRAY_BUFFER, INDEX_BUFFER = 34962, 34963
STILL_METRES = 1e-5
STILL_NORMAL = 2e-3


def write(path: Path, curves: RigCurves) -> None:
    """Write one mesh in metres, y up, facing +z, and one animation of its weights."""
    rig, colours = morph_head()
    mesh = rig.shapes.neutral
    vertices = mesh.vertices * METRES_PER_CM
    normals = vertex_normals(mesh)
    builder = GlbBuilder()
    targets = []
    for delta in rig.shapes.deltas.astype(np.float64):
        moved = vertex_normals(TriMesh(mesh.vertices + delta, mesh.faces))
        targets.append(
            {
                "POSITION": builder.sparse(delta * METRES_PER_CM, STILL_METRES),
                "NORMAL": builder.sparse(moved - normals, STILL_NORMAL),
            }
        )
    attributes = {
        "POSITION": builder.dense(vertices, "VEC3", ARRAY_BUFFER),
        "NORMAL": builder.dense(normals, "VEC3", ARRAY_BUFFER),
        "COLOR_0": builder.dense(colours, "VEC3", ARRAY_BUFFER),
    }
    faces = mesh.faces.astype(np.uint32).ravel()
    primitive = {
        "attributes": attributes,
        "indices": builder.dense(faces, "SCALAR", INDEX_BUFFER),
        "material": 0,
        "targets": targets,
    }
    names = list(rig.shapes.names)
    surface = {"baseColorFactor": [1.0] * 4, "metallicFactor": 0.0, "roughnessFactor": 0.6}
    builder.json |= {
        "asset": {"version": "2.0", "generator": "deitalk"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "face"}],
        "meshes": [
            {
                "name": "face",
                "primitives": [primitive],
                "weights": [0.0] * len(names),
                "extras": {"targetNames": names},
            }
        ],
        "materials": [{"name": "face", "pbrMetallicRoughness": surface, "doubleSided": True}],
    }
    weights = rig.weights(curves)
    add_animation(builder, WeightAnimation(weights, curves.fps), {0: weights})
    write_container(path, builder.json, bytes(builder.binary))
