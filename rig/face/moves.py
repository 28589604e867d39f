"""What poses of a head move: few vertices each, found without those that stay."""

import numpy as np

from rig.arrays import Float32, Float64, Int64
from rig.controls import default_controls
from rig.face.head import FEW, STEPS, Head, gaze_degrees


def moves(head: Head, values: Float64) -> list[tuple[Int64, Float32]]:
    """Vertices (n,), ascending, that each of T poses moves, and displacements (n, 3) from rest, cm.

    The same as `Head.pose` of the values (T, 185), without steps of it that would move nothing.
    """
    motion, rest = head.motion, head.neutral.astype(np.float32)
    halves = motion.halves(values)
    shown, reach = motion.weights(halves) != 0, _reach(head)
    degrees, still = (
        np.stack(gaze_degrees(v, head.convergence))
        for v in (values, default_controls().rest[None].astype(np.float64))
    )
    asked = {
        "lips": np.concatenate(head.sealed(halves), axis=1).any(axis=1),
        "eyes": (degrees != still).any(axis=(0, 2)),
    }
    alike: dict[tuple[str, ...], list[int]] = {}
    moved = np.zeros((len(values), len(rest)), bool)
    for t, is_moved in enumerate(moved):
        for k in np.flatnonzero(shown[t]):
            is_moved[motion.vertex[motion.starts[k] : motion.starts[k + 1]]] = True
        taken = []
        for step in STEPS:
            reads, writes = reach[step]
            does_move = is_moved[reads].any(axis=1) | (step in asked and asked[step][t])
            if does_move.any():
                is_moved[writes] |= does_move
                taken.append(step)
        alike.setdefault(tuple(taken), []).append(t)
    found: dict[int, tuple[Int64, Float32]] = {}
    out = np.empty((FEW, *rest.shape), np.float32)
    for steps, frames in alike.items():
        for start in range(0, len(frames), FEW):
            few = frames[start : start + FEW]
            head.pose_into(values[few], out[: len(few)], steps)
            for t, pose in zip(few, out, strict=False):
                ids = np.flatnonzero(moved[t])
                found[t] = ids, np.take(pose, ids, axis=0) - np.take(rest, ids, axis=0)
    return [found[t] for t in range(len(values))]


def _reach(head: Head) -> dict[str, tuple[Int64, Int64]]:
    """Vertices (m or 1, n) any of which moves where (m,) vertices do, of each of `STEPS`."""
    lips = np.concatenate([lip.reach for lip in head.motion.lips])
    rims = np.concatenate([lip.rim for lip in head.motion.lips])
    index = np.arange(len(head.straight))
    eyes = np.concatenate([index[head.slices[f"eye_{s}"]] for s in "LR"])
    return {
        **{f"lid_{s}": (ids[None], ids) for s, ids in zip("LR", head.lids, strict=True)},
        "lips": (np.concatenate([lips, rims])[None], lips),
        "follow": (head.near, head.follow),
        "eyes": (eyes[None], eyes),
        "seam": (head.seam[:, None], index[head.slices["seam"]]),
    }
