"""Correctives of our own exports, recognised by name and driven as the exporters drive them.

``deitalk face export`` writes ARKit's shapes and halves of some (`ARKIT_HALVES`). ``deitalk
convert`` to a GLB writes a shape for each half of a board control, named after it, and the
correctives of `rig.retarget.bake.face_correctives`; each has a `Driver`.
"""

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np

from rig.arrays import AnyFloat, Float64
from rig.controls import DEFAULT_ID, default_controls
from rig.conversion.convert import convert
from rig.conversion.raw import RAW_ID, raw_controls
from rig.curves import RigCurves
from rig.retarget.bake import Driver, control_halves, face_correctives

ARKIT_HALVES: Mapping[str, tuple[str, ...]] = {
    "jawOpen_half": ("jawOpen",),
    "eyeBlinkLeft_half": ("eyeBlinkLeft",),
    "eyeBlinkRight_half": ("eyeBlinkRight",),
    "mouthClose_half": ("jawOpen", "mouthClose"),
}
"""Shapes whose least weight drives each half."""


def half_weight(weights: Sequence[AnyFloat | float]) -> Float64:
    """Weight of a half [shape=(T,), range 0 to 1]: 1 where the least weight is 0.5, 0 at 0 and 1.

    Parameters
    ----------
    weights : sequence of array [shape=(T,), range 0 to 1]
        Of the shapes that drive it; numbers, too.
    """
    least = np.min(np.asarray(weights, np.float64), axis=0)
    return np.asarray(np.maximum(1 - np.abs(2 * least - 1), 0.0))


def arkit_halves(names: Sequence[str]) -> dict[int, tuple[int, ...]]:
    """Columns of the halves among shape names, and the columns that drive each."""
    place = {name: k for k, name in enumerate(names)}
    return {
        place[half]: tuple(place[name] for name in drivers)
        for half, drivers in ARKIT_HALVES.items()
        if half in place and all(name in place for name in drivers)
    }


def own_drivers(names: Sequence[str]) -> dict[int, Driver]:
    """Drivers by column, if the names are of our own export of the board's shapes; else none.

    The board's names alone are ambiguous: other rigs use them too, and get fitted weights.
    """
    drivers, telling = _drivers()
    if not telling & set(names):
        return {}
    return {k: drivers[name] for k, name in enumerate(names) if name in drivers}


def driver_poses(drivers: Mapping[int, Driver], n_shapes: int) -> Float64:
    """Change of the raw curves at weight 1 [shape=(K, 251)]; zero for correctives."""
    board, rest = default_controls(), raw_controls().rest
    poses = np.zeros((n_shapes, len(raw_controls())))
    halves = {k: d for k, d in drivers.items() if len(d.groups) == 1 and d.peak is None}
    if halves:
        values = np.stack([driver.pose(board) for driver in halves.values()])
        curves = RigCurves(values, board.names, control_set=board.id)
        raw = convert(curves, RAW_ID).reorder(raw_controls())
        poses[list(halves)] = raw.values.astype(np.float64) - rest
    return poses


def driver_weights(drivers: Mapping[int, Driver], curves: RigCurves) -> dict[int, Float64]:
    """Weights by column [each shape=(T,), range 0 to 1] of board, raw or ARKit curves."""
    board = default_controls()
    values = convert(curves, DEFAULT_ID).reorder(board).values
    return {k: driver.weight(values, board) for k, driver in drivers.items()}


@cache
def _drivers() -> tuple[dict[str, Driver], frozenset[str]]:
    """Drivers of all names of our exporter, and the names that only it uses."""
    halves, correctives = dict(control_halves(default_controls())), dict(face_correctives())
    telling = {name for name in halves if name.endswith("_negative")} | set(correctives)
    return halves | correctives, frozenset(telling)
