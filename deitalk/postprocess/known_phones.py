"""Closures after the network: phones whose times are known, and gaps that are nearly closed.

A network leaves an uncertain /b/ half closed. Where the words are known the lips meet within it,
the lower lip meets the teeth within an f or a v, and the lips are rounded within a rounded sound;
elsewhere nothing is added. Letters: T frames at 30 per second, C controls.
"""

from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.errors import ConfigError
from deitalk.postprocess.phones import BILABIALS, LABIODENTALS
from rig.arrays import Bool, Float32, Int64
from rig.face import build_head
from rig.face.head import UPPER_PART, Lip
from rig.mesh import TriMesh

ROUNDED = {
    "UW": (0.35, 0.9), "W": (0.3, 1.0), "OW": (0.5, 0.6), "UH": (0.35, 0.4), "AO": (0.55, 0.15),
    "SH": (0.85, 0.1), "ZH": (0.8, 0.1), "CH": (0.8, 0.1), "JH": (0.75, 0.1),
}  # fmt: skip
"""Funnel and purse of rounded phones, from the tables of the training corpus."""
ROUNDED_SHARE = 0.6
"""Of that rounding, which is met at least: quick speech rounds less."""
FUNNEL, PURSE = 0.75, 0.79
"""Values of the controls for a full funnel and purse."""
LEAST_FRAMES = 2
"""Frames of the shortest contact."""
ROUNDING_STEP = 0.2
"""Largest step of the rounding in a frame, as share of its height."""


class KnownPhone(NamedTuple):
    """A phone and its time in the sound."""

    start: float
    """Seconds."""
    end: float
    name: str
    """A member of `deitalk.postprocess.phones.PHONES`."""
    is_known: bool = True
    """Whether the sound does not contradict it."""


def phone_tracks(phones: Sequence[KnownPhone], n_frames: int) -> Float32:
    """What phones require of each frame [shape=(T, 4)]; 0 where there are none.

    1 where they close the lips, 1 where the lower lip meets the teeth, the least funnel and the
    least purse; `deitalk.postprocess.curve_stages.MeetPhones` applies them.
    """
    tracks = np.zeros((n_frames, 4), np.float32)
    tracks[:, 0] = phone_frames(phones, BILABIALS, n_frames)
    tracks[:, 1] = phone_frames(phones, LABIODENTALS, n_frames) & (tracks[:, 0] == 0)
    tracks[:, 2:] = _least_rounding(phones, n_frames)
    return tracks


def phone_frames(phones: Sequence[KnownPhone], names: frozenset[str], n_frames: int) -> Bool:
    """Frames within phones of some names, at least `LEAST_FRAMES` of each [shape=(T,)]."""
    frames = np.zeros(n_frames, bool)
    for phone in phones:
        if phone.name in names:
            first, stop = _frames(phone)
            frames[max(first, 0) : stop] = True
    return frames


def _frames(phone: KnownPhone) -> tuple[int, int]:
    """First frame of a phone and the one after its last; the nearest ones of a short phone."""
    first, stop = (int(np.ceil(time * FRAME_RATE - 1e-6)) for time in phone[:2])
    if stop - first < LEAST_FRAMES:
        middle = (phone.start + phone.end) / 2 * FRAME_RATE
        first = round(middle - (LEAST_FRAMES - 1) / 2)
        stop = first + LEAST_FRAMES
    return first, stop


def _least_rounding(phones: Sequence[KnownPhone], n_frames: int) -> Float32:
    """Least funnel and purse within rounded phones, with slopes around them [shape=(T, 2)]."""
    floors = np.zeros((n_frames, 2), np.float32)
    for phone in phones:
        if phone.name in ROUNDED:
            first, stop = _frames(phone)
            least = ROUNDED_SHARE * np.array(ROUNDED[phone.name]) * (FUNNEL, PURSE)
            rows = floors[max(first, 0) : stop]
            np.maximum(rows, least, out=rows)
    out = floors.copy()
    for frames in range(1, round(1 / ROUNDING_STEP)):
        lower = floors * (1 - frames * ROUNDING_STEP)
        out[frames:] = np.maximum(out[frames:], lower[:-frames])
        out[:-frames] = np.maximum(out[:-frames], lower[frames:])
    return out


