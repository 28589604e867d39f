"""Closing lids: their travel scaled to the opening of the target's eyes.

A blink carried from an eye that opens 11 mm to one that opens 8 mm would run the upper lid 3 mm
past the lower one. The local Jacobian does not resolve the slit between the lids.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from rig.arrays import Float64
from rig.mesh.trimesh import components
from rig.retarget.registration import Registration
from rig.retarget.transfer import local_jacobians

_REACH = 0.45
"""How far from the slit the scaling fades, in widths of the eye."""
_STEEPEST = 2.5
"""Largest change of travel, either way: beyond it the landmarks are wrong."""


def fit_lids(
    registration: Registration,
    source_landmarks: Mapping[str, int],
    target_landmarks: Mapping[str, int],
    deltas: Any,
) -> Float64:
    """Scale displacements across each eye's slit by the ratio of the eyes' openings.

    Parameters
    ----------
    registration : Registration
        Source over target.
    source_landmarks, target_landmarks : mapping of str to int
        An eye is fitted if both have its four points (outer, inner, upper, lower).
    deltas : array [shape=(K, V_target, 3)]
        Shapes as transferred.

    Returns
    -------
    fitted : array [shape=(K, V_target, 3)]
    """
    result = np.array(deltas, dtype=np.float64)
    jacobian = local_jacobians(registration)
    skin = np.flatnonzero(components(registration.target) == 0)
    rest, source = registration.target.vertices, registration.source.vertices
    for side in ("left", "right"):
        names = [f"eye_{corner}_{side}" for corner in ("outer", "inner", "upper", "lower")]
        if any(n not in source_landmarks or n not in target_landmarks for n in names):
            continue
        outer, inner, upper, lower = (rest[target_landmarks[n]] for n in names)
        theirs = [source_landmarks[n] for n in names[2:]]
        carried = (
            0.5
            * (jacobian[theirs[0]] + jacobian[theirs[1]])
            @ (source[theirs[0]] - source[theirs[1]])
        )
        opening = upper - lower
        height = float(np.linalg.norm(opening))
        if height == 0 or not np.linalg.norm(carried) > 0:
            continue
        ratio = np.clip(height / np.linalg.norm(carried), 1 / _STEEPEST, _STEEPEST)
        # 1 on the slit from corner to corner, falling off around it.
        points = rest[skin]
        width = float(np.linalg.norm(outer - inner))
        span = inner - outer
        along = np.clip((points - outer) @ span / (span @ span), 0.0, 1.0)
        distance = np.linalg.norm(points - outer - along[:, None] * span, axis=1)
        fade = np.asarray(
            np.exp(-((np.maximum(distance - 0.2 * width, 0.0) / (_REACH * width)) ** 2))
        )
        across = opening / height
        travel = result[:, skin] @ across
        result[:, skin] += ((ratio - 1.0) * fade * travel)[..., None] * across
    return result
