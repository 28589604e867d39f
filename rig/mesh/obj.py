"""Wavefront OBJ: one mesh, or a folder with one file per shape.

Only positions and faces are read; texture coordinates, normals, groups and materials are
skipped. Polygons become fans from their first corner, so that equal files give equal triangles.
Vertices without a face are kept, so that indices stay.
"""

import itertools
from array import array
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from rig.errors import FormatError, MeshError, TopologyError, quoted
from rig.files.reading import open_file
from rig.limits import MESH_BYTES, TRIANGLES, VERTICES
from rig.mesh.shapes import ShapeSet, check_shape_count
from rig.mesh.trimesh import TriMesh

NEUTRAL_WORDS = ("neutral", "base", "rest", "basis", "default")
"""Words in the name of the neutral file."""


def read_obj(path: Path | str) -> TriMesh:
    """Read one OBJ file.

    Raises
    ------
    FormatError
        If a line cannot be read; the message gives its number.
    MeshError, TopologyError
        If the contents make no mesh.
    """
    path = Path(path)
    vertices, triangles = array("d"), array("q")
    for number, line in enumerate(_lines(path), start=1):
        try:
            if line.startswith("v "):
                x, y, z = line.split()[1:4]
                vertices.extend((float(x), float(y), float(z)))
            elif line.startswith("f "):
                first, *others = _corners(line, len(vertices) // 3)
                for pair in itertools.pairwise(others):
                    triangles.extend((first, *pair))
        except (ValueError, OverflowError):
            raise FormatError(
                f"{path.name} line {number}: cannot read {quoted(line.strip())}"
            ) from None
        if len(vertices) > 3 * VERTICES or len(triangles) > 3 * TRIANGLES:
            raise MeshError(
                f"{path.name} has more than {VERTICES} vertices or {TRIANGLES} triangles; "
                "decimate the mesh"
            )
    if not vertices:
        raise FormatError(f"{path.name} holds no vertices ('v' lines); is it an OBJ file?")
    corners = np.array(triangles, dtype=np.int64)
    return TriMesh(np.array(vertices).reshape(-1, 3), corners.reshape(-1, 3))


def _lines(path: Path) -> Iterator[str]:
    """Lines of a file; a trailing backslash continues one."""
    parts: list[str] = []
    with open_file(path, MESH_BYTES) as stream:
        for raw in stream:
            parts.append(raw.decode("utf-8", "replace").rstrip("\r\n"))
            if parts[-1].endswith("\\"):
                parts[-1] = parts[-1][:-1]
                continue
            yield " ".join(parts)
            parts.clear()
    yield " ".join(parts)


def _corners(line: str, count: int) -> list[int]:
    """Corner indices from 0; negative ones in the file count back from the last vertex."""
    corners = [int(word.split("/", 1)[0]) for word in line.split()[1:]]
    if len(corners) < 3 or 0 in corners:
        raise ValueError("a face needs three corners, counted from 1")
    return [i - 1 if i > 0 else count + i for i in corners]


def read_obj_folder(folder: Path | str) -> ShapeSet:
    """Read a folder of OBJ files, one per shape, one of them neutral.

    The neutral file's name holds "neutral", "base", "rest", "basis" or "default"; every other
    file is a shape named after it. Faces are taken from the neutral file; the others only need
    the same number of vertices in the same order (exporters differ in how they write faces).

    Raises
    ------
    FormatError
        If there is no OBJ file, or none or several are neutral.
    TopologyError
        If a shape's vertex count differs.
    """
    folder = Path(folder)
    files = sorted(folder.glob("*.obj"))
    if not files:
        raise FormatError(f"{folder} holds no .obj files")
    neutral_files = [f for f in files if any(w in f.stem.lower() for w in NEUTRAL_WORDS)]
    if len(neutral_files) != 1:
        found = ", ".join(f.name for f in neutral_files) or "none"
        raise FormatError(
            f"{folder.name}: one file must be named neutral.obj (or base, rest, basis, default); "
            f"found {found}"
        )
    neutral = read_obj(neutral_files[0])
    shapes = [f for f in files if f != neutral_files[0]]
    check_shape_count(len(shapes), len(neutral.vertices))
    deltas = np.zeros((len(shapes), *neutral.vertices.shape), dtype=np.float32)
    for delta, file in zip(deltas, shapes, strict=True):
        vertices = read_obj(file).vertices
        if vertices.shape != neutral.vertices.shape:
            raise TopologyError(
                f"{file.name} has {len(vertices)} vertices and {neutral_files[0].name} "
                f"{len(neutral.vertices)}; export every shape with the same vertex order"
            )
        delta[:] = vertices - neutral.vertices
    deltas.setflags(write=False)  # not copied again
    return ShapeSet(neutral, tuple(f.stem for f in shapes), deltas)
