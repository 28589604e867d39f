"""The numbers of docs/mesh.md: ``python -m deitalk.research.evaluation.retargeting ICT.npz``.

Without a face, only those of the embedded head. The file holds `neutral` (V, 3) in cm, `triangles`
(N, 3) and `expression_deltas` (K, V, 3); any face of a few thousand vertices that looks along +z
does.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np

from deitalk.research.arguments import new_file
from deitalk.research.meshes.gradient_bases import choose_bases
from deitalk.research.meshes.packing import pack_vertices, polar
from rig.arrays import Float64
from rig.files import atomic_write
from rig.mesh.deformation import DeformationSolver, deformation_gradients, gradient_entries
from rig.mesh.trimesh import TriMesh
from rig.retarget.found_landmarks import guess_landmarks
from rig.retarget.head_source import source_head
from rig.retarget.methods import Method, carry_shapes
from rig.retarget.registration import lip_labels

RUNS = 5
PAPER_TRIANGLES = 9976
"""SDFA §4.1: N of its template."""


Row = dict[str, Any]


def main(arguments: Sequence[str] | None = None) -> None:
    """Write every row to standard output as it is measured; all but the times to a file."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("face", nargs="?", help=".npz")
    parser.add_argument("--json", type=new_file, help="also write the errors to this file")
    given = parser.parse_args(arguments)
    report: dict[str, list[Row]] = {}
    parts = {} if given.face is None else of_file(given.face)
    for name, rows in (parts | {"retargeting": retargeting()}).items():
        for row in rows:
            sys.stdout.write(f"{name}: {row}\n")
            sys.stdout.flush()
            if name != "timings":
                report.setdefault(name, []).append(row)
    if given.json is not None:
        with atomic_write(given.json) as beside:
            beside.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")


def of_file(path: str) -> dict[str, Iterator[Row]]:
    """Parts that need a face from a file."""
    with np.load(path, allow_pickle=False) as file:
        mesh = TriMesh(file["neutral"], file["triangles"])
        deltas = file["expression_deltas"].astype(np.float64)
    return {
        part.__name__: part(mesh, deltas, np.random.default_rng(seed))
        for seed, part in enumerate((round_trip, timings, bases))
    }


def retargeting() -> Iterator[Row]:
    """Shapes carried from one embedded head to others, against their own."""
    source = source_head(0)
    for identity in (1, 2, 3):
        head = source_head(identity)
        neutral = head.rig.shapes.neutral
        shared = [n for n in source.rig.shapes.names if n in head.rig.shapes.names]
        truth = np.stack([head.rig.shapes.delta(n) for n in shared])
        motion = 10 * np.linalg.norm(truth, axis=-1)  # mm
        lips = lip_labels(neutral, head.landmarks) != 0
        guessed = guess_landmarks(neutral, source.mesh, source.landmarks)
        for way, marks, method in (
            ("displacements", head.landmarks, "displacements"),
            ("gradients", head.landmarks, "gradients"),
            ("displacements, landmarks guessed", guessed, "displacements"),
        ):
            shapes = replace(source.rig.shapes, landmarks=source.landmarks)
            made = carry_shapes(shapes, neutral, marks, method=cast(Method, method)).shapes
            error = 10 * np.linalg.norm(np.stack([made.delta(n) for n in shared]) - truth, axis=-1)
            jaw = shared.index("CTRL_C_jaw.ty")
            yield {
                "head": identity,
                "way": way,
                "shapes": len(shared),
                "motion_mm": float(motion[motion > 1].mean()),
                "moving_mm": float(error[motion > 1].mean()),
                "lips_mm": float(error[:, lips].mean()),
                "open_jaw_lips_mm": float(error[jaw, lips].mean()),
            }


