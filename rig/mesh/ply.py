"""Stanford PLY, ASCII and binary, and folders of them as sequences (the VOCASET layout)."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.arrays import Float32, Int64
from rig.errors import FormatError, MeshError, TopologyError
from rig.files import atomic_write, output_folder
from rig.files.reading import check_file, open_file
from rig.limits import MESH_BYTES, TRIANGLES
from rig.mesh.ply_elements import Lists, read_element, read_header
from rig.mesh.trimesh import TriMesh, check_length


def read_ply(path: Path | str) -> TriMesh:
    """Read one PLY file; polygons become fans from their first corner.

    Raises
    ------
    FormatError
        If the header is wrong, the file is cut short, or it has no vertices or faces.
    """
    path = Path(path)
    size = check_file(path, MESH_BYTES)
    vertices: NDArray[Any] | None = None
    polygons: NDArray[Any] | Lists = Lists(np.zeros(0, np.int64), np.zeros(0, np.int64))
    with open_file(path, MESH_BYTES) as file:
        try:
            order, elements = read_header(file)
            for element in elements:
                columns = read_element(file, element, order, size - file.tell())
                if element.name == "vertex":
                    vertices = np.stack([_numbers(columns[axis]) for axis in "xyz"], axis=1)
                elif element.name == "face":
                    key = "vertex_indices" if "vertex_indices" in columns else "vertex_index"
                    polygons = columns[key]
        except (LookupError, ValueError, TypeError, OverflowError) as error:
            raise FormatError(f"{path.name} is not a readable PLY file: {error}") from None
    if vertices is None:
        raise FormatError(f"{path.name} has no 'vertex' element")
    if not isinstance(polygons, Lists) or polygons.values.dtype.kind not in "iu":
        raise FormatError(f"{path.name}: corners of faces must be lists of whole numbers")
    return TriMesh(vertices, _triangulate(polygons))


def _triangulate(polygons: Lists) -> Int64:
    """Triangles [shape=(N, 3)] of polygons: fans from their first corners."""
    counts = np.maximum(polygons.lengths - 2, 0)
    if counts.sum() > TRIANGLES:
        raise MeshError(f"{counts.sum()} triangles; at most {TRIANGLES} are read: decimate it")
    starts = np.cumsum(polygons.lengths) - polygons.lengths
    first = np.repeat(starts, counts)
    within = np.arange(len(first)) - np.repeat(np.cumsum(counts) - counts, counts)
    places = np.stack([first, first + within + 1, first + within + 2], axis=1)
    triangles: Int64 = polygons.values.astype(np.int64)[places]
    return triangles


def _numbers(column: NDArray[Any] | Lists) -> NDArray[Any]:
    if isinstance(column, Lists):
        raise ValueError("x, y and z must be numbers, not lists")
    return column


def write_ply(path: Path | str, mesh: TriMesh, *, ascii: bool = False) -> None:
    """Write one PLY file: float64 positions, int32 triangles, little-endian unless `ascii`."""
    header = (
        f"ply\nformat {'ascii' if ascii else 'binary_little_endian'} 1.0\n"
        f"element vertex {len(mesh.vertices)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(mesh.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode("ascii")
    if ascii:
        lines = [f"{x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
        lines += [f"3 {a} {b} {c}" for a, b, c in mesh.faces.tolist()]
        body = ("\n".join(lines) + "\n").encode("ascii")
    else:
        rows = np.empty(len(mesh.faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
        rows["count"], rows["corners"] = 3, mesh.faces
        body = mesh.vertices.astype("<f8").tobytes() + rows.tobytes()
    with atomic_write(path) as beside:
        beside.write_bytes(header + body)


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


def write_ply_sequence(folder: Path | str, mesh: TriMesh, vertices: Any) -> None:
    """Write frames [shape=(T, V, 3)] as `frame.00000.ply` ... into a folder.

    Raises
    ------
    TargetError
        If the folder holds anything but frames that were written so before.
    """
    with output_folder(folder, kind="frames", force=True) as beside:
        for i, frame in enumerate(np.asarray(vertices)):
            write_ply(beside / f"frame.{i:05d}.ply", mesh.with_vertices(frame))
