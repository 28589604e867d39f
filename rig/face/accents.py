"""Accents of a posed head: depth of creases, and shadow of lids on eyes and of lips in the mouth.

One number a vertex and frame, -1..1. On skin it is the depth of the map of creases, in regions that
follow controls, or less than 0 the shadow in the mouth; on eyes, teeth and tongue it is shadow.
`deitalk/preview/web/src/face/accents.ts` is the same.
"""

import numpy as np

from rig.arrays import AnyFloat, Float32, Float64
from rig.face.head import Head
from rig.face.mesh import smoothstep

REGIONS = ("forehead", "temple", "glabella", "eye", "nasolabial")
LEAST = (0.02, 0.02, 0.015, 0.04, 0.10)
"""Depth of each region at rest, the same on both sides."""
SHADOW_RADIANS, SHADOW = 0.32, 0.82
"""How far below the upper lid its shadow reaches on the eye, and its depth at the rim."""
CORNER_BEGIN, CORNER = 0.45, 0.6
"""Where the shadow of an eye's corners begins, of the way to them, and its depth there."""

MOUTH_SHADOW, MOUTH_LIGHT = 0.87, (0.3, 0.46, 0.85, 1.2, 4.0, 0.5)
"""Deepest shadow in the mouth, and how light falls into it: its rise from the teeth to the lip over
the way; how far it passes below the upper lip where all of it does, and how much higher none does;
how far behind the lip it begins to fade, and over what way it goes, cm; share of this that counts
from the lip at the same x, not from its front, which corners lie far behind."""
LIPS = (0.0, 0.45)
"""How far behind the upper lip at the same x the shadow on skin begins, and over what way it is
whole, cm."""


def crease_inputs(head: Head) -> list[int]:
    """Places of the regions' inputs among `Motion.inputs`, left ones first."""
    return [head.motion.inputs.index(f"crease.{name}_{s}") for s in "LR" for name in REGIONS]


def accents(head: Head, values: AnyFloat, poses: AnyFloat) -> Float32:
    """Accents [shape=(T, V)] of control values [shape=(T, 185)] and their poses [shape=(T, V, 3)].

    The poses are those of `Head.pose`, before the head is turned.
    """
    found = np.zeros(poses.shape[:2], np.float32)
    inputs = head.motion.halves(np.asarray(values, np.float64)) @ head.motion.bind
    depth = np.clip(inputs[:, crease_inputs(head)] + np.tile(LEAST, 2), 0, 1).astype(np.float32)
    skin = np.minimum(depth @ head.creases, 1)
    if len(head.mouth):
        lip = head.lip_columns(poses)[0]
        inside = head.teeth
        found[:, inside] = _mouth(lip, poses[:, inside])[0]
        shadow, behind = _mouth(lip, poses[:, head.mouth])
        skin[:, head.mouth] = -shadow * smoothstep((behind - LIPS[0]) / LIPS[1])
    found[:, head.slices["skin"]] = skin
    seam = head.slices["seam"]
    found[:, seam] = skin[:, head.mesh.weld[seam]]
    for k, side in enumerate("LR"):
        if not len(head.lid_rims[k]):
            continue
        # Shadow [shape=(T, V of an eye)] by how far a vertex lies below the rim of the upper lid,
        # and how near to a corner of the eye.
        center = head.eyes[k, :3]
        lid = poses[:, head.lid_rims[k]] - center
        ball = poses[:, head.slices[f"eye_{side}"]] - center
        high, angle = (np.arctan2(p[..., 1], p[..., 2]) for p in (lid, ball))
        edge = np.stack(
            [np.interp(b, a, h) for b, a, h in zip(ball[..., 0], lid[..., 0], high, strict=True)]
        )
        shadow = SHADOW * smoothstep(1 - (edge - angle) / SHADOW_RADIANS)
        inner, outer = lid[:, :1, 0], lid[:, -1:, 0]
        aside = np.abs(2 * ball[..., 0] - inner - outer) / (outer - inner)
        shadow += (1 - shadow) * CORNER * smoothstep((aside - CORNER_BEGIN) / (1 - CORNER_BEGIN))
        found[:, head.slices[f"eye_{side}"]] = np.asarray(shadow * (ball[..., 2] > 0), np.float32)
    return found


def _mouth(lip: AnyFloat, inside: AnyFloat) -> tuple[Float64, Float64]:
    """Shadow (T, n) of points (T, n, 3) in the mouth; how far they are behind the upper lip, cm.

    The lip (T, P, 3) gives its front for the shadow, its place at the same x for the other.
    """
    rise, clear, soft, begin, fade, beside = MOUTH_LIGHT
    x, y, z = np.moveaxis(inside, -1, 0)
    edge, rim = (
        np.stack([np.interp(a, c[:, 0], c[:, k]) for a, c in zip(x, lip, strict=True)])
        for k in (1, 2)
    )
    front = lip[..., 2].max(1, keepdims=True)
    depth = front + beside * (rim - front) - z
    under = (clear - (edge - y - rise * depth)) / soft
    return MOUTH_SHADOW * smoothstep(np.maximum(under, (depth - begin) / fade)), rim - z
