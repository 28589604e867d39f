"""The head as plain arrays and numbers, for the preview page.

All numbers of `Head.pose` are here; ``deitalk/preview/web/src/face/rig.ts`` applies them, and a
test compares the two.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.arrays import Float32
from rig.controls import default_controls
from rig.face import accents
from rig.face.head import ALONG, FINISH, GAZE_DEGREES, UPPER_PART, Head, Motion
from rig.face.head_file import GRID

Arrays = dict[str, NDArray[Any]]


def head_arrays(head: Head) -> tuple[Arrays, dict[str, Any]]:
    """Arrays by name, and the numbers and names that go with them.

    Returns
    -------
    arrays : dict of str to ndarray
        Integers as uint16, displacements as int16 of one step, the rest float32.
    facts : dict
        JSON-ready: slices, controls, constants of seal and eyes.
    """
    return _mesh_arrays(head) | _motion_arrays(head.motion) | _follow_arrays(head), _facts(head)


def _real(values: Any) -> Float32:
    return np.ascontiguousarray(values, np.float32)


def _index(values: Any) -> NDArray[np.uint16]:
    assert np.max(values, initial=0) < 65536
    return np.ascontiguousarray(values, np.uint16)


def _byte(values: Any) -> NDArray[np.uint8]:
    return np.ascontiguousarray(np.round(np.clip(values, 0, 1) * 255), np.uint8)


def _mesh_arrays(head: Head) -> Arrays:
    mesh = head.mesh
    return {
        "points": np.round(head.straight * GRID).astype(np.int16),
        "faces": _index(mesh.faces),
        "weld": _index(mesh.weld),
        "paint": _byte(np.c_[mesh.colors, mesh.gloss]),
        "light": _byte(np.c_[mesh.light, mesh.kind / 5]),
        "place": _index(np.round(mesh.uv * 65535)),
        **{f"maps.{name}": np.frombuffer(data, np.uint8) for name, data in head.pictures.items()},
    }


def _motion_arrays(motion: Motion) -> Arrays:
    arrays: Arrays = {
        "shape.start": motion.starts.astype(np.uint32),
        "shape.vertex": _index(motion.vertex),
        "shape.delta": motion.delta,
        "shape.driver": _index(motion.drivers),
        "shape.peak": motion.is_peak.astype(np.uint8),
        "shape.gain": _real(motion.gain * motion.step),
        "bind": _real(motion.bind),
        "seal.fade": _real(motion.fade),
    }
    for k, (lip, profile) in enumerate(zip(motion.lips, motion.profiles, strict=True)):
        arrays |= {
            f"lip{k}.rim": _index(lip.rim), f"lip{k}.weight": _real(lip.weight),
            f"lip{k}.reach": _index(lip.reach), f"lip{k}.column": _real(lip.column),
            f"lip{k}.share": _real(lip.share), f"lip{k}.profile": _real(profile),
        }  # fmt: skip
    return arrays


def _follow_arrays(head: Head) -> Arrays:
    arrays: Arrays = {
        "follow.vertex": _index(head.follow),
        "follow.near": _index(head.near),
        "follow.weight": _real(head.near_weight),
        "creases": _byte(head.creases),
        "mouth": _index(head.mouth),
    }
    for k in range(2):
        arrays[f"lid{k}.ids"] = _index(head.lids[k])
        arrays[f"lid{k}.least"] = _real(head.lid_least[k])
        arrays[f"lid{k}.rim"] = _index(head.lid_rims[k])
    return arrays


def _facts(head: Head) -> dict[str, Any]:
    controls = default_controls()
    return {
        "identity": head.identity.name,
        "slices": {name: [s.start, s.stop] for name, s in head.slices.items()},
        "controls": list(controls.names),
        "minimum": [float(x) for x in controls.minimum],
        "maximum": [float(x) for x in controls.maximum],
        "rest": [float(x) for x in controls.rest],
        "regions": [control.region for control in controls.controls],
        "grid": GRID,
        "eyes": head.eyes.tolist(),
        "gaze": [GAZE_DEGREES["side"], GAZE_DEGREES["up"], GAZE_DEGREES["down"]],
        "convergence": head.convergence,
        "seal": {
            "parts": [UPPER_PART, 1 - UPPER_PART],
            "along": ALONG.tolist(),
            "finish": FINISH,
        },
        "accents": {
            "inputs": accents.crease_inputs(head),
            "least": list(accents.LEAST) * 2,
            "shadow": accents.SHADOW,
            "shadowRadians": accents.SHADOW_RADIANS,
            "corner": [accents.CORNER_BEGIN, accents.CORNER],
            "teeth": [head.teeth.start, head.teeth.stop],
            "mouthShadow": accents.MOUTH_SHADOW,
            "mouthLight": accents.MOUTH_LIGHT,
            "lips": accents.LIPS,
        },
    }
