"""The linear bases that a mesh model predicts in: of gradients and of vertex offsets (SDFA §4.4).

Letters: T frames, N triangles, V vertices, K components.
"""

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from deitalk.errors import DataError
from deitalk.research.meshes.gradient_bases import (
    VARIANCES,
    Bases,
    GradientBasis,
    fit_basis,
    read_bases,
    write_bases,
)
from deitalk.research.meshes.packing import pack_vertices
from rig.arrays import Float32, Float64, Int64
from rig.errors import RigError
from rig.mesh.deformation import mesh_solver
from rig.mesh.trimesh import TriMesh, triangle_areas

Moving = Sequence[tuple[str, Callable[[], Float32]]]
"""Speaker and a call that gives a sequence's vertices (T, V, 3)."""

_HELD_OUT_FRAMES = 60
_FRAMES_A_CLIP = 6
"""A clip is loaded whole for so many of its frames."""
_LIVELY_SHARE = 0.05
"""Share of the vertices that move most: lips and jaw, where the error of a basis shows."""


@dataclass(frozen=True, eq=False)
class MeshBases:
    """Bases of stretch, rotation and offsets.

    Parameters
    ----------
    stretch, rotation, offsets : GradientBasis
        Offsets are vertices minus the template's, every vertex weighted alike.
    table : tuple of dict
        A row a size tried: what is kept and what it costs in mm on held-out frames.
    """

    stretch: GradientBasis
    rotation: GradientBasis
    offsets: GradientBasis
    table: tuple[dict[str, float], ...] = ()


@dataclass(frozen=True, eq=False)
class _Drawn:
    """Frames of one speaker."""

    speaker: str
    s: Float64
    r: Float64
    offsets: Float64
    """[shape=(T, 3 V)]."""


def fit_mesh_bases(
    templates: Mapping[str, TriMesh],
    training: Moving,
    held_out: Moving,
    *,
    n_frames: int,
    error_mm: float,
    unit_mm: float,
    variance: float | None = None,
    weigh_triangles: bool = True,
) -> MeshBases:
    """Bases of the training sequences, as small as held-out frames allow.

    Parameters
    ----------
    templates : mapping of str to TriMesh
        Of every speaker.
    training, held_out : sequence of (str, callable)
        Speakers and their motion.
    n_frames : int
        Frames to fit to.
    error_mm : float
        What the bases may cost: the 99th percentile of vertex error over the twentieth of the
        vertices that moves most in held-out frames.
    unit_mm : float
        Millimetres in a unit of the templates.
    variance : float, optional, range 0 to 1
        Share of the variance to keep, whatever it costs: .97 in the paper.
    weigh_triangles : bool
        Weigh triangles by their area; not in the paper.

    Returns
    -------
    MeshBases
        Of `variance`; without it of the smallest share within `error_mm`, for gradients and for
        offsets apart, else of the largest share tried.

    Notes
    -----
    Deviation: by default the size follows from the error and triangles are weighted, where the
    paper keeps 97 % of the variance of unweighted numbers; see `gradient_bases.py`. All
    speakers share the bases, and the weights are from the mean of their triangles' areas.
    """
    areas = np.mean([triangle_areas(t) for t in templates.values()], axis=0)
    areas = areas if weigh_triangles else np.ones_like(areas)
    drawn = _draw(templates, training, n_frames, 0)
    stretch, rotation = (
        fit_basis(np.concatenate([getattr(d, kind) for d in drawn]), areas) for kind in "sr"
    )
    offsets = fit_basis(np.concatenate([d.offsets for d in drawn]), np.ones(len(_first(templates))))
    unseen = _draw(templates, held_out, _HELD_OUT_FRAMES, 1)
    solvers = {d.speaker: mesh_solver(templates[d.speaker]) for d in unseen}
    truth = [solvers[d.speaker].solve(d.s, d.r) for d in unseen]
    moving = _lively(truth, [templates[d.speaker] for d in unseen])

    def solved(bases: Sequence[GradientBasis]) -> list[Float64]:
        through = [lambda values, b=basis: b.expand(b.project(values)) for basis in bases]
        return [solvers[d.speaker].solve(through[0](d.s), through[1](d.r)) for d in unseen]

    def added(bases: Sequence[GradientBasis]) -> list[Float64]:
        expand, project = bases[0].expand, bases[0].project
        return [
            templates[d.speaker].vertices + expand(project(d.offsets)).reshape(t.shape)
            for d, t in zip(unseen, truth, strict=True)
        ]

    def errors(vertices: list[Float64]) -> Float64:
        pairs = zip(vertices, truth, strict=True)
        return unit_mm * np.concatenate([np.linalg.norm(a - b, axis=-1) for a, b in pairs])

    small: list[GradientBasis] = []
    table: list[dict[str, float]] = []
    for whole, moved in (((stretch, rotation), solved), ((offsets,), added)):
        for share in VARIANCES if variance is None else (variance,):
            cut = tuple(basis.truncated(basis.size_for(share)) for basis in whole)
            error = errors(moved(cut))
            p99 = float(np.percentile(error[:, moving], 99))
            table.append(_row(share, cut, error, p99, is_offsets=moved is added))
            if p99 <= error_mm:
                break
        small += cut
    return MeshBases(small[0], small[1], small[2], tuple(table))


