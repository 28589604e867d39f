"""Linear bases of stretch and rotation over a head's motion (SDFA §3.4: the frozen last layers).

Letters: D numbers of a frame (6 N for s, 3 N for r).

Deviation: the paper takes PCA of the plain
numbers and keeps 97 % of their variance; rows here are weighted by the root of their triangle's
area, and the size is chosen by the error it leaves at the lips of held-out frames. 97 % of the
unweighted variance can be more than 2 mm there: thin triangles on rims rotate a lot.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deitalk.research.meshes.packing import pack_vertices
from rig.arrays import Float32, Float64
from rig.errors import FormatError, MeshError
from rig.files import atomic_write
from rig.mesh.deformation import DeformationSolver
from rig.mesh.trimesh import TriMesh, triangle_areas

VARIANCES = (0.9, 0.95, 0.97, 0.98, 0.99, 0.995, 0.998, 0.999, 0.9995, 0.9999)
"""Shares of weighted variance that `choose_bases` tries, in this order."""


@dataclass(frozen=True, eq=False)
class GradientBasis:
    """frame = mean + coefficients @ components; coefficients have unit variance in training.

    Parameters
    ----------
    mean : array [shape=(D,), float32]
    components : array [shape=(K, D), float16]
        In order of falling variance, each times its standard deviation.
    deviations : array [shape=(K,), float32]
        Weighted standard deviation along each component.
    weights : array [shape=(D,), float32]
        Root of each number's triangle area, over its mean.
    """

    mean: Float32
    components: NDArray[np.float16]
    deviations: Float32
    weights: Float32

    def project(self, frames: Any) -> Float64:
        """Coefficients [shape=(..., K)] of frames [shape=(..., D)]: weighted least squares."""
        weighted = (np.asarray(frames, dtype=np.float64) - self.mean) * self.weights
        directions = self.components.astype(np.float64) * self.weights
        return np.asarray(weighted @ directions.T / self.deviations.astype(np.float64) ** 2)

    def expand(self, coefficients: Any) -> Float64:
        """Frames [shape=(..., D)] of coefficients [shape=(..., K)]."""
        given = np.asarray(coefficients, dtype=np.float64)
        return np.asarray(self.mean + given @ self.components.astype(np.float64))

    def truncated(self, size: int) -> "GradientBasis":
        """The first `size` components."""
        return GradientBasis(
            self.mean, self.components[:size], self.deviations[:size], self.weights
        )

    def size_for(self, share: float) -> int:
        """Fewest components with at least this share of the variance all of them have."""
        power = np.cumsum(self.deviations.astype(np.float64) ** 2)
        return int(min(np.searchsorted(power, share * power[-1]) + 1, len(power)))


def fit_basis(frames: Any, areas: Any, *, most: int = 512) -> GradientBasis:
    """Principal components of frames, rows weighted by the root of the area.

    Parameters
    ----------
    frames : array [shape=(T, D)]
        Packed s (D = 6 N) or r (D = 3 N).
    areas : array [shape=(N,)]
        Of the template's triangles.
    most : int
        Most components kept; never more than T - 1.

    Raises
    ------
    MeshError
        If there are fewer than two frames, D is no multiple of N, or nothing moves.
    """
    data = np.asarray(frames, dtype=np.float64)
    areas = np.asarray(areas, dtype=np.float64)
    if data.ndim != 2 or len(data) < 2 or data.shape[1] % len(areas):
        raise MeshError(
            f"frames have shape {data.shape}; at least 2 rows of a multiple of {len(areas)} numbers"
        )
    weights = np.repeat(np.sqrt(areas / areas.mean()), data.shape[1] // len(areas))
    mean = data.mean(axis=0)
    weighted = (data - mean) * weights
    # T is far below D: eigenvectors of the small T x T matrix.
    power, left = np.linalg.eigh(weighted @ weighted.T)
    order = np.argsort(power)[::-1][: min(most, len(data) - 1)]
    kept = order[power[order] > 1e-12 * max(power.max(), 1e-30)]
    if len(kept) == 0 or power.max() <= 0:
        raise MeshError("the frames do not move; a basis needs motion")
    scores = np.sqrt(power[kept])
    directions = (left[:, kept] / scores).T @ weighted  # (K, D), orthonormal
    deviations = scores / np.sqrt(len(data) - 1)
    components = directions * deviations[:, None] / weights
    return GradientBasis(
        mean.astype(np.float32),
        components.astype(np.float16),
        deviations.astype(np.float32),
        weights.astype(np.float32),
    )


@dataclass(frozen=True, eq=False)
class Bases:
    """Bases of one head's stretch and rotation, and their errors at the lips.

    Parameters
    ----------
    stretch, rotation : GradientBasis
    table : tuple of dict
        For every size tried: `variance`, `stretch`, `rotation` (sizes), and over the held-out
        frames `mean`, `lips_p99`, `lips_max`, vertex errors in the mesh's unit.
    """

    stretch: GradientBasis
    rotation: GradientBasis
    table: tuple[dict[str, float], ...]


def choose_bases(
    template: TriMesh,
    training: Any,
    held_out: Any,
    lips: Any,
    *,
    bound: float,
) -> Bases:
    """Smallest bases that keep the lips of unseen frames within a bound.

    Parameters
    ----------
    template : TriMesh
        The expressionless head.
    training, held_out : array [shape=(T, V, 3)]
        Moved vertices, of different clips.
    lips : array of int
        Vertices of the lips.
    bound : float
        Largest 99th percentile of their error, in the mesh's unit (0.05 for 0.5 mm in cm).

    Returns
    -------
    Bases
        Of the first of `VARIANCES` within the bound, or of the last one tried.
    """
    areas = triangle_areas(template)
    train_s, train_r = pack_vertices(template, training)
    stretch, rotation = fit_basis(train_s, areas), fit_basis(train_r, areas)
    s, r = pack_vertices(template, held_out)
    solver = DeformationSolver(template)
    pins = np.asarray(held_out)[:, solver.pins]
    table: list[dict[str, float]] = []
    small_s, small_r = stretch, rotation
    for share in VARIANCES:
        small_s = stretch.truncated(stretch.size_for(share))
        small_r = rotation.truncated(rotation.size_for(share))
        solved = solver.solve(
            small_s.expand(small_s.project(s)),
            small_r.expand(small_r.project(r)),
            pin_positions=pins,
        )
        error = np.linalg.norm(solved - held_out, axis=-1)
        at_lips = error[:, np.asarray(lips)]
        row = {
            "variance": share,
            "stretch": len(small_s.deviations),
            "rotation": len(small_r.deviations),
            "mean": float(error.mean()),
            "lips_p99": float(np.percentile(at_lips, 99)),
            "lips_max": float(at_lips.max()),
        }
        table.append(row)
        if row["lips_p99"] <= bound:
            break
    return Bases(small_s, small_r, tuple(table))


def write_bases(path: Path | str, bases: Bases) -> None:
    """Write both bases as one NPZ: components in float16."""
    arrays = {}
    for name, basis in (("stretch", bases.stretch), ("rotation", bases.rotation)):
        for field in ("mean", "components", "deviations", "weights"):
            arrays[f"{name}_{field}"] = getattr(basis, field)
    with atomic_write(path) as beside, open(beside, "wb") as file:
        np.savez(file, **arrays)


def read_bases(path: Path | str) -> Bases:
    """Read a file of `write_bases`, which has no table.

    Raises
    ------
    FormatError
        If the file holds no bases.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            stretch, rotation = (
                GradientBasis(
                    *(file[f"{name}_{f}"] for f in ("mean", "components", "deviations", "weights"))
                )
                for name in ("stretch", "rotation")
            )
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise FormatError(f"{Path(path).name} holds no gradient bases: {error}") from None
    return Bases(stretch, rotation, ())
