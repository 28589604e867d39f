"""Wavefront OBJ: one mesh, or a folder with one file per shape.

Only positions and faces are read; texture coordinates, normals, groups and materials are skipped.
Polygons become fans from their first corner, so that equal files give equal triangles. Vertices
no face uses are kept: their indices count.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from rig.errors import FormatError, TopologyError
from rig.files import atomic_write, output_folder
from rig.mesh.shapes import ShapeSet
from rig.mesh.trimesh import TriMesh

MAX_BYTES = 512 * 2**20
"""Largest text mesh that is read."""

NEUTRAL_WORDS = ("neutral", "base", "rest", "basis", "default")
"""A file is taken as the neutral one if its name holds one of these words."""


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
    vertices: list[tuple[float, ...]] = []
    triangles: list[tuple[int, int, int]] = []
    for number, line in enumerate(_lines(path), start=1):
        try:
            if line.startswith("v "):
                vertices.append(_position(line))
            elif line.startswith("f "):
                triangles.extend(_fan(_corners(line, len(vertices))))
        except ValueError:
            raise FormatError(
                f"{path.name} line {number}: cannot read {line.strip()[:60]!r}"
            ) from None
    if not vertices:
        raise FormatError(f"{path.name} holds no vertices ('v' lines); is it an OBJ file?")
    return TriMesh(np.array(vertices), np.array(triangles, dtype=np.int64).reshape(-1, 3))


def _lines(path: Path) -> list[str]:
    check_size(path)
    text = path.read_text(encoding="utf-8", errors="replace")
    # A trailing backslash continues a line; blanked rather than cut, so that numbers stay right.
    return text.replace("\\\n", " ").split("\n") if "\\\n" in text else text.split("\n")


def check_size(path: Path) -> None:
    """Raise FormatError if there is no such file or it is larger than `MAX_BYTES`."""
    if not path.is_file():
        raise FormatError(f"{path} is not a file")
    if path.stat().st_size > MAX_BYTES:
        raise FormatError(
            f"{path.name} has {path.stat().st_size / 2**20:.0f} MiB; at most {MAX_BYTES >> 20} MiB"
        )


def _position(line: str) -> tuple[float, ...]:
    x, y, z = line.split()[1:4]
    return float(x), float(y), float(z)


def _corners(line: str, count: int) -> list[int]:
    """Corner indices from 0; negative ones in the file count back from the last vertex."""
    corners = [int(word.split("/", 1)[0]) for word in line.split()[1:]]
    if len(corners) < 3 or 0 in corners:
        raise ValueError("a face needs three corners, counted from 1")
    return [i - 1 if i > 0 else count + i for i in corners]


def _fan(corners: Sequence[int]) -> list[tuple[int, int, int]]:
    return [(corners[0], corners[i], corners[i + 1]) for i in range(1, len(corners) - 1)]


def write_obj(path: Path | str, mesh: TriMesh) -> None:
    """Write positions and triangles; floats in the shortest form that reads back equal."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()]
    with atomic_write(path) as beside:
        beside.write_text("\n".join(lines) + "\n", encoding="ascii")


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
    deltas = np.zeros((len(shapes), *neutral.vertices.shape), dtype=np.float32)
    for delta, file in zip(deltas, shapes, strict=True):
        vertices = read_obj(file).vertices
        if vertices.shape != neutral.vertices.shape:
            raise TopologyError(
                f"{file.name} has {len(vertices)} vertices and {neutral_files[0].name} "
                f"{len(neutral.vertices)}; export every shape with the same vertex order"
            )
        delta[:] = vertices - neutral.vertices
    return ShapeSet(neutral, tuple(f.stem for f in shapes), deltas)


def write_obj_folder(folder: Path | str, shapes: ShapeSet) -> None:
    """Write `neutral.obj` and one file per shape into a folder.

    Raises
    ------
    TargetError
        If the folder holds anything but shapes that were written so before.
    """
    with output_folder(folder, kind="shapes", force=True) as beside:
        write_obj(beside / "neutral.obj", shapes.neutral)
        for name, delta in zip(shapes.names, shapes.deltas, strict=True):
            moved = shapes.neutral.vertices + delta
            write_obj(beside / f"{name}.obj", shapes.neutral.with_vertices(moved))
