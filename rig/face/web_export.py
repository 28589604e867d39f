"""The head as plain arrays and numbers, for a player in another language (the preview page).

Everything `Head.pose` uses is here; ``deitalk/preview/web/src/face/rig.ts`` evaluates it, and a
test compares the two.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.arrays import Float32
from rig.controls import default_controls
from rig.face import accents
from rig.face.geometry import details
from rig.face.geometry.topology import EYE_L, EYE_R
from rig.face.head import CONVERGENCE_DEGREES, GAZE_DEGREES, Head
from rig.face.motion import rigid
from rig.face.motion.bindings import bindings

Arrays = dict[str, NDArray[Any]]
SMALLEST_CM = 5e-4
"""Displacements below this are left out of the shapes."""
MAP_QUALITY = 82


def head_arrays(head: Head) -> tuple[Arrays, dict[str, Any]]:
    """Arrays by name, and the numbers and names that go with them.

    Returns
    -------
    arrays : dict of str to ndarray
        Integers as uint16, displacements as int16 with one scale a shape, the rest float32.
    facts : dict
        JSON-ready: slices, input names, anatomy, constants of jaw, lids and teeth.
    """
    arrays = _mesh_arrays(head) | _shape_arrays(head) | _binding_arrays()
    parts = (
        _lid_arrays, _seal_arrays, _arch_arrays, _tongue_arrays, _follow_arrays, _accent_arrays,
    )  # fmt: skip
    for part in parts:
        arrays |= part(head)
    arrays["jaw.weight"] = _real(head.jaw.skin_weights)
    arrays["eye.rest"], arrays["eye.pupil"] = _real(head._eye_rest), _real(head._pupil)
    return arrays, _facts(head)


def _real(values: NDArray[Any]) -> Float32:
    return np.ascontiguousarray(values, np.float32)


def _index(values: NDArray[Any]) -> NDArray[np.uint16]:
    assert np.max(values, initial=0) < 65536
    return np.ascontiguousarray(values, np.uint16)


def _mesh_arrays(head: Head) -> Arrays:
    mesh = head.mesh
    light = np.c_[mesh.light, mesh.kind / 4]
    return {
        "vertices": _real(mesh.vertices),
        "faces": _index(mesh.faces),
        "paint": _byte(np.c_[mesh.colors, mesh.gloss]),
        "light": _byte(light),
        "place": _index(np.round(np.clip(mesh.uv, 0, 1) * 65535)),
        **{f"maps.{name}": _webp(picture) for name, picture in vars(mesh.maps).items()},
    }


def _byte(values: NDArray[Any]) -> NDArray[np.uint8]:
    return np.ascontiguousarray(np.round(np.clip(values, 0, 1) * 255), np.uint8)


def _webp(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Bytes of a WebP file of a picture (h, w, 2 to 4)."""
    from io import BytesIO

    from PIL import Image

    if picture.shape[2] == 2:
        picture = np.concatenate([picture, picture[..., :1]], 2)
    file = BytesIO()
    Image.fromarray(picture).save(file, "WEBP", quality=MAP_QUALITY, method=4)
    return np.frombuffer(file.getvalue(), np.uint8)


def _shape_arrays(head: Head) -> Arrays:
    """Linear shapes, sparse: for shape k entries start[k]:start[k + 1]."""
    shapes = head._shapes.reshape(len(head._names), -1, 3)
    start, vertex, delta, scale = [0], [], [], []
    for shape in shapes:
        used = np.flatnonzero(np.abs(shape).max(1) > SMALLEST_CM)
        step = max(float(np.abs(shape).max()), 1e-6) / 32767
        start.append(start[-1] + len(used))
        vertex.append(head._moving[used])
        delta.append(np.round(shape[used] / step).astype(np.int16))
        scale.append(step)
    return {
        "shape.start": np.array(start, np.uint32),
        "shape.vertex": _index(np.concatenate(vertex)),
        "shape.delta": np.concatenate(delta),
        "shape.scale": np.array(scale, np.float32),
    }


def _binding_arrays() -> Arrays:
    matrix = bindings()._matrix
    row, column = np.nonzero(matrix)
    return {
        "bind.control": _index(row),
        "bind.input": _index(column),
        "bind.gain": _real(matrix[row, column]),
    }


