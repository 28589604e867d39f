"""Landmarks of the embedded head as MediaPipe would measure them, for tests without a detector."""

from pathlib import Path

import numpy as np

from deitalk.research.video.landmarks import (
    BROWS,
    CORNERS,
    IRIS,
    LIDS,
    MIDDLE,
    N_POINTS,
    RIGID,
    RIGID_MIRROR,
    RIMS,
)
from rig.face.head import Head
from rig.face.head_pose import neck_share, turned

SIZE = (720, 1280)
PIXELS_PER_CM = 40.0
SIDES = {"L": "left", "R": "right"}


def filmed_mesh(head: Head, values: np.ndarray, track: np.ndarray | None = None) -> np.ndarray:
    """A mesh [shape=(T, 478, 3)] as MediaPipe returns it; points that are not used are 0.5."""
    poses = head.pose(values).astype(np.float64)
    if track is not None:
        poses = turned(poses, track, neck_share(head.mesh.vertices))
    mesh = np.full((len(poses), N_POINTS[0], 3), 0.5)
    center = np.array([SIZE[0] / 2, SIZE[1] / 2, 0])
    for number, vertices in _vertices(head).items():
        place = poses[:, vertices].mean(axis=1) * [1, -1, -1] * PIXELS_PER_CM + center
        mesh[:, number] = place / [SIZE[0], SIZE[1], SIZE[0]]
    return mesh


def write_mesh(path: Path, mesh: np.ndarray, fps: float) -> Path:
    """Write a file of landmarks in single precision."""
    np.savez(path, landmarks=mesh.astype(np.float32), size=np.array(SIZE), fps=fps)
    return path


def _vertices(head: Head) -> dict[int, list[int]]:
    """Vertices of the joined mesh whose mean is a point."""
    marks, skin = head.landmarks, head.skin.vertices
    found = {}
    for side, word in SIDES.items():
        for lid in ("upper", "lower"):
            found |= {number: [marks[f"eye_{lid}_{word}"]] for number in LIDS[side][lid]}
        for corner, kind in zip(LIDS[side]["corners"], ("outer", "inner"), strict=True):
            found[corner] = [marks[f"eye_{kind}_{word}"]]
        eye = head.slices[f"eye_{side}"]
        found[IRIS[side]] = [eye.start + int(np.argmax(head.mesh.vertices[eye][:, 2]))]
        brow = np.abs(head.mesh.vertices[head.slices[f"brow_{side}"]][:, 0])
        for place, share in (("in", 0.12), ("mid", 0.5), ("out", 0.85)):
            wanted = brow.min() + share * np.ptp(brow)
            near = np.flatnonzero(np.abs(brow - wanted) < 0.08 * np.ptp(brow))
            start = head.slices[f"brow_{side}"].start
            found |= {number: [start + int(k) for k in near] for number in BROWS[side][place]}
        found[CORNERS[side]] = [marks[f"mouth_corner_{word}"]]
    found |= _rims(head)
    names = {"upper_edge": "upper_lip_top", "lower_edge": "lower_lip_bottom"}
    names |= {"chin": "chin", "nose": "nose_base"}
    found |= {MIDDLE[key]: [marks[name]] for key, name in names.items()}
    for number, (x, y) in _rigid().items():
        if number not in found:
            front = np.where(skin[:, 2] > 0, np.hypot(skin[:, 0] - x, skin[:, 1] - y), np.inf)
            found[number] = [int(np.argmin(front))]
    return found


def _rims(head: Head) -> dict[int, list[int]]:
    found = {}
    for name, lip in zip(("upper", "lower"), head.motion.lips, strict=True):

        def at(share: float, lip=lip) -> list[int]:
            column = round((0.5 + 0.5 * share) * (len(lip.weight) - 1))
            return [int(v) for v in lip.rim[lip.weight[column] > 0]]

        found[MIDDLE[name]] = at(0)
        for side, sign in (("L", 1), ("R", -1)):
            for number, share in zip(RIMS[name][side], (0.25, 0.48), strict=True):
                found[number] = at(sign * share)
    return found


def _rigid() -> dict[int, tuple[float, float]]:
    """Places of the rigid points on the front of the head, cm."""
    middle = {
        n: (0, y) for n, y in zip(RIGID[:6], (-0.1, 0.1, -0.5, -1.5, -2.5, -3.5), strict=True)
    }
    sides = {98: (-1.0, -5.0), 127: (-6.5, 0.5), 54: (-6.8, 3.5), 21: (-6.9, 2.0)}
    mirror = dict(zip(RIGID, RIGID_MIRROR, strict=True))
    return middle | sides | {mirror[n]: (-x, y) for n, (x, y) in sides.items()}
