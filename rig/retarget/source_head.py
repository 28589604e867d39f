"""The embedded head as a source of shapes: its mesh, landmarks and baked rig."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from rig.arrays import Float32, Float64, Int64
from rig.controls import default_controls
from rig.face import Head, build_head
from rig.face.geometry.topology import EYE_L, EYE_R, MOUTH, NOSTRIL_L, NOSTRIL_R
from rig.mesh.trimesh import TriMesh
from rig.retarget.bake import BakedRig, bake, face_correctives

PARTS = ("skin", "eye_L", "eye_R", "teeth_upper", "teeth_lower", "tongue")
"""Parts that are carried to another head, without brows, lashes, ears and hair."""


@dataclass(frozen=True, eq=False)
class SourceHead:
    """A rigged head to take shapes from.

    Parameters
    ----------
    mesh : TriMesh
        `PARTS` of the embedded head, neutral, in cm; the skin is the first and largest part.
    landmarks : dict of str to int
        All 26 of `rig.retarget.landmarks.LANDMARKS`.
    rig : BakedRig
        Its shapes for the 185 controls.
    """

    mesh: TriMesh
    landmarks: dict[str, int]
    rig: BakedRig


@lru_cache(maxsize=2)
def source_head(identity: int = 0) -> SourceHead:
    """Build the embedded head of an identity and bake its rig."""
    head = build_head(identity)
    kept = np.concatenate([np.arange(len(head.mesh.vertices))[head.slices[p]] for p in PARTS])
    new_index = np.full(len(head.mesh.vertices), -1, dtype=np.int64)
    new_index[kept] = np.arange(len(kept))
    faces = new_index[head.mesh.faces]
    mesh = TriMesh(head.mesh.vertices[kept], faces[(faces >= 0).all(axis=1)])
    controls = default_controls()

    def evaluate(values: Float32) -> Float32:
        return np.asarray(head.pose(values)[:, kept])

    rig = bake(mesh, evaluate, controls, correctives=face_correctives())
    return SourceHead(rig.shapes.neutral, head_landmarks(head), rig)


def head_landmarks(head: Head) -> dict[str, int]:
    """Vertices of the 26 landmarks on the skin of an embedded head.

    Mouth and eyes are known by their loops, which start at the subject's left (an eye's at its
    outer corner) and run over the top; the others are extremes of the profile.
    """
    skin = head.features
    rim, red = skin.loop(MOUTH, 0), skin.loop(MOUTH, 3)
    quarter = len(rim) // 4
    share = skin.vertices[rim[:quarter], 0] / skin.vertices[rim[0], 0]
    half = int(np.argmin(np.abs(share - 0.5)))
    found = {
        "mouth_corner_left": rim[0],
        "mouth_corner_right": rim[2 * quarter],
        "upper_rim": rim[quarter],
        "lower_rim": rim[3 * quarter],
        "upper_rim_left": rim[half],
        "upper_rim_right": rim[2 * quarter - half],
        "lower_rim_left": rim[-half],
        "lower_rim_right": rim[2 * quarter + half],
        "upper_lip_top": red[quarter],
        "lower_lip_bottom": red[3 * quarter],
    }
    for side, kind in (("left", EYE_L), ("right", EYE_R)):
        lid = skin.loop(kind, 0)
        step = len(lid) // 4
        names = ("outer", "upper", "inner", "lower")
        found |= {f"eye_{name}_{side}": lid[i * step] for i, name in enumerate(names)}
    return {name: int(v) for name, v in (found | _profile(skin.vertices, found, head)).items()}


def _profile(points: Float64, known: dict[str, Int64], head: Head) -> dict[str, int]:
    """Nose, chin and brows, by extremes of the skin."""
    skin = head.features
    inside = (skin.kind == MOUTH) & (skin.ring < 0)
    middle = np.flatnonzero((np.abs(points[:, 0]) < 1e-6) & (points[:, 2] > 0) & ~inside)
    y, z = points[middle, 1], points[middle, 2]
    lip, mouth = points[known["upper_lip_top"]], points[known["lower_lip_bottom"]]
    eye = points[known["eye_inner_left"]]

    tip = middle[np.argmax(np.where((y > lip[1]) & (y < eye[1]), z, -np.inf))]
    base = _deepest(middle, points, points[tip], lip)
    brow_line = points[middle[np.argmin(np.abs(y - (eye[1] + 3.0)))]]
    bridge = _deepest(middle, points, brow_line, points[tip])
    below = (y < mouth[1] - 0.5) & (y > mouth[1] - 6.0)
    chin = middle[np.argmax(np.where(below, z - y, -np.inf))]
    found = {"nose_tip": tip, "nose_base": base, "nose_bridge": bridge, "chin": chin}
    for side, kind, sign in (("left", NOSTRIL_L, 1), ("right", NOSTRIL_R, -1)):
        ring = skin.loop(kind, 2)
        # As far out as the wing goes, at the height of the nose's base.
        out = np.abs(points[ring, 0]).max()
        corner = np.array([sign * out, points[base, 1] + 0.1, points[base, 2] - 0.4])
        away = np.where(inside, np.inf, np.linalg.norm(points - corner, axis=1))
        found[f"nose_wing_{side}"] = np.argmin(away)
        brow = head.parts[f"brow_{side[0].upper()}"].vertices.mean(axis=0)
        found[f"brow_{side}"] = np.argmin(np.linalg.norm(points - brow, axis=1))
    return {name: int(v) for name, v in found.items()}


def _deepest(middle: Int64, points: Float64, above: Float64, below: Float64) -> int:
    """Midline vertex furthest behind the straight line from one point of the profile to another."""
    y, z = points[middle, 1], points[middle, 2]
    share = (y - below[1]) / (above[1] - below[1])
    line = below[2] + share * (above[2] - below[2])
    depth = np.where((share > 0) & (share < 1), line - z, -np.inf)
    return int(middle[np.argmax(depth)])
