"""The head as a GLB with ARKit's 52 shapes, for any viewer.

ARKit's names are the ones that viewers and face trackers know. Each shape is the board pose that
Unreal gives that name (`rig.arkit`). What shapes alone cannot say (a jaw and lids turn, lips seal)
comes as correctives, whose drivers stand in ``mesh.extras.correctives``. For a take, with shapes
of all 185 controls, use ``deitalk convert take/curves.csv face.glb``.

Letters: K shapes, V vertices.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig import RigCurves, default_controls
from rig.arkit import arkit_controls
from rig.face.head import Head
from rig.face.mesh import Array
from rig.mapping import convert
from rig.mesh.glb import GlbBuilder, write_container
from rig.mesh.trimesh import TriMesh, vertex_normals

SHAPES = tuple(name[0].lower() + name[1:] for name in arkit_controls().names[:52])
"""ARKit's 52 blend shapes, by Apple's names."""
BASES = {"mouthClose": ("jawOpen", 1.0), "tongueOut": ("jawOpen", 0.4)}
"""Shapes that mean something over an open jaw only: what they add to it."""
CORRECTIVES: dict[str, dict[str, float]] = {
    "jawOpen_half": {"jawOpen": 0.5},
    "eyeBlinkLeft_half": {"eyeBlinkLeft": 0.5},
    "eyeBlinkRight_half": {"eyeBlinkRight": 0.5},
    "mouthClose_half": {"jawOpen": 0.5, "mouthClose": 0.5},
}
"""Pose in which each is fully on; `corrective_weights` fades them in and out."""
STILL_METRES = 1e-5
STILL_NORMAL = 2e-3
_ARRAY_BUFFER, _INDEX_BUFFER = 34962, 34963


@dataclass(frozen=True)
class Morphs:
    """A head's linear shapes.

    Attributes
    ----------
    names : tuple of str
        ARKit's 52, then the correctives.
    deltas : ndarray [shape=(K, V, 3)], cm
    """

    names: tuple[str, ...]
    deltas: NDArray[np.float32]


def arkit_morphs(head: Head) -> Morphs:
    """Shapes of a head under ARKit's names, and correctives."""
    rest = head.mesh.vertices
    deltas: dict[str, Array] = {}
    for name in SHAPES:
        base = dict([BASES[name]]) if name in BASES else {}
        with_it = {**base, name: 1.0}
        deltas[name] = arkit_pose(head, with_it) - (arkit_pose(head, base) if base else rest)
    for name, pose in CORRECTIVES.items():
        shown = rest + _added(deltas, {**pose, **corrective_weights(pose)})
        deltas[name] = arkit_pose(head, pose) - shown
    return Morphs(tuple(deltas), np.stack(list(deltas.values())).astype(np.float32))


def _added(deltas: dict[str, Array], weights: dict[str, float]) -> Array:
    return np.asarray(sum(weights[name] * deltas[name] for name in weights if name in deltas))


def arkit_pose(head: Head, pose: dict[str, float]) -> Array:
    """Vertices (V, 3) of the head itself, cm, for ARKit weights."""
    controls = arkit_controls()
    values = controls.rest.copy()
    for name, weight in pose.items():
        values[controls.index(name[0].upper() + name[1:])] = weight
    curves = RigCurves(values[None], controls.names, 30.0, control_set=controls.id)
    board = convert(curves, default_controls().id)
    return np.asarray(head.pose(board.values[0]), np.float64)


def corrective_weights(weights: dict[str, float]) -> dict[str, float]:
    """Weights of the correctives for weights of ARKit's shapes.

    A half is on at 0.5 and off at 0 and 1; ``mouthClose_half`` takes the weight of mouthClose.
    """
    get = {name: weights.get(name, 0.0) for name in ("jawOpen", "mouthClose")}
    halves = {name.removesuffix("_half"): weights.get(name.removesuffix("_half"), 0.0)
              for name in CORRECTIVES}  # fmt: skip
    halves["mouthClose"] = min(get["jawOpen"], get["mouthClose"])
    return {f"{name}_half": max(1 - abs(2 * weight - 1), 0.0) for name, weight in halves.items()}


def write_head(path: Path | str, head: Head) -> Morphs:
    """Write the head, y up, facing +z, in metres, its shapes as sparse morph targets.

    Parameters
    ----------
    path : Path or str
        The ``.glb``.
    head : Head
        Whose.

    Returns
    -------
    morphs : Morphs
        What was written.
    """
    from rig.formats.morph_head import METRES_PER_CM, srgb_to_linear

    morphs = arkit_morphs(head)
    rest = TriMesh(head.mesh.vertices * METRES_PER_CM, head.mesh.faces)
    builder = GlbBuilder()
    deltas = morphs.deltas.astype(np.float64) * METRES_PER_CM
    primitive: dict[str, Any] = {
        "attributes": {
            "POSITION": builder.dense(rest.vertices, "VEC3", _ARRAY_BUFFER),
            "NORMAL": builder.dense(vertex_normals(rest), "VEC3", _ARRAY_BUFFER),
            "COLOR_0": builder.dense(srgb_to_linear(head.mesh.colors), "VEC3", _ARRAY_BUFFER),
        },
        "indices": builder.dense(rest.faces.astype(np.uint32).ravel(), "SCALAR", _INDEX_BUFFER),
        "material": 0,
        "targets": [_target(builder, rest, delta) for delta in deltas],
    }
    builder.json |= _scene(primitive, head.identity.name, morphs.names)
    write_container(path, builder.json, bytes(builder.binary))
    return morphs


def _target(builder: GlbBuilder, rest: TriMesh, delta: Array) -> dict[str, int]:
    turned = vertex_normals(TriMesh(rest.vertices + delta, rest.faces)) - vertex_normals(rest)
    return {
        "POSITION": builder.sparse(delta, STILL_METRES),
        "NORMAL": builder.sparse(turned, STILL_NORMAL),
    }


def _scene(primitive: dict[str, Any], title: str, names: tuple[str, ...]) -> dict[str, Any]:
    surface = {"baseColorFactor": [1.0] * 4, "metallicFactor": 0.0, "roughnessFactor": 0.6}
    extras = {
        "targetNames": list(names),
        "correctives": {name: {"peak_at": pose} for name, pose in CORRECTIVES.items()},
    }
    mesh = {
        "name": title, "primitives": [primitive], "weights": [0.0] * len(names), "extras": extras,
    }  # fmt: skip
    return {
        "asset": {"version": "2.0", "generator": "deitalk"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": title}],
        "meshes": [mesh],
        "materials": [{"name": "face", "pbrMetallicRoughness": surface, "doubleSided": True}],
    }
