"""The numbers of docs/mesh.md: ``python -m rig.retarget.measure ict_face.npz``.

Without a file, only those of the embedded head. The file holds `neutral` (V, 3) in cm, `triangles`
(N, 3) and `expression_deltas` (K, V, 3); any face of a few thousand vertices that looks along +z
does.
"""

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np

from rig.arrays import Float64
from rig.deformation.basis import choose_bases
from rig.deformation.gradients import deformation_gradients, gradient_entries, pack_vertices
from rig.deformation.reconstruct import DeformationSolver
from rig.deformation.rotations import polar
from rig.mesh.trimesh import TriMesh
from rig.retarget.landmark_guess import guess_landmarks
from rig.retarget.methods import Method, carry_shapes
from rig.retarget.registration import lip_labels
from rig.retarget.source_head import source_head

PAPER_TRIANGLES = 9976
"""SDFA §4.1: N of its template."""


def main(path: str | None) -> None:
    """Write every row to standard output as it is measured."""
    for row in [] if path is None else of_file(path):
        sys.stdout.write(row + "\n")
        sys.stdout.flush()
    for row in retargeting():
        sys.stdout.write(row + "\n")
        sys.stdout.flush()


def of_file(path: str) -> Iterator[str]:
    """Rows that need a face from a file."""
    with np.load(path, allow_pickle=False) as file:
        mesh = TriMesh(file["neutral"], file["triangles"])
        deltas = file["expression_deltas"].astype(np.float64)
    rng = np.random.default_rng(0)
    for part in (round_trip, timings, bases):
        yield from part(mesh, deltas, rng)


def retargeting(identities: Sequence[int] = (1, 2, 3)) -> Iterator[str]:
    """Shapes carried from one embedded head to others, against their own."""
    source = source_head(0)
    for identity in identities:
        head = source_head(identity)
        neutral = head.rig.shapes.neutral
        shared = [n for n in source.rig.shapes.names if n in head.rig.shapes.names]
        truth = np.stack([head.rig.shapes.delta(n) for n in shared])
        motion = 10 * np.linalg.norm(truth, axis=-1)  # mm
        lips = lip_labels(neutral, head.landmarks) != 0
        guessed = guess_landmarks(neutral, source.mesh, source.landmarks).landmarks
        for way, marks, method in (
            ("displacements", head.landmarks, "displacements"),
            ("gradients", head.landmarks, "gradients"),
            ("displacements, landmarks guessed", guessed, "displacements"),
        ):
            start = time.perf_counter()
            shapes = replace(source.rig.shapes, landmarks=source.landmarks)
            made = carry_shapes(shapes, neutral, marks, method=cast(Method, method)).shapes
            seconds = time.perf_counter() - start
            error = 10 * np.linalg.norm(np.stack([made.delta(n) for n in shared]) - truth, axis=-1)
            jaw = shared.index("CTRL_C_jaw.ty")
            yield (
                f"head 0 to {identity}, {way}: {seconds:.1f} s, {len(shared)} shapes; mm: moving "
                f"vertices {error[motion > 1].mean():.2f} of {motion[motion > 1].mean():.2f}, lips "
                f"{error[:, lips].mean():.2f}, lips of the open jaw {error[jaw, lips].mean():.2f}"
            )


def round_trip(mesh: TriMesh, deltas: Float64, rng: np.random.Generator) -> Iterator[str]:
    """Largest vertex error over the size of the head, in three storages; polar against SVD."""
    moved = mesh.vertices + np.concatenate([deltas, mixes(deltas, rng, 30)])
    s, r = pack_vertices(mesh, moved)
    solver = DeformationSolver(mesh)
    pins = moved[:, solver.pins]
    for dtype in (np.float64, np.float32, np.float16):
        solved = solver.solve(s.astype(dtype), r.astype(dtype), pin_positions=pins)
        error = np.linalg.norm(solved - moved, axis=-1).max() / mesh.size
        yield f"round trip {len(moved)} frames, {np.dtype(dtype).name:8s} {error:.1e} of head size"
    gradients = deformation_gradients(mesh, mesh.vertices + deltas)
    rotation, stretch = polar(gradients)
    u, values, vt = np.linalg.svd(gradients)
    yield f"singular values of T: {values.min():.3g} to {values.max():.3g}"
    yield f"polar against SVD: {np.abs(rotation - u @ vt).max():.1e}"
    yield f"R S against T: {np.abs(rotation @ stretch - gradients).max():.1e}"


