"""Meshes: gradients, reconstruction, files, retargeting (SDFA §3.4-3.5).

- `trimesh`, `shapes`, `obj`, `ply`, `glb`, `glb_reader`: meshes, shape sets and their files.
- `rotations`, `gradients`, `reconstruct`, `basis`: SDFA Eq. 1-6 and what the paper leaves open.
- `landmarks`, `closest`, `register`, `transfer`, `lips`: one head laid over another.
- `bake`, `blendshapes`, `retarget`, `apply`: curves on any face.
- `head`: the embedded head as a source (imported on its own: it builds the head).
"""

from rig.mesh.basis import Bases, GradientBasis, choose_bases, fit_basis, read_bases, write_bases
from rig.mesh.gradients import deformation_gradients, pack, pack_vertices, triangle_frames, unpack
from rig.mesh.obj import read_obj, read_obj_folder, write_obj, write_obj_folder
from rig.mesh.ply import read_ply, read_ply_sequence, write_ply, write_ply_sequence
from rig.mesh.reconstruct import DeformationSolver, RigidPart, quietest_pins, small_parts
from rig.mesh.rotations import polar, rotation_exp, rotation_log, unwrap, unwrap_sequence
from rig.mesh.shapes import ShapeSet, read_shapes_npz, write_shapes_npz
from rig.mesh.trimesh import TriMesh, without_degenerate

__all__ = [
    "Bases",
    "DeformationSolver",
    "GradientBasis",
    "RigidPart",
    "ShapeSet",
    "TriMesh",
    "choose_bases",
    "deformation_gradients",
    "fit_basis",
    "pack",
    "pack_vertices",
    "polar",
    "quietest_pins",
    "read_bases",
    "read_obj",
    "read_obj_folder",
    "read_ply",
    "read_ply_sequence",
    "read_shapes_npz",
    "rotation_exp",
    "rotation_log",
    "small_parts",
    "triangle_frames",
    "unpack",
    "unwrap",
    "unwrap_sequence",
    "without_degenerate",
    "write_bases",
    "write_obj",
    "write_obj_folder",
    "write_ply",
    "write_ply_sequence",
    "write_shapes_npz",
]
