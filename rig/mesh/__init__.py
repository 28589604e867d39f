"""Triangle meshes, meshes with named shapes, and their files; independent of faces and curves."""

from rig.mesh.obj import read_obj, read_obj_folder
from rig.mesh.ply import read_ply, write_ply, write_ply_sequence
from rig.mesh.shapes import ShapeSet, read_shapes_npz
from rig.mesh.trimesh import TriMesh, without_degenerate

__all__ = [
    "ShapeSet",
    "TriMesh",
    "read_obj",
    "read_obj_folder",
    "read_ply",
    "read_shapes_npz",
    "without_degenerate",
    "write_ply",
    "write_ply_sequence",
]