# Seal of the lips of known skins: gaps that are nearly closed are closed, after the network.
#
# Deviation: not in the paper, whose lips are used as the solve gives them. A bilabial missed by a
# millimetre looks missed; the embedded heads' own motion ends in the same operator
# (`rig.face.head.seal_lips`).


class KnownSkin(NamedTuple):
    """A skin whose lips are known."""

    faces: Int64
    """[shape=(N, 3)]."""
    n_vertices: int
    lips: tuple[Lip, Lip]
    """Upper and lower."""
    landmarks: dict[str, int]


@cache
def known_skins() -> tuple[KnownSkin, KnownSkin]:
    """The embedded heads' cage, and the skin of the heads that the shipped mesh models learned."""
    head = build_head(0)
    count = head.slices["cage"].stop
    upper, lower = (lip.within(count) for lip in head.motion.lips)
    with np.load(Path(__file__).with_name("former_skin.npz")) as stored:
        former = {name: stored[name] for name in stored.files}
    n_loops, n_pairs = former["upper"].shape
    column = np.tile(np.arange(n_pairs, dtype=np.float32), n_loops)
    share = np.repeat(former["shares"], n_pairs)
    lips = [
        Lip(former[k][former["rim"]].astype(np.int64), np.eye(n_pairs, dtype=np.float32),
            former[k].ravel().astype(np.int64), column, share)
        for k in ("upper", "lower")
    ]  # fmt: skip
    faces = former["faces"].astype(np.int64)
    points = dict(
        zip(map(str, former["landmarks"]), map(int, former["landmark_points"]), strict=True)
    )
    return (
        KnownSkin(head.cage.faces, count, (upper, lower), head.landmarks),
        KnownSkin(faces, int(faces.max()) + 1, (lips[0], lips[1]), points),
    )


def known_skin(mesh: TriMesh) -> KnownSkin | None:
    """The known skin with the triangles of a mesh."""
    return next((s for s in known_skins() if np.array_equal(s.faces, mesh.faces)), None)


def seal_lips(vertices: Float32, reach_mm: float, unit_mm: float) -> Float32:
    """Close the lips of a known skin where they nearly meet.

    Parameters
    ----------
    vertices : array [shape=(T, V, 3)]
        Of one of `known_skins`.
    reach_mm : float
        Lips further apart than this stay; half as far apart or less, they meet; between, smoothly.
        0 changes nothing.
    unit_mm : float
        Millimetres in a unit of the vertices.

    Returns
    -------
    array [shape=(T, V, 3)]
        A copy, unless `reach_mm` is 0.
    """
    if reach_mm == 0:
        return vertices
    skin = next(skin for skin in known_skins() if skin.n_vertices == vertices.shape[1])
    upper, lower = (vertices[:, lip.rim, 1] @ lip.weight.T for lip in skin.lips)
    gap = upper - lower  # (T, P), height
    quarter = gap.shape[1] // 4
    apart_mm = np.abs(gap[:, quarter:-quarter]).mean(axis=1) * unit_mm
    far = np.clip(2 * apart_mm / reach_mm - 1, 0, 1)
    move = np.zeros((*gap.shape, 3), np.float32)
    move[..., 1] = gap * (1 - far * far * (3 - 2 * far))[:, None]
    sealed = vertices.copy()
    for lip, part in zip(skin.lips, (-UPPER_PART, 1 - UPPER_PART), strict=True):
        sealed[:, lip.reach] += lip.along((part * move).astype(np.float32))
    return sealed


def check_faces(reach_mm: float, templates: Iterable[TriMesh]) -> None:
    """Refuse to seal templates whose lips are not known.

    Raises
    ------
    ConfigError
        If `reach_mm` is not 0 and a template has other triangles.
    """
    if reach_mm and not all(known_skin(mesh) for mesh in templates):
        raise ConfigError(
            f"model.seal_mm={reach_mm:g}: only the embedded heads' lips are known; set it to 0"
        )
