"""A neutral mesh with named shapes: the geometry of a blendshape rig."""

import itertools
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.arrays import Float32, Float64
from rig.errors import FormatError, MeshError, TopologyError, quoted
from rig.files.reading import open_file, read_npz
from rig.limits import (
    COORDINATE,
    MESH_BYTES,
    POINT_NAMES,
    SHAPE_VALUES,
    SHAPES,
    TRIANGLES,
    UNPACKED_BYTES,
    VERTICES,
)
from rig.mesh.trimesh import TriMesh


@dataclass(frozen=True, eq=False)
class ShapeSet:
    """A neutral mesh and K named displacements of it.

    Parameters
    ----------
    neutral : TriMesh
    names : tuple of str
        K different names.
    deltas : array [shape=(K, V, 3)]
        Displacement of every vertex at weight 1; kept as float32.
    landmarks : mapping of str to int
        Named vertices, for registration; see `rig.retarget.landmarks`.

    Raises
    ------
    MeshError
        If names are doubled, counts differ, or a displacement is not finite.
    """

    neutral: TriMesh
    names: tuple[str, ...]
    deltas: Float32
    landmarks: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        names = tuple(str(name) for name in self.names)
        check_shape_count(len(names), len(self.neutral.vertices))
        doubled = sorted({name for name in names if names.count(name) > 1})
        if doubled:
            raise MeshError(f"shape {quoted(doubled[0])} appears twice; rename one")
        with np.errstate(over="ignore"):  # what becomes infinite is named below
            deltas = np.asarray(self.deltas, dtype=np.float32)
        if deltas.flags.writeable:
            deltas = deltas.copy()
        expected = (len(names), *self.neutral.vertices.shape)
        if deltas.shape != expected:
            raise MeshError(
                f"deltas have shape {deltas.shape}; {len(names)} names and the neutral mesh "
                f"need {expected}"
            )
        for name, delta in zip(names, deltas, strict=True):
            if delta.size and not -COORDINATE <= delta.min() <= delta.max() <= COORDINATE:
                raise MeshError(
                    f"shape {quoted(name)} holds numbers that are not finite or beyond "
                    f"±{COORDINATE:g}"
                )
        deltas.setflags(write=False)
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "deltas", deltas)

    def index(self, name: str) -> int:
        """Position of a shape; MeshError names the nearest known ones if there is none."""
        if name not in self.names:
            raise MeshError(f"no shape {name!r}; known shapes: {', '.join(self.names[:12])} ...")
        return self.names.index(name)

    def delta(self, name: str) -> Float64:
        """Displacement of one shape [shape=(V, 3)] as float64."""
        return np.asarray(self.deltas[self.index(name)], dtype=np.float64)

    def evaluate(self, weights: Any) -> Float64:
        """Vertices at `weights` [shape=(T, K)] -> [shape=(T, V, 3)]: neutral + sum of deltas."""
        w = np.asarray(weights, dtype=np.float64)
        if w.ndim != 2 or w.shape[1] != len(self.names):
            raise MeshError(f"weights have shape {w.shape}; they must be (T, {len(self.names)})")
        flat: Float64 = w @ self.deltas.reshape(len(self.names), -1)
        return np.asarray(self.neutral.vertices + flat.reshape(len(w), -1, 3))


def check_shape_count(n_shapes: int, n_vertices: int) -> None:
    """Refuse a set of shapes that is not held in memory.

    Raises
    ------
    MeshError
        If there are more than `limits.SHAPES` shapes or `limits.SHAPE_VALUES` numbers.
    """
    if n_shapes > SHAPES:
        raise MeshError(f"{n_shapes} shapes; at most {SHAPES} are read")
    if 3 * n_shapes * n_vertices > SHAPE_VALUES:
        raise MeshError(
            f"{n_shapes} shapes of {n_vertices} vertices are more than {SHAPE_VALUES} numbers; "
            "decimate the mesh, or export fewer shapes"
        )


def read_shapes_npz(path: Path | str) -> ShapeSet:
    """Read `neutral`, `triangles`, `names`, `deltas` and landmarks of an NPZ; nothing is unpickled.

    Raises
    ------
    FormatError
        If the file is no NPZ or lacks `neutral`, `triangles`, `names` or `deltas`, or an array is
        of a wrong type.
    """
    arrays = read_npz(Path(path), limit=UNPACKED_BYTES)
    missing = [k for k in ("neutral", "triangles", "names", "deltas") if k not in arrays]
    if missing:
        raise FormatError(
            f"{Path(path).name} has no array {missing[0]!r}; a shape file holds neutral (V, 3), "
            "triangles (N, 3), names (K,) and deltas (K, V, 3)"
        )
    for key, kinds in _KINDS.items():
        if key in arrays and arrays[key].dtype.kind not in kinds:
            raise FormatError(f"{Path(path).name}: array {key!r} holds {arrays[key].dtype}")
    neutral = TriMesh(arrays["neutral"], arrays["triangles"])
    names = _texts(path, "names", arrays["names"], SHAPES)
    check_shape_count(len(names), len(neutral.vertices))
    return ShapeSet(neutral, names, arrays["deltas"], _landmarks(path, arrays, neutral))


_KINDS = {"neutral": "iuf", "triangles": "iu", "names": "U", "deltas": "iuf",
          "landmark_names": "U", "landmark_vertices": "iu"}  # fmt: skip


def _texts(path: Path | str, key: str, array: NDArray[Any], most: int) -> tuple[str, ...]:
    if array.ndim != 1 or len(array) > most:
        raise FormatError(
            f"{Path(path).name}: {key} have shape {array.shape}; they must be (K,), at most {most}"
        )
    return tuple(str(name) for name in array)


def _landmarks(
    path: Path | str, arrays: Mapping[str, NDArray[Any]], neutral: TriMesh
) -> dict[str, int]:
    """Landmarks of a shape file; FormatError unless each is one of its vertices."""
    names = arrays.get("landmark_names", np.array([], dtype=str))
    vertices = arrays.get("landmark_vertices", np.array([], dtype=np.int64))
    marked = _texts(path, "landmark_names", names, POINT_NAMES)
    is_inside = (vertices >= 0) & (vertices < len(neutral.vertices))
    if vertices.shape != names.shape or not is_inside.all():
        raise FormatError(
            f"{Path(path).name}: landmark_vertices must give one of {len(neutral.vertices)} "
            f"vertices for each of {len(marked)} names"
        )
    return {name: int(vertex) for name, vertex in zip(marked, vertices, strict=True)}


# Wavefront OBJ: one mesh, or a folder with one file per shape.
#
# Only positions and faces are read; texture coordinates, normals, groups and materials are skipped.
# Polygons become fans from their first corner, so that equal files give equal triangles. Vertices
# without a face are kept, so that indices stay.


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
                triangles.extend(_fan(_corners(line, len(vertices) // 3)))
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


def _fan(corners: Sequence[int]) -> list[int]:
    """Corners of the triangles of a polygon, one after the other."""
    pairs = itertools.pairwise(corners[1:])
    return [corner for pair in pairs for corner in (corners[0], *pair)]


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
