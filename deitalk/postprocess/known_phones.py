"""Closures after the network: phones whose times are known, and gaps that are nearly closed.

A network leaves an uncertain /b/ half closed. Where the words are known the lips meet within it,
the lower lip meets the teeth within an f or a v, and the lips are rounded within a rounded sound;
elsewhere nothing is added. Letters: T frames at 30 per second, C controls.
"""

from collections.abc import Iterable, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np

from deitalk.audio.frames import FRAME_RATE
from deitalk.errors import ConfigError
from deitalk.postprocess.phones import BILABIALS, LABIODENTALS
from rig.arrays import Bool, Float32, Int64
from rig.mesh import TriMesh

ROUNDED = {
    "UW": (0.35, 0.9), "W": (0.3, 1.0), "OW": (0.5, 0.6), "UH": (0.35, 0.4), "AO": (0.55, 0.15),
    "SH": (0.85, 0.1), "ZH": (0.8, 0.1), "CH": (0.8, 0.1), "JH": (0.75, 0.1),
}  # fmt: skip
"""Funnel and purse of rounded phones, from the tables of `deitalk.research.corpus.articulation`."""
ROUNDED_SHARE = 0.6
"""Of that rounding, which is met at least: quick speech rounds less."""
FUNNEL, PURSE = 0.75, 0.79
"""Values of the controls for a full funnel and purse (`deitalk/research/corpus/tables`)."""
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


# Seal of the embedded heads' lips: gaps that are nearly closed are closed, after the network.
#
# Deviation: not in the paper, whose lips are used as the solve gives them. A bilabial missed by a
# millimetre looks missed; the embedded heads' own motion ends in the same operator
# (`rig.face.motion.rigid`).


RINGS = range(-2, 10)
"""Loops about the lips' rim, which is 0; negative inside the mouth."""
SHARES = (0.75, 1.0, 1.0, 0.95, 0.86, 0.73, 0.57, 0.41, 0.27, 0.16, 0.08, 0.03)
"""Share of the rim's movement that each loop makes, as in the heads' own seal."""
UPPER_PART = 0.38
"""The upper lip covers this share of the gap, the lower lip the rest."""


class _Loops(NamedTuple):
    """Facing vertices of every loop of `RINGS`, from corner to corner."""

    upper: Int64
    """[shape=(rings, P)]."""
    lower: Int64
    """[shape=(rings, P)]."""


def seal_lips(vertices: Float32, reach_mm: float, unit_mm: float) -> Float32:
    """Close the lips of an embedded head where they nearly meet.

    Parameters
    ----------
    vertices : array [shape=(T, V, 3)]
        Skin of any embedded head: vertices are numbered alike in every identity.
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
    upper, lower = _head_loops()
    rim = RINGS.index(0)
    gap = vertices[:, lower[rim]] - vertices[:, upper[rim]]  # (T, P, 3)
    # How far the lips of each frame are brought together [shape=(T,), range 0 to 1].
    gap_mm = gap * np.float32(unit_mm)
    quarter = gap_mm.shape[1] // 4
    middle = gap_mm[:, quarter : gap_mm.shape[1] - quarter]
    apart_mm = np.linalg.norm(middle, axis=-1).mean(axis=1)
    far = np.clip(2 * apart_mm / reach_mm - 1, 0, 1)
    move = gap * np.asarray(1 - far * far * (3 - 2 * far), dtype=np.float32)[:, None, None]
    share = np.array(SHARES, dtype=np.float32)[:, None, None]
    sealed = vertices.copy()
    sealed[:, upper] += UPPER_PART * move[:, None] * share
    sealed[:, lower] -= (1 - UPPER_PART) * move[:, None] * share
    return sealed


def check_faces(reach_mm: float, templates: Iterable[TriMesh]) -> None:
    """Refuse to seal templates that are no embedded head's skin.

    Raises
    ------
    ConfigError
        If `reach_mm` is not 0 and a template has other triangles.
    """
    if reach_mm == 0:
        return
    from rig.face import build_head

    faces = build_head(0).skin.faces
    if not all(np.array_equal(mesh.faces, faces) for mesh in templates):
        raise ConfigError(
            f"model.seal_mm={reach_mm:g}: only the embedded heads' lips are known; set it to 0"
        )


@cache
def _head_loops() -> _Loops:
    from rig.face import build_head
    from rig.face.geometry.topology import MOUTH

    skin = build_head(0).features
    rows = [skin.loop(MOUTH, ring) for ring in RINGS]
    upper = np.arange(1, len(rows[0]) // 2)
    return _Loops(
        np.stack([row[upper] for row in rows]),
        np.stack([row[len(row) - upper] for row in rows]),
    )
