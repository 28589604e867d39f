"""A neutral mesh with its named shapes: what a blendshape rig is."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.errors import FormatError, MeshError
from rig.files import atomic_write
from rig.mesh.trimesh import TriMesh

Floats = NDArray[np.float64]

MAX_SHAPES = 2000
"""Most shapes one set may hold."""


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
        Named vertices, for registration; see `rig.mesh.landmarks`.

    Raises
    ------
    MeshError
        If names are doubled, counts differ, or a displacement is not finite.
    """

    neutral: TriMesh
    names: tuple[str, ...]
    deltas: NDArray[np.float32]
    landmarks: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        names = tuple(str(name) for name in self.names)
        deltas = np.array(self.deltas, dtype=np.float32)
        doubled = sorted({name for name in names if names.count(name) > 1})
        if doubled:
            raise MeshError(f"shape {doubled[0]!r} appears twice; rename one")
        if len(names) > MAX_SHAPES:
            raise MeshError(f"{len(names)} shapes; at most {MAX_SHAPES}")
        expected = (len(names), *self.neutral.vertices.shape)
        if deltas.shape != expected:
            raise MeshError(
                f"deltas have shape {deltas.shape}; {len(names)} names and the neutral mesh "
                f"need {expected}"
            )
        broken = [n for n, d in zip(names, deltas, strict=True) if not np.isfinite(d).all()]
        if broken:
            raise MeshError(f"shape {broken[0]!r} holds numbers that are not finite")
        deltas.setflags(write=False)
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "deltas", deltas)

    def index(self, name: str) -> int:
        """Position of a shape; MeshError names the nearest known ones if there is none."""
        if name not in self.names:
            raise MeshError(f"no shape {name!r}; known shapes: {', '.join(self.names[:12])} ...")
        return self.names.index(name)

    def delta(self, name: str) -> Floats:
        """Displacement of one shape [shape=(V, 3)] as float64."""
        return np.asarray(self.deltas[self.index(name)], dtype=np.float64)

    def evaluate(self, weights: Any) -> Floats:
        """Vertices at `weights` [shape=(T, K)] -> [shape=(T, V, 3)]: neutral + sum of deltas."""
        w = np.asarray(weights, dtype=np.float64)
        if w.ndim != 2 or w.shape[1] != len(self.names):
            raise MeshError(f"weights have shape {w.shape}; they must be (T, {len(self.names)})")
        flat: Floats = w @ self.deltas.reshape(len(self.names), -1)
        return np.asarray(self.neutral.vertices + flat.reshape(len(w), -1, 3))


def write_shapes_npz(path: Path | str, shapes: ShapeSet) -> None:
    """Write `neutral`, `triangles`, `names`, `deltas` and landmarks as one compressed NPZ."""
    with atomic_write(path) as beside, open(beside, "wb") as file:
        np.savez_compressed(
            file,
            neutral=shapes.neutral.vertices,
            triangles=shapes.neutral.faces.astype(np.int32),
            names=np.array(shapes.names, dtype=str),
            deltas=shapes.deltas,
            landmark_names=np.array(list(shapes.landmarks), dtype=str),
            landmark_vertices=np.array(list(shapes.landmarks.values()), dtype=np.int64),
        )


def read_shapes_npz(path: Path | str) -> ShapeSet:
    """Read what `write_shapes_npz` wrote; nothing in the file is unpickled.

    Raises
    ------
    FormatError
        If the file is no NPZ or lacks `neutral`, `triangles`, `names` or `deltas`.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {key: file[key] for key in file.files}
    except (OSError, ValueError, EOFError) as error:
        raise FormatError(f"{Path(path).name} is not a readable NPZ file: {error}") from None
    missing = [k for k in ("neutral", "triangles", "names", "deltas") if k not in arrays]
    if missing:
        raise FormatError(
            f"{Path(path).name} has no array {missing[0]!r}; a shape file holds neutral (V, 3), "
            "triangles (N, 3), names (K,) and deltas (K, V, 3)"
        )
    names = arrays.get("landmark_names", np.array([], dtype=str))
    vertices = arrays.get("landmark_vertices", np.array([], dtype=np.int64))
    return ShapeSet(
        TriMesh(arrays["neutral"], arrays["triangles"]),
        tuple(str(name) for name in arrays["names"]),
        arrays["deltas"],
        {str(n): int(v) for n, v in zip(names, vertices, strict=True)},
    )
