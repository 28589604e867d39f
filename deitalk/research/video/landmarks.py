"""Landmarks of a face over time: MediaPipe's mesh of 478 points, from a video or from a file.

A file of landmarks is an NPZ archive::

    landmarks   [shape=(n, 478 or 468, 3)], as MediaPipe returns them: x to the right in widths of
                the picture, y down in its heights, z away from the camera in widths; NaN in frames
                without a face
    size        width and height of the upright picture, pixels
    times       [shape=(n,)], seconds of the sound; or fps, frames per second

Letters: n frames as taken, T frames at 30 per second, P points.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from deitalk.audio.frames import FRAME_RATE
from deitalk.errors import DataError
from rig import limits
from rig.arrays import Bool, Float32, Float64
from rig.files.reading import read_npz

N_POINTS = (478, 468)
"""With irises and without."""
LEAST_RATE = 12.0
"""Frames per second from which on lips can be followed."""
FACE_PIXELS = (1e-3, 1e6)
"""Least width and height of a face, and how far a point of it may be from the picture's origin."""
GAP_SECONDS = 0.1
"""Time without a face that is bridged; of slower videos two and a half frames."""
LEAST_SECONDS = 0.5

BROWS = {
    "L": {"in": (336, 285), "mid": (334, 282), "out": (300, 276)},
    "R": {"in": (107, 55), "mid": (105, 52), "out": (70, 46)},
}
"""Upper and lower edge of a brow at three places; L is the person's left."""
LIDS = {
    "L": {"upper": (386, 385, 387), "lower": (374, 380, 373), "corners": (263, 362)},
    "R": {"upper": (159, 158, 160), "lower": (145, 153, 144), "corners": (33, 133)},
}
"""Middle of the lids, and outer and inner corner."""
IRIS = {"L": 473, "R": 468}
CORNERS = {"L": 291, "R": 61}
RIMS = {
    "upper": {"L": (312, 311), "R": (82, 81)},
    "lower": {"L": (317, 402), "R": (87, 178)},
}
"""Inner edge of the lips, up to half of the way from the middle to the corner."""
MIDDLE = {"upper": 13, "lower": 14, "upper_edge": 0, "lower_edge": 17, "chin": 152, "nose": 2}
RIGID = (
    6, 168, 197, 195, 5, 4,
    33, 133, 98, 127, 54, 21,
    263, 362, 327, 356, 284, 251,
)  # fmt: skip
"""Points that move with the skull: of the middle, of the person's right, of the left. The forehead
is not among them, since it rises with the brows."""
RIGID_MIRROR = (*RIGID[:6], *RIGID[12:], *RIGID[6:12])
"""The same points on the other side."""


def _numbers(tree: Any) -> list[int]:
    """All point numbers of nested tables."""
    if isinstance(tree, int):
        return [tree]
    parts = tree.values() if isinstance(tree, dict) else tree
    return [number for part in parts for number in _numbers(part)]


USED = tuple(sorted(set(_numbers((BROWS, LIDS, IRIS, CORNERS, RIMS, MIDDLE, RIGID)))))
"""Points that are kept of the mesh."""
PLACE = {number: place for place, number in enumerate(USED)}
_FACE = [place for number, place in PLACE.items() if number not in IRIS.values()]
"""All points but those of the irises, which not every detector finds."""


@dataclass(frozen=True, eq=False)
class FaceTrack:
    """Points of one face over time.

    Parameters
    ----------
    points : array [shape=(n, P, 3)], pixels
        Of `USED`: x right, y down, z away from the camera; NaN in frames without a face.
    times : array [shape=(n,)]
        Seconds of the sound, rising.
    notes : tuple of str
        What a user should know of the measurement.
    """

    points: Float32
    times: Float64
    notes: tuple[str, ...] = ()

    @property
    def rate(self) -> float:
        """Frames per second, of the median step."""
        return float(1 / np.median(np.diff(self.times))) if len(self.times) > 1 else 0.0

    def at(self, *numbers: int) -> Float32:
        """Mean of some points by their numbers in the mesh [shape=(n, 3)]."""
        chosen: Float32 = self.points[:, [PLACE[number] for number in numbers]].mean(axis=1)
        return chosen


def pixels(mesh: ArrayLike, size: ArrayLike) -> Float32:
    """Points of `USED` in pixels [shape=(..., P, 3)] of a mesh as MediaPipe returns it."""
    values = np.asarray(mesh, np.float64)
    if values.shape[-2] <= max(USED):
        missing = np.full((*values.shape[:-2], max(USED) + 1 - values.shape[-2], 3), np.nan)
        values = np.concatenate([values, missing], axis=-2)
    width, height = np.asarray(size, np.float64)
    return np.asarray(values[..., list(USED), :] * [width, height, width], np.float32)


