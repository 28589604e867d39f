"""Face landmarks of a video by MediaPipe's face mesh (the extra ``video``).

The wheels of MediaPipe up to 0.10.21, for Python 3.11 and 3.12, bring the model; later ones do not.
"""

import os
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from deitalk.errors import MissingError
from deitalk.research.video.landmarks import N_POINTS, USED, FaceTrack, pixels
from deitalk.research.video.pictures import read_pictures
from rig.arrays import Float32
from rig.face.render.picture import Picture

MOST_FACES = 4
LARGER = 1.3
"""Size over the followed face's from which on another face takes its place."""
_STDERR = 2
_PYTHONS = "with Python 3.11 or 3.12 (this is {}.{})".format(*sys.version_info)
_OTHERWISE = "or import a file of its landmarks (docs/finetuning.md#a-video)"

Progress = Callable[[float], None]


def track_face(path: Path, progress: Progress = lambda share: None) -> FaceTrack:
    """Landmarks of the largest face of a video.

    Parameters
    ----------
    path : Path
        A video.
    progress : callable
        Given the share done.

    Returns
    -------
    FaceTrack
        At the times of the pictures, at most 30 a second.

    Raises
    ------
    MissingError
        Without MediaPipe, or with a version that brings no model.
    DataError
        If the video cannot be read.
    """
    mesh = _face_mesh()
    points: list[Float32] = []
    times: list[float] = []
    several = 0
    held: Float32 | None = None
    try:
        for seconds, picture, share in read_pictures(path):
            faces = _faces(mesh, picture)
            held = _chosen(faces, held)
            several += len(faces) > 1
            points.append(np.full((len(USED), 3), np.nan, np.float32) if held is None else held)
            times.append(seconds)
            progress(share)
    finally:
        mesh.close()
    return FaceTrack(np.stack(points), np.array(times), _notes(points, several))


def _face_mesh() -> Any:
    """MediaPipe's face mesh with irises."""
    os.environ.setdefault("GLOG_minloglevel", "2")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import mediapipe
    except ImportError as error:
        raise MissingError(
            f"a video needs MediaPipe ({error}); pip install 'deitalk[video]' {_PYTHONS}, "
            f"{_OTHERWISE}"
        ) from None
    solutions = getattr(mediapipe, "solutions", None)
    if solutions is None:
        raise MissingError(
            f"MediaPipe {mediapipe.__version__} brings no model of faces; pip install "
            f"'mediapipe<0.10.22' {_PYTHONS}, {_OTHERWISE}"
        )
    with _without_native_logs():
        mesh = solutions.face_mesh.FaceMesh(max_num_faces=MOST_FACES, refine_landmarks=True)
        mesh.process(np.zeros((64, 64, 3), np.uint8))  # its threads log until the first result
    return mesh


@contextmanager
def _without_native_logs() -> Iterator[None]:
    """Drop what native code writes to the process's standard error, lines about its delegates."""
    if sys.stderr is not None:
        sys.stderr.flush()
    try:
        kept = os.dup(_STDERR)
    except OSError:  # a program without a standard error
        yield
        return
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), _STDERR)
    try:
        yield
    finally:
        os.dup2(kept, _STDERR)
        os.close(kept)


def _faces(mesh: Any, picture: Picture) -> list[Float32]:
    """Points (P, 3) in pixels of every face in a picture."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = mesh.process(picture).multi_face_landmarks or []
    size = (picture.shape[1], picture.shape[0])
    return [
        pixels([(point.x, point.y, point.z) for point in face.landmark[: N_POINTS[0]]], size)
        for face in found
    ]


def _chosen(faces: list[Float32], held: Float32 | None) -> Float32 | None:
    """The largest face; the one nearest to the face before, unless another is much larger."""
    if not faces:
        return None
    # Largest side of the points in the picture, pixels.
    sizes = [float(np.ptp(face[:, :2], axis=0).max()) for face in faces]
    largest = int(np.argmax(sizes))
    if held is None:
        return faces[largest]
    away = [float(np.linalg.norm(face.mean(axis=0)[:2] - held.mean(axis=0)[:2])) for face in faces]
    nearest = int(np.argmin(away))
    return faces[largest if sizes[largest] > LARGER * sizes[nearest] else nearest]


def _notes(points: list[Float32], several: int) -> tuple[str, ...]:
    if not several:
        return ()
    return (f"several faces in {several / len(points):.0%} of the frames, the largest is taken",)
