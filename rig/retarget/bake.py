"""Bake a rig into linear morph targets and their drivers.

A shape is driven by a product of control halves, so that nonlinear effects of a rig (a jaw that
turns, lips that seal over it) become correctives: the vertices of the rig in a pose, less those of
the shapes before it.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from rig.arrays import Float32, Float64
from rig.controls import ControlSet
from rig.curves import RigCurves
from rig.mesh.shapes import Moved, ShapeSet, SparseShapes, moved_of
from rig.mesh.trimesh import TriMesh

AnyShapes = TypeVar("AnyShapes", ShapeSet, SparseShapes)
Evaluate = Callable[[Float64], Iterable[Moved]]
"""Control values [shape=(T, C)] to what each pose moves from rest."""

BATCH = 16
"""Poses at once: little memory that is used again."""
STILL = 1e-4
"""A shape that moves no vertex by this share of the mesh's size is not kept."""


@dataclass(frozen=True)
class Half:
    """One half of a control's travel, from rest (0) to an end of its range (1).

    Parameters
    ----------
    control : str
    sign : int
        1 towards the maximum, -1 towards the minimum.
    """

    control: str
    sign: int = 1

    def amount(self, values: NDArray[Any], controls: ControlSet) -> Float64:
        """Position between them [shape=(T,), range 0 to 1], of control values [shape=(T, C)]."""
        i = controls.index(self.control)
        rest = float(controls.rest[i])
        end = float(controls.maximum[i] if self.sign > 0 else controls.minimum[i])
        if end == rest:
            return np.zeros(len(values))
        return np.clip((np.asarray(values[:, i], dtype=np.float64) - rest) / (end - rest), 0.0, 1.0)


@dataclass(frozen=True)
class Driver:
    """Weight of one shape: the product over groups of the least amount in each.

    Parameters
    ----------
    groups : tuple of tuple of Half
        ``((jaw,), (upper, lower))`` is jaw x min(upper, lower).
    peak : float or None [0 to 1]
        For an in-between: the weight is 1 where the product is `peak`, 0 at 0 and at 1.
    """

    groups: tuple[tuple[Half, ...], ...]
    peak: float | None = None

    def weight(self, values: NDArray[Any], controls: ControlSet) -> Float64:
        """Weight over time [shape=(T,), range 0 to 1]."""
        product = np.ones(len(values))
        for group in self.groups:
            product *= np.min([half.amount(values, controls) for half in group], axis=0)
        if self.peak is None:
            return product
        return np.asarray(np.interp(product, [0.0, self.peak, 1.0], [0.0, 1.0, 0.0]))

    def pose(self, controls: ControlSet) -> Float32:
        """Control values [shape=(C,)] at which the weight is 1."""
        values = controls.rest.copy()
        for group in self.groups:
            for half in group:
                i = controls.index(half.control)
                end = controls.maximum[i] if half.sign > 0 else controls.minimum[i]
                share = 1.0 if self.peak is None else self.peak ** (1.0 / len(self.groups))
                values[i] = controls.rest[i] + share * (end - controls.rest[i])
        return values


@dataclass(frozen=True, eq=False)
class BakedRig(Generic[AnyShapes]):
    """Morph targets with their drivers.

    Parameters
    ----------
    shapes : ShapeSet or SparseShapes
    drivers : tuple of Driver
        One for each shape.
    controls : ControlSet
        Control set of the drivers' names.
    """

    shapes: AnyShapes
    drivers: tuple[Driver, ...]
    controls: ControlSet

    def weights(self, curves: RigCurves) -> Float32:
        """Weights of the shapes over time [shape=(T, K), range 0 to 1]."""
        values = curves.reorder(self.controls).values
        return self.weights_of(values)

    def weights_of(self, values: NDArray[Any]) -> Float32:
        """Weights as those of `weights`, of bare control values [shape=(T, C)]."""
        weights = np.zeros((len(values), len(self.drivers)), dtype=np.float32)
        for k, driver in enumerate(self.drivers):
            weights[:, k] = driver.weight(values, self.controls)
        return weights

    def dense(self: "BakedRig[SparseShapes]") -> "BakedRig[ShapeSet]":
        """The same rig with a displacement of every vertex in each shape."""
        return BakedRig(self.shapes.dense(), self.drivers, self.controls)

    def on(self, neutral: TriMesh, deltas: Any) -> "BakedRig[ShapeSet]":
        """The same drivers over other shapes: `deltas` [shape=(K, V, 3)] of another mesh."""
        shapes = ShapeSet(neutral, self.shapes.names, deltas)
        return BakedRig(shapes, self.drivers, self.controls)

    def moving(self: "BakedRig[ShapeSet]") -> "BakedRig[ShapeSet]":
        """The rig without shapes that hardly move."""
        least = STILL * self.shapes.neutral.size
        moves = np.linalg.norm(self.shapes.deltas, axis=-1).max(axis=1, initial=0.0) > least
        kept = np.flatnonzero(moves)
        shapes = replace(
            self.shapes,
            names=tuple(self.shapes.names[k] for k in kept),
            deltas=self.shapes.deltas[kept],
        )
        return replace(self, shapes=shapes, drivers=tuple(self.drivers[k] for k in kept))