def _lid_arrays(head: Head) -> Arrays:
    arrays: Arrays = {}
    for name, eye in head._lids._eyes.items():
        arrays |= {
            f"lid.{name}.ids": _index(eye.ids),
            f"lid.{name}.slot": _index(eye.slot),
            f"lid.{name}.share": _real(eye.share),
            f"lid.{name}.rim": _index(eye.rim),
            f"lid.{name}.upper": _real(eye.upper),
            f"lid.{name}.arch": _real(eye.arch),
        }
    return arrays


def _seal_arrays(head: Head) -> Arrays:
    seal = head._seal
    return {
        "seal.upper": _index(seal._upper),
        "seal.lower": _index(seal._lower),
        "seal.share": _real(seal._share[:, 0]),
        "seal.u": _real(seal._u),
        "seal.left": _real(seal._sides["L"]),
    }


def _arch_arrays(head: Head) -> Arrays:
    arrays: Arrays = {}
    for name, arch in head._arches.items():
        arrays |= {
            f"arch.{name}.ids": _index(arch.ids),
            f"arch.{name}.least": _real(arch._least),
            f"arch.{name}.a": _real(arch._axes[0]),
            f"arch.{name}.b": _real(arch._axes[1]),
        }
    return arrays


def _tongue_arrays(head: Head) -> Arrays:
    rigid = head._tongue
    return {
        "tongue.rest": _real(rigid._rest),
        "tongue.place": _real(rigid._s),
        "tongue.axis": _real(rigid._axis),
        "tongue.across": _real(rigid._across),
        "tongue.jaw": _real(rigid.jaw_share),
    }


def _follow_arrays(head: Head) -> Arrays:
    arrays: Arrays = {}
    for side, kind in (("L", EYE_L), ("R", EYE_R)):
        ride = head._brows[side]
        arrays[f"brow.{side}.near"] = _index(ride.near)
        arrays[f"brow.{side}.weight"] = _real(ride.weight)
        root = head._lash_root[side]
        slot = {int(v): k for k, v in enumerate(head.features.loop(kind, 0))}
        arrays[f"lash.{side}.root"] = _index(root)
        arrays[f"lash.{side}.slot"] = _index(np.array([slot[int(v)] for v in root]))
        arrays[f"lash.{side}.along"] = _real(head._lash_along[side])
    return arrays


def _accent_arrays(head: Head) -> Arrays:
    arrays: Arrays = {"accent.mask": _byte(accents.masks(head))}
    for side, kind in (("L", EYE_L), ("R", EYE_R)):
        arrays[f"accent.rim.{side}"] = _index(accents.upper_rim(head, kind))
    return arrays


def _facts(head: Head) -> dict[str, Any]:
    place = head.features.anatomy
    controls, gains = default_controls(), accents.gains()
    return {
        "identity": head.identity.name,
        "slices": {name: [s.start, s.stop] for name, s in head.slices.items()},
        "controls": list(controls.names),
        "minimum": [float(x) for x in controls.minimum],
        "maximum": [float(x) for x in controls.maximum],
        "rest": [float(x) for x in controls.rest],
        "regions": [control.region for control in controls.controls],
        "inputs": list(bindings().inputs),
        "shapes": list(head._names),
        "eye": [float(x) for x in place.eye],
        "eyeRadius": float(place.eye_radius),
        "mouthY": float(place.mouth_y),
        "lipZ": float(head._lip_z),
        "rimMiddle": [int(k) for k in head._rim_middle],
        "sealRim": int(head._seal._rim),
        "hinge": [float(x) for x in rigid.HINGE],
        "openDegrees": rigid.OPEN_DEGREES,
        "slide": [rigid._SLIDE_OPEN, rigid._SIDE, rigid._FORWARD],
        "lidLeast": float(head._lids._least),
        "lidMeet": rigid._MEET,
        "tongueSink": rigid.SINK_CM,
        "gaze": [GAZE_DEGREES["side"], GAZE_DEGREES["up"], GAZE_DEGREES["down"]],
        "accents": {
            "least": accents.least().tolist(),
            "gains": [[int(c), int(r), float(gains[c, r])] for c, r in np.argwhere(gains)],
            "shadow": accents.SHADOW,
            "shadowRadians": accents.SHADOW_RADIANS,
        },
        "convergence": CONVERGENCE_DEGREES,
        "teeth": {
            "upperEdge": details.UPPER_EDGE,
            "lowerEdge": details.LOWER_EDGE,
            "upperBack": details.UPPER_BACK,
            "lowerBack": details.LOWER_BACK,
        },
        "archCenter": {name: float(arch._center_z) for name, arch in head._arches.items()},
        "archEdge": {name: float(arch._edge_y) for name, arch in head._arches.items()},
    }
