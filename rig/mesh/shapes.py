"""A neutral mesh with named shapes: the geometry of a blendshape rig."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.arrays import Float32, Float64, Int64
from rig.errors import FormatError, MeshError, quoted
from rig.files.reading import read_npz
from rig.limits import COORDINATE, POINT_NAMES, SHAPE_VALUES, SHAPES, UNPACKED_BYTES
from rig.mesh.trimesh import TriMesh

Moved = tuple[Int64, Float32]
"""Vertices (n,), ascending, and their displacements (n, 3); the others stay."""


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

    @property
    def moved(self) -> Iterator[Moved]:
        """What each shape moves."""
        return map(moved_of, self.deltas)

    def delta(self, name: str) -> Float64:
        """Displacement of one shape [shape=(V, 3)] as float64."""
        return np.asarray(self.deltas[self.names.index(name)], dtype=np.float64)

    def evaluate(self, weights: Any) -> Float64:
        """Vertices at `weights` [shape=(T, K)] -> [shape=(T, V, 3)]: neutral + sum of deltas."""
        flat = np.asarray(weights, np.float64) @ self.deltas.reshape(len(self.names), -1)
        return np.asarray(self.neutral.vertices + flat.reshape(len(weights), -1, 3))


@dataclass(frozen=True, eq=False)
class SparseShapes:
    """The same without vertices that stay: most of a face does in most shapes.

    Parameters
    ----------
    neutral : TriMesh
    names : tuple of str
        K different names.
    moved : sequence of tuple
        What each shape moves.
    """

    neutral: TriMesh
    names: tuple[str, ...]
    moved: Sequence[Moved]

    def dense(self) -> ShapeSet:
        """Return the shapes with a displacement of every vertex."""
        deltas = np.zeros((len(self.names), *self.neutral.vertices.shape), np.float32)
        for delta, (vertices, displacement) in zip(deltas, self.moved, strict=True):
            delta[vertices] = displacement
        deltas.setflags(write=False)  # not copied again
        return ShapeSet(self.neutral, self.names, deltas)


def moved_of(delta: Float32) -> Moved:
    """Return what displacements (V, 3) move."""
    vertices = np.flatnonzero(delta.reshape(-1) != 0) // 3
    vertices = vertices[np.diff(vertices, prepend=-1) > 0]
    return vertices, np.take(delta, vertices, axis=0)


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