def timings(mesh: TriMesh, deltas: Float64, rng: np.random.Generator) -> Iterator[str]:
    """Milliseconds a frame on the paper's number of triangles around the face's middle."""
    front = mesh.vertices[np.argmax(mesh.vertices[:, 2])]
    distance = np.linalg.norm(mesh.vertices[mesh.faces].mean(axis=1) - front, axis=1)
    nearest = np.argsort(distance, kind="stable")[:PAPER_TRIANGLES]
    small, used = TriMesh(mesh.vertices, mesh.faces[nearest]).compact()
    frames = 96
    moved = small.vertices + mixes(deltas[:, used], rng, frames)
    yield f"{len(small.faces)} triangles, {len(small.vertices)} vertices; best of 5 runs"
    seconds, (s, r) = _best(lambda: pack_vertices(small, moved))
    yield f"  training direction (gradients, polar, log)  {1e3 * seconds / frames:6.2f} ms a frame"
    seconds, solver = _best(lambda: DeformationSolver(small))
    yield f"  set static mesh (assemble and factor)       {1e3 * seconds:6.2f} ms once"
    pins = moved[:, solver.pins]
    seconds, _ = _best(lambda: solver.solve(s, r, pin_positions=pins))
    yield f"  whole reconstruction                        {1e3 * seconds / frames:6.2f} ms a frame"
    right = np.empty((3, len(solver._free)))

    def assemble() -> None:
        for stretch, turn, pin in zip(s, r, pins, strict=True):
            rows = gradient_entries(stretch.reshape(-1, 6).T, turn.reshape(-1, 3).T)
            solver._assemble(rows, pin, right)

    seconds, _ = _best(assemble)
    yield f"    exp and assembly                          {1e3 * seconds / frames:6.2f} ms a frame"
    chunk = np.tile(right, (8, 1))

    def substitute() -> None:
        with solver._threads.limit(limits=1, user_api="blas"):
            for _ in range(frames // 8):
                solver._factors.solve(chunk.T)

    seconds, _ = _best(substitute)
    yield f"    solve (Eq. 6)                             {1e3 * seconds / frames:6.2f} ms a frame"


def bases(mesh: TriMesh, deltas: Float64, rng: np.random.Generator) -> Iterator[str]:
    """Sizes of the bases against the error at the most mobile tenth of the vertices."""
    moved = mesh.vertices + mixes(deltas, rng, 400)
    motion = np.linalg.norm(deltas, axis=-1).mean(axis=0)
    mobile = np.flatnonzero(motion >= np.quantile(motion, 0.9))
    found = choose_bases(mesh, moved[:340], moved[340:], mobile, bound=0.05)
    for row in found.table:
        yield (
            f"variance {row['variance']:.4f}: stretch {row['stretch']:.0f}, rotation "
            f"{row['rotation']:.0f}; unseen frames, mm: mean {10 * row['mean']:.3f}, "
            f"mobile p99 {10 * row['lips_p99']:.2f}, max {10 * row['lips_max']:.2f}"
        )


def mixes(deltas: Float64, rng: np.random.Generator, frames: int) -> Float64:
    """Random faces: each shape is on in 15 % of the frames, with an exponential weight up to 1."""
    shape = (frames, len(deltas))
    weights = np.minimum(rng.exponential(0.25, shape), 1.0) * (rng.random(shape) < 0.15)
    mixed = weights @ deltas.reshape(len(deltas), -1)
    return np.asarray(mixed.reshape(frames, *deltas.shape[1:]))


def _best(work: Callable[[], Any]) -> tuple[float, Any]:
    times = []
    for _ in range(5):
        start = time.perf_counter()
        result = work()
        times.append(time.perf_counter() - start)
    return min(times), result


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else None)