def _row(
    share: float, cut: Sequence[GradientBasis], error: Float64, p99: float, *, is_offsets: bool
) -> dict[str, float]:
    """A row of the table of sizes that were tried."""
    return {
        "offsets": float(is_offsets),
        "variance": share,
        "first": len(cut[0].deviations),
        "second": len(cut[-1].deviations),
        "mean_mm": float(error.mean()),
        "lively_p99_mm": p99,
    }


def _first(templates: Mapping[str, TriMesh]) -> Float64:
    return next(iter(templates.values())).vertices


def _draw(
    templates: Mapping[str, TriMesh], sequences: Moving, n_frames: int, seed: int
) -> list[_Drawn]:
    """Frames drawn evenly from a few of the sequences."""
    rng = np.random.default_rng(seed)
    n_clips = min(len(sequences), max(n_frames // _FRAMES_A_CLIP, 1))
    each = -(-n_frames // n_clips)
    drawn = []
    for i in rng.permutation(len(sequences))[:n_clips]:
        speaker, load = sequences[i]
        vertices = load()
        chosen = np.sort(rng.permutation(len(vertices))[:each])
        frames, template = vertices[chosen], templates[speaker]
        offsets = (frames - template.vertices).reshape(len(chosen), -1)
        drawn.append(_Drawn(speaker, *pack_vertices(template, frames), offsets))
    return drawn


def _lively(frames: Sequence[Float64], templates: Sequence[TriMesh]) -> Int64:
    """Vertices that move most from their template over all frames."""
    motion = np.max(
        [
            np.linalg.norm(moved - template.vertices, axis=-1).max(axis=0)
            for moved, template in zip(frames, templates, strict=True)
        ],
        axis=0,
    )
    count = max(int(_LIVELY_SHARE * len(motion)), 1)
    return np.argsort(motion)[-count:]


def write_mesh_bases(folder: Path, bases: MeshBases) -> None:
    """Write ``bases.npz``, ``offsets.npz`` and ``bases.csv`` into a folder."""
    write_bases(folder / "bases.npz", Bases(bases.stretch, bases.rotation, ()))
    # One basis in a file of two: the same format, the same reader.
    write_bases(folder / "offsets.npz", Bases(bases.offsets, bases.offsets.truncated(1), ()))
    with (folder / "bases.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, bases.table[0].keys(), lineterminator="\n")
        writer.writeheader()
        writer.writerows(bases.table)


def read_mesh_bases(folder: Path) -> MeshBases:
    """Read what `write_mesh_bases` wrote; the table is not kept.

    Raises
    ------
    DataError
        If a file is missing or something else.
    """
    try:
        gradients = read_bases(folder / "bases.npz")
        offsets = read_bases(folder / "offsets.npz").stretch
    except RigError as error:
        raise DataError(f"{folder}: {error}; build it again") from None
    return MeshBases(gradients.stretch, gradients.rotation, offsets)