def bake(
    neutral: TriMesh,
    evaluate: Evaluate,
    controls: ControlSet,
    *,
    correctives: Sequence[tuple[str, Driver]] = (),
) -> BakedRig[SparseShapes]:
    """Evaluate a rig at the end of every half, then at its correctives.

    Parameters
    ----------
    neutral : TriMesh
        The rig's mesh at rest.
    evaluate : callable
        Control values [shape=(T, C)] to what each pose moves.
    controls : ControlSet
        Columns of those values.
    correctives : sequence of (str, Driver)
        Named shapes to add, in this order: each is the remaining difference in its pose.

    Returns
    -------
    BakedRig
        Shapes that move nothing are left out.
    """
    halves = control_halves(controls)
    wanted = [*halves, *correctives]
    poses = np.stack([driver.pose(controls) for _, driver in wanted]).astype(np.float64)
    amounts = [driver.weight(poses, controls) for _, driver in wanted]
    kept: dict[int, Moved] = {}
    least = (STILL * neutral.size) ** 2
    for k, moved in enumerate(evaluate(poses)):
        if k >= len(halves):
            delta = np.zeros(neutral.vertices.shape, np.float32)
            delta[moved[0]] = moved[1]
            for vertices, displacement, weight in ((*kept[j], amounts[j][k]) for j in kept):
                if weight:
                    delta[vertices] -= np.float32(weight) * displacement
            moved = moved_of(delta)
        if np.einsum("vc,vc->v", moved[1], moved[1]).max(initial=0.0) > least:
            kept[k] = moved
    shapes = SparseShapes(neutral, tuple(wanted[k][0] for k in kept), tuple(kept.values()))
    return BakedRig(shapes, tuple(wanted[k][1] for k in kept), controls)


def moves_of(pose: Callable[[Float64], Any], rest: Any) -> Evaluate:
    """Return an `Evaluate` of a rig's vertices [shape=(T, V, 3)] in poses and at rest."""
    still = np.asarray(rest, np.float32)

    def evaluate(values: Float64) -> Iterator[Moved]:
        for start in range(0, len(values), BATCH):
            for posed in np.asarray(pose(values[start : start + BATCH]), np.float32):
                yield moved_of(posed - still)

    return evaluate


def control_halves(controls: ControlSet) -> list[tuple[str, Driver]]:
    """A driver for each half of each control's range, named after it."""
    halves = []
    for name, low, rest, high in zip(
        controls.names, controls.minimum, controls.rest, controls.maximum, strict=True
    ):
        if high > rest:
            halves.append((name, Driver(((Half(name, 1),),))))
        if low < rest:
            halves.append((f"{name}_negative", Driver(((Half(name, -1),),))))
    return halves


def face_correctives() -> list[tuple[str, Driver]]:
    """Correctives of a MetaHuman-board face baked to morph targets.

    The jaw turns rather than slides and lids go round the eyeball: an in-between half way each.
    Lips together close over an open jaw: each side, then both.
    """
    jaw = Half("CTRL_C_jaw.ty")
    found = [("jaw_half", Driver(((jaw,),), peak=0.5))]
    for side in "LR":
        blink = Half(f"CTRL_{side}_eye_blink.ty")
        found.append((f"blink_half_{side}", Driver(((blink,),), peak=0.5)))
    lips = {
        side: tuple(Half(f"CTRL_{side}_mouth_lipsTogether{row}.ty") for row in "UD")
        for side in "LR"
    }
    for side in "LR":
        found.append((f"seal_{side}", Driver(((jaw,), lips[side]))))
    found.append(("seal", Driver(((jaw,), lips["L"] + lips["R"]))))
    return found
