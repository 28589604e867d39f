"""Meshes and shapes as files that `rig.mesh` reads and never writes."""

from pathlib import Path

import numpy as np

from rig.mesh import ShapeSet, TriMesh


def write_obj(path: Path, mesh: TriMesh) -> None:
    """Positions and triangles; floats in the shortest form that reads back equal."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def write_obj_folder(folder: Path, shapes: ShapeSet) -> None:
    """`neutral.obj` and one file per shape."""
    folder.mkdir(exist_ok=True)
    write_obj(folder / "neutral.obj", shapes.neutral)
    for name, delta in zip(shapes.names, shapes.deltas, strict=True):
        moved = shapes.neutral.vertices + delta
        write_obj(folder / f"{name}.obj", shapes.neutral.with_vertices(moved))


def write_shapes_npz(path: Path, shapes: ShapeSet) -> None:
    np.savez_compressed(
        path,
        neutral=shapes.neutral.vertices,
        triangles=shapes.neutral.faces.astype(np.int32),
        names=np.array(shapes.names, dtype=str),
        deltas=shapes.deltas,
        landmark_names=np.array(list(shapes.landmarks), dtype=str),
        landmark_vertices=np.array(list(shapes.landmarks.values()), dtype=np.int64),
    )