def round_trip(mesh: TriMesh, deltas: Float64, rng: np.random.Generator) -> Iterator[Row]:
    """Largest vertex error over the size of the head, in three storages; polar against SVD."""
    moved = mesh.vertices + np.concatenate([deltas, mixes(deltas, rng, 30)])
    s, r = pack_vertices(mesh, moved)
    solver = DeformationSolver(mesh)
    pins = moved[:, solver.pins]
    for dtype in (np.float64, np.float32, np.float16):
        solved = solver.solve(s.astype(dtype), r.astype(dtype), pin_positions=pins)
        error = np.linalg.norm(solved - moved, axis=-1).max() / mesh.size
        yield {"storage": np.dtype(dtype).name, "frames": len(moved), "of_head_size": float(error)}
    gradients = deformation_gradients(mesh, mesh.vertices + deltas)
    rotation, stretch = polar(gradients)
    u, values, vt = np.linalg.svd(gradients)
    yield {
        "singular_values": [float(values.min()), float(values.max())],
        "polar_against_svd": float(np.abs(rotation - u @ vt).max()),
        "product_against_gradient": float(np.abs(rotation @ stretch - gradients).max()),
    }


def timings(mesh: TriMesh, deltas: Float64, rng: np.random.Generator) -> Iterator[Row]:
    """Milliseconds a frame on the paper's number of triangles around the face's middle."""
    front = mesh.vertices[np.argmax(mesh.vertices[:, 2])]
    distance = np.linalg.norm(mesh.vertices[mesh.faces].mean(axis=1) - front, axis=1)
    nearest = np.argsort(distance, kind="stable")[:PAPER_TRIANGLES]
    small, used = TriMesh(mesh.vertices, mesh.faces[nearest]).compact()
    frames = 96
    moved = small.vertices + mixes(deltas[:, used], rng, frames)
    yield {"triangles": len(small.faces), "vertices": len(small.vertices), "best of": RUNS}
    seconds, (s, r) = _best(lambda: pack_vertices(small, moved))
    yield {"gradients, polar, log, ms a frame": 1e3 * seconds / frames}
    seconds, solver = _best(lambda: DeformationSolver(small))
    yield {"set static mesh, ms once": 1e3 * seconds}
    pins = moved[:, solver.pins]
    seconds, _ = _best(lambda: solver.solve(s, r, pin_positions=pins))
    yield {"whole reconstruction, ms a frame": 1e3 * seconds / frames}
    right = np.empty((3, len(solver._free)))

    def assemble() -> None:
        for stretch, turn, pin in zip(s, r, pins, strict=True):
            rows = gradient_entries(stretch.reshape(-1, 6).T, turn.reshape(-1, 3).T)
            solver._assemble(rows, pin, right)

    seconds, _ = _best(assemble)
    yield {"exp and assembly, ms a frame": 1e3 * seconds / frames}
    chunk = np.tile(right, (8, 1))

    def substitute() -> None:
        with solver._threads.limit(limits=1, user_api="blas"):
            for _ in range(frames // 8):
                solver._factors.solve(chunk.T)

    seconds, _ = _best(substitute)
    yield {"solve (Eq. 6), ms a frame": 1e3 * seconds / frames}


def bases(mesh: TriMesh, deltas: Float64, rng: np.random.Generator) -> Iterator[Row]:
    """Sizes of the bases against the error at the most mobile tenth of the vertices."""
    moved = mesh.vertices + mixes(deltas, rng, 400)
    motion = np.linalg.norm(deltas, axis=-1).mean(axis=0)
    mobile = np.flatnonzero(motion >= np.quantile(motion, 0.9))
    found = choose_bases(mesh, moved[:340], moved[340:], mobile, bound=0.05)
    for row in found.table:
        yield {
            "variance": float(row["variance"]),
            "stretch": int(row["stretch"]),
            "rotation": int(row["rotation"]),
            "mean_mm": 10 * float(row["mean"]),
            "mobile_p99_mm": 10 * float(row["lips_p99"]),
            "mobile_max_mm": 10 * float(row["lips_max"]),
        }


def mixes(deltas: Float64, rng: np.random.Generator, frames: int) -> Float64:
    """Random faces: each shape is on in 15 % of the frames, with an exponential weight up to 1."""
    shape = (frames, len(deltas))
    weights = np.minimum(rng.exponential(0.25, shape), 1.0) * (rng.random(shape) < 0.15)
    mixed = weights @ deltas.reshape(len(deltas), -1)
    return np.asarray(mixed.reshape(frames, *deltas.shape[1:]))


def _best(work: Callable[[], Any]) -> tuple[float, Any]:
    times = []
    for _ in range(RUNS):
        start = time.perf_counter()
        result = work()
        times.append(time.perf_counter() - start)
    return min(times), result


if __name__ == "__main__":
    main()