def read_landmarks(path: Path) -> FaceTrack:
    """Read a file of landmarks.

    Parameters
    ----------
    path : Path
        As described above.

    Raises
    ------
    DataError
        If an array is missing or has another shape, or the times do not rise.
    """
    data = read_npz(path, limit=limits.MESH_BYTES, error=DataError)
    mesh, size = data.get("landmarks"), data.get("size")
    if mesh is None or mesh.ndim != 3 or mesh.shape[1:] not in [(n, 3) for n in N_POINTS]:
        shape = "" if mesh is None else f", not {mesh.shape}"
        raise DataError(f"{path}: needs landmarks of shape (frames, 478 or 468, 3){shape}")
    if mesh.dtype.kind != "f":
        raise DataError(f"{path}: landmarks must be floating-point numbers, not {mesh.dtype}")
    if size is None or size.shape != (2,) or not (np.asarray(size, np.float64) > 0).all():
        raise DataError(f"{path}: needs size, width and height of the picture in pixels")
    points = pixels(mesh, size)
    points[~_has_face(points[:, _FACE])] = np.nan
    return FaceTrack(points, _times(path, data, len(mesh)))


def _has_face(points: Float32) -> Bool:
    """Frames whose points (n, P, 3) are finite and spread as a face's [shape=(n,)]."""
    near = np.where(np.abs(points) <= FACE_PIXELS[1], points, np.nan)  # NaN stays
    return np.asarray((np.ptp(near[..., :2], axis=1) >= FACE_PIXELS[0]).all(axis=1))


def _times(path: Path, data: dict[str, Any], n_frames: int) -> Float64:
    times, fps = data.get("times"), data.get("fps")
    if times is None and fps is not None and np.size(fps) == 1 and fps.dtype.kind in "fiu":
        rate = float(np.ravel(fps)[0])
        if limits.FPS_LOWEST <= rate <= limits.FPS_HIGHEST:
            return np.arange(n_frames) / rate
    if times is None or times.shape != (n_frames,) or times.dtype.kind not in "fiu":
        raise DataError(f"{path}: needs times in seconds, one a frame, or fps")
    seconds: Float64 = times.astype(np.float64)
    if not np.isfinite(seconds).all() or not (np.diff(seconds) > 0).all():
        raise DataError(f"{path}: times must rise from frame to frame")
    return seconds


def at_rig_frames(track: FaceTrack, where: str) -> tuple[FaceTrack, Bool]:
    """Points at 30 frames per second from the first moment of the sound.

    Parameters
    ----------
    track : FaceTrack
        As taken, at any rate.
    where : str
        Name of the video, for messages.

    Returns
    -------
    track : FaceTrack
        T frames; points of frames without a face are those of the nearest ones.
    seen : array of bool [shape=(T,)]
        False where no face is within `GAP_SECONDS` on both sides.

    Raises
    ------
    DataError
        If the face is in no or few frames, or the rate is too low.
    """
    seen: Bool = np.asarray(np.isfinite(track.points[:, _FACE]).all(axis=(1, 2)))
    times = track.times[seen]
    if track.rate < LEAST_RATE:
        raise DataError(
            f"{where}: {track.rate:.3g} frames per second; lips need {LEAST_RATE:g}, better 30"
        )
    if len(times) < LEAST_SECONDS * track.rate:
        raise DataError(
            f"{where}: a face is in {len(times)} of {len(seen)} frames; show it in full"
        )
    if track.times[-1] > limits.SECONDS:
        raise DataError(f"{where}: lasts {track.times[-1]:.0f} s; at most {limits.SECONDS:.0f}")
    gap = max(GAP_SECONDS, 2.5 / track.rate)
    grid = np.arange(int(track.times[-1] * FRAME_RATE + 1e-6) + 1) / FRAME_RATE
    points = track.points[seen].reshape(len(times), -1)
    even = np.stack([np.interp(grid, times, column) for column in points.T], axis=1)
    after = np.searchsorted(times, grid - 1e-9)
    before = np.searchsorted(times, grid + 1e-9) - 1
    ends = np.concatenate([times, [np.inf]])[after], np.concatenate([times, [-np.inf]])[before]
    is_seen = (ends[0] - ends[1] <= gap + 1e-6) | (np.abs(grid - times[-1]) <= 0.5 / FRAME_RATE)
    is_seen |= np.abs(grid - times[0]) <= 1 / FRAME_RATE
    return (
        FaceTrack(even.reshape(len(grid), -1, 3).astype(np.float32), grid, track.notes),
        is_seen,
    )
