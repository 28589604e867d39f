"""Bake a rig into linear morph targets and their drivers.

A shape is driven by a product of control halves, so that nonlinear effects of a rig (a jaw that
turns, lips that seal over it) become correctives: the vertices of the rig in a pose, less those of
the shapes before it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.arrays import Float32, Float64
from rig.controls import ControlSet
from rig.curves import RigCurves
from rig.mesh.shapes import ShapeSet
from rig.mesh.trimesh import TriMesh

Evaluate = Callable[[Float32], Any]
"""Control values [shape=(T, C)] to vertices [shape=(T, V, 3)]."""

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
class BakedRig:
    """Morph targets with their drivers.

    Parameters
    ----------
    shapes : ShapeSet
    drivers : tuple of Driver
        One for each shape.
    controls : ControlSet
        Control set of the drivers' names.
    """

    shapes: ShapeSet
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

    def on(self, neutral: TriMesh, deltas: Any) -> "BakedRig":
        """The same drivers over other shapes: `deltas` [shape=(K, V, 3)] of another mesh."""
        return replace(self, shapes=ShapeSet(neutral, self.shapes.names, deltas))

    def moving(self) -> "BakedRig":
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
) -> BakedRig:
    """Evaluate a rig at the end of every half, then at its correctives.

    Parameters
    ----------
    neutral : TriMesh
        The rig's mesh at rest.
    evaluate : callable
        Control values [shape=(T, C)] to vertices [shape=(T, V, 3)].
    controls : ControlSet
        Columns of those values.
    correctives : sequence of (str, Driver)
        Named shapes to add, in this order: each is the remaining difference in its pose.

    Returns
    -------
    BakedRig
        Shapes that move nothing are left out.
    """
    wanted = [*control_halves(controls), *correctives]
    names, drivers = [name for name, _ in wanted], [driver for _, driver in wanted]
    poses = np.stack([driver.pose(controls) for driver in drivers])
    rest = np.asarray(evaluate(controls.rest[None]), dtype=np.float32)[0]
    deltas = np.empty((len(poses), *rest.shape), np.float32)
    kept: list[int] = []
    least, first = STILL * neutral.size, len(drivers) - len(correctives)
    amounts = [driver.weight(poses[first:], controls) for driver in drivers]
    for k in range(len(drivers)):
        if k % BATCH == 0:
            posed = np.asarray(evaluate(poses[k : k + BATCH]), dtype=np.float32)
        delta = np.subtract(posed[k % BATCH], rest, deltas[len(kept)])
        for place, j in enumerate(kept if k >= first else ()):
            if weight := float(amounts[j][k - first]):
                delta -= weight * deltas[place]
        farthest = max(delta.max(), -delta.min())  # along an axis, without a new array
        if farthest > least or np.linalg.norm(delta, axis=1).max() > least:
            kept.append(k)
    deltas = deltas[: len(kept)]
    deltas.setflags(write=False)  # not copied again
    shapes = ShapeSet(neutral.with_vertices(rest), tuple(names[k] for k in kept), deltas)
    return BakedRig(shapes, tuple(drivers[k] for k in kept), controls)


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
