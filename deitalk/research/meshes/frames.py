"""Frames of a mesh as a folder of PLY files (the VOCASET layout)."""

from pathlib import Path

import numpy as np

from rig.arrays import Float32
from rig.errors import FormatError, TopologyError
from rig.mesh import TriMesh, read_ply
from rig.mesh.trimesh import check_length


def read_ply_sequence(folder: Path | str) -> tuple[TriMesh, Float32]:
    """Read a folder of PLY files as frames, in the order of their names.

    Returns
    -------
    first : TriMesh
        The first frame with its triangles.
    vertices : array [shape=(T, V, 3)]
        All frames.

    Raises
    ------
    FormatError
        If there is no PLY file.
    TopologyError
        If a frame's vertex count differs from the first one's.
    """
    files = sorted(Path(folder).glob("*.ply"))
    if not files:
        raise FormatError(f"{folder} holds no .ply files")
    first = read_ply(files[0])
    check_length(len(files), len(first.vertices))
    frames = np.empty((len(files), *first.vertices.shape), dtype=np.float32)
    for frame, file in zip(frames, files, strict=True):
        vertices = read_ply(file).vertices
        if vertices.shape != first.vertices.shape:
            raise TopologyError(
                f"{file.name} has {len(vertices)} vertices, {files[0].name} "
                f"{len(first.vertices)}; all frames of a sequence share one mesh"
            )
        frame[:] = vertices
    return first, frames
