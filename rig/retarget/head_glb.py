"""The head as a GLB with ARKit's 52 shapes, for any viewer.

Viewers and face trackers use ARKit's names. Each shape is the board pose of that name in Unreal
(`rig.conversion.arkit`). What shapes alone cannot express (a jaw and lids turn, lips seal) comes
as correctives, whose drivers stand in ``mesh.extras.correctives``. For a take, with shapes of
all 185 controls, use ``deitalk convert take/curves.csv face.glb``.
"""

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from rig.arrays import Float32, Float64
from rig.controls import default_controls
from rig.conversion.arkit import apple_names, arkit_controls
from rig.conversion.convert import convert
from rig.curves import RigCurves
from rig.face import Head
from rig.mesh.glb import WeightAnimation, read_container, write_container, write_glb
from rig.mesh.shapes import ShapeSet
from rig.mesh.trimesh import TriMesh
from rig.retarget.correctives import ARKIT_HALVES, half_weight
from rig.retarget.morph_head import METRES_PER_CM, textured

SHAPES = apple_names()
"""ARKit's 52 blend shapes, by Apple's names."""
BASES = {"mouthClose": ("jawOpen", 1.0), "tongueOut": ("jawOpen", 0.4)}
"""Shapes that act on an open jaw only, as displacements from it."""
CORRECTIVES = {half: dict.fromkeys(drivers, 0.5) for half, drivers in ARKIT_HALVES.items()}
"""Pose in which each is fully on; `corrective_weights` fades them in and out."""


@lru_cache(maxsize=1)
def arkit_morphs(head: Head) -> ShapeSet:
    """Shapes of a head under ARKit's names, then the correctives, in cm."""
    rest = head.mesh.vertices
    deltas: dict[str, Float64] = {}
    for name in SHAPES:
        base = dict([BASES[name]]) if name in BASES else {}
        with_it = {**base, name: 1.0}
        deltas[name] = arkit_pose(head, with_it) - (arkit_pose(head, base) if base else rest)
    for name, pose in CORRECTIVES.items():
        weights = {**pose, **corrective_weights(pose)}
        shown = sum(weights[shape] * deltas[shape] for shape in weights if shape in deltas)
        deltas[name] = arkit_pose(head, pose) - rest - shown
    neutral = TriMesh(rest, head.mesh.faces)
    return ShapeSet(neutral, tuple(deltas), np.stack(list(deltas.values())))


def arkit_pose(head: Head, pose: dict[str, float]) -> Float64:
    """Vertices (V, 3) of the head itself, cm, for ARKit weights."""
    controls = arkit_controls()
    values = controls.rest.copy()
    for name, weight in pose.items():
        values[controls.index(name[0].upper() + name[1:])] = weight
    curves = RigCurves(values[None], controls.names, 30.0, control_set=controls.id)
    board = convert(curves, default_controls().id)
    return np.asarray(head.pose(board.values[0]), np.float64)


def corrective_weights(weights: Mapping[str, Any]) -> dict[str, Any]:
    """Weights of the correctives for weights of ARKit's shapes, numbers or one of each frame.

    A half is on at 0.5 and off at 0 and 1; ``mouthClose_half`` takes the lesser of its two.
    """
    return {
        half: half_weight([weights.get(name, 0.0) for name in drivers])
        for half, drivers in ARKIT_HALVES.items()
    }


def arkit_weights(curves: RigCurves) -> Float32:
    """Weights [shape=(T, 56)] of ARKit's 52 shapes, from 0 to 1, and of the correctives.

    Raises
    ------
    ControlError
        If the curves are not ARKit's.
    """
    values = curves.reorder(arkit_controls()).values[:, : len(SHAPES)].clip(0, 1)
    added = corrective_weights(dict(zip(SHAPES, values.T, strict=True)))
    return np.column_stack([values, *added.values()]).astype(np.float32)


def write_head(
    path: Path | str, head: Head, *, animation: WeightAnimation | None = None
) -> ShapeSet:
    """Write the head, y up, facing +z, in metres, its shapes as sparse morph targets.

    Parameters
    ----------
    path : Path or str
        The ``.glb``.
    head : Head
        Whose.
    animation : WeightAnimation, optional
        Of `arkit_weights`.

    Returns
    -------
    shapes : ShapeSet
        What was written.
    """
    shapes = arkit_morphs(head)
    colours, surface = textured(head)
    write_glb(
        path, shapes, animation=animation, colours=colours, surface=surface, metres=METRES_PER_CM
    )
    # Extras of the file: whose head it is, and the pose in which each corrective is fully on.
    document, binary = read_container(path)
    (mesh,) = document["meshes"]
    mesh["name"] = head.identity.name
    mesh["extras"]["correctives"] = {name: {"peak_at": pose} for name, pose in CORRECTIVES.items()}
    write_container(path, document, binary)
    return shapes
