"""Sequences of one mesh's vertices to files: GLB, NPZ, folders of PLY.

NPZ and PLY hold every vertex of every frame. GLB players support only morph targets, so a
sequence is first approximated by a few of them.
"""

from pathlib import Path
from typing import Any, Literal

import numpy as np

from rig.arrays import Float32, Float64
from rig.errors import FormatError
from rig.files import atomic_write, is_folder_name
from rig.mesh.glb import WeightAnimation, write_glb
from rig.mesh.ply import write_ply_sequence
from rig.mesh.shapes import ShapeSet
from rig.mesh.trimesh import TriMesh, check_length

Kind = Literal["glb", "npz", "folder"]

_FRAMES_AT_FIRST = 384
"""Frames that principal shapes are first taken from, evenly over the sequence."""
_FRAMES_MORE = 128
"""Frames that are added at a time, those with the largest error, until the bound holds."""
_FRAMES_AT_ONCE = 64


def check_out(out: Path | str) -> Kind:
    """Return the kind of file of a sequence: ``glb``, ``npz``, or a ``folder`` of PLY files.

    Raises
    ------
    FormatError
        If the parent is no folder.
    TargetError
        If the suffix is another file's (see `rig.files.is_folder_name`).
    """
    is_folder = is_folder_name(out, (".glb", ".npz"))
    path = Path(out)
    if not path.parent.is_dir():
        raise FormatError(f"{path.parent} is not a folder; make it first")
    if is_folder:
        return "folder"
    return "glb" if path.name.lower().endswith(".glb") else "npz"


def write_sequence(
    out: Path | str,
    mesh: TriMesh,
    vertices: Any,
    *,
    fps: float,
    tolerance: float = 0.0,
    unit_metres: float = 1.0,
    colours: Any = None,
) -> None:
    """Write a vertex sequence, whole or not at all.

    Parameters
    ----------
    out : Path or str
        ``.npz`` (`vertices` (T, V, 3) float32, `triangles` (N, 3), `fps`), a folder for PLY files
        (see `rig.files.is_folder_name`), or ``.glb`` (principal shapes as morph targets, and their
        animation).
    mesh : TriMesh
        The face at rest.
    vertices : array [shape=(T, V, 3)]
        Frame i is at i / fps seconds.
    fps : float
        Any rate above 0.
    tolerance : float
        Largest error of a vertex of the GLB, in the mesh's unit; 0 for a 100,000th of its size.
    unit_metres : float
        Metres in the mesh's unit; the GLB is in metres, the others in the mesh's unit.
    colours : array [shape=(V, 3), range 0 to 1], optional
        Linear vertex colours of the GLB.

    Raises
    ------
    FormatError, MeshError, TargetError
    """
    kind = check_out(out)
    out = Path(out)
    if kind == "glb":
        shapes, weights = principal_shapes(mesh, vertices, tolerance or 1e-5 * mesh.size)
        animation = WeightAnimation(weights, fps)
        write_glb(out, shapes, animation=animation, colours=colours, metres=unit_metres)
        return
    check_length(len(vertices), len(mesh.vertices))
    if kind == "folder":
        write_ply_sequence(out, mesh, vertices)
        return
    with atomic_write(out) as beside, open(beside, "wb") as file:
        np.savez_compressed(
            file,
            vertices=np.asarray(vertices, dtype=np.float32),
            triangles=mesh.faces.astype(np.int32),
            fps=fps,
        )


def principal_shapes(mesh: TriMesh, vertices: Any, tolerance: float) -> tuple[ShapeSet, Float32]:
    """Approximate a sequence by the fewest linear shapes that keep every vertex within a bound.

    Parameters
    ----------
    mesh : TriMesh
        The face at rest: where it rests, all weights are 0.
    vertices : array [shape=(T, V, 3)]
        At least one frame.
    tolerance : float
        Largest error of any vertex of any frame, in the mesh's unit.

    Returns
    -------
    shapes : ShapeSet
        K principal shapes, `motion_000` first, with the most variance.
    weights : array [shape=(T, K), range -1 to 1]
        Each column reaches 1 or -1.

    Notes
    -----
    The shapes come from the frames' Gram matrix. Where evenly chosen frames do not reach
    the bound, the frames with the largest error are added.
    """
    frames = np.asarray(vertices, dtype=np.float32)
    moving = np.zeros(len(mesh.vertices), bool)
    for frame in frames:
        moving |= (frame != mesh.vertices.astype(np.float32)).any(axis=1)
    moving[0] |= not moving.any()
    frames, rest = frames[:, moving], mesh.vertices[moving].astype(np.float32)
    chosen = np.unique(np.linspace(0, len(frames) - 1, _FRAMES_AT_FIRST).round().astype(int))
    while True:
        directions = _directions(frames[chosen] - rest)
        errors = _errors(frames, rest, directions)
        if errors.max() <= tolerance or len(chosen) == len(frames):
            break
        told_worst = np.argsort(errors)[-_FRAMES_MORE:]
        chosen = np.union1d(chosen, told_worst)
    directions = _fewest(frames[np.argsort(-errors)], rest, directions, tolerance)
    # Of every frame along the directions [shape=(T, K)].
    weights = np.concatenate(
        [
            (frames[k : k + _FRAMES_AT_ONCE] - rest).reshape(-1, rest.size) @ directions.T
            for k in range(0, len(frames), _FRAMES_AT_ONCE)
        ]
    )
    largest = np.maximum(np.abs(weights).max(axis=0, initial=0.0), 1e-12)
    deltas = np.zeros((len(directions), *mesh.vertices.shape))
    deltas[:, moving] = (directions * largest[:, None]).reshape(-1, *rest.shape)
    names = tuple(f"motion_{k:03d}" for k in range(len(deltas)))
    return ShapeSet(mesh, names, deltas), (weights / largest).astype(np.float32)


def _directions(deltas: Float32) -> Float64:
    """At least one orthonormal direction [shape=(K, 3 V)] that frames span, the strongest first."""
    flat = deltas.reshape(len(deltas), -1).astype(np.float64)
    power, left = np.linalg.eigh(flat @ flat.T)
    kept = np.flatnonzero(power > 1e-12 * max(float(power[-1]), 1e-30))[::-1]
    if not len(kept):
        return np.zeros((1, flat.shape[1]))
    return np.asarray((left[:, kept] / np.sqrt(power[kept])).T @ flat)


def _errors(frames: Float32, rest: Float32, directions: Float64, most: float = np.inf) -> Float64:
    """Largest vertex error of each frame [shape=(T,)]; 0 of those behind one above `most`."""
    worst = np.zeros(len(frames))
    for k in range(0, len(frames), _FRAMES_AT_ONCE):
        deltas = (frames[k : k + _FRAMES_AT_ONCE] - rest).reshape(-1, rest.size)
        left = deltas - (deltas @ directions.T) @ directions
        left = left.reshape(-1, *rest.shape)
        off = np.einsum("tvc,tvc->tv", left, left)
        worst[k : k + _FRAMES_AT_ONCE] = np.sqrt(off.max(axis=1))
        if worst.max() > most:
            break
    return worst


def _fewest(frames: Float32, rest: Float32, directions: Float64, tolerance: float) -> Float64:
    """The first directions that keep the bound; all of them where none do."""
    low, high = 1, len(directions)
    while low < high:
        middle = (low + high) // 2
        if _errors(frames, rest, directions[:middle], tolerance).max() <= tolerance:
            high = middle
        else:
            low = middle + 1
    return directions[:high]
