"""A filmed face to rig curves: landmarks, straightened, measured, repeated on the embedded head."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from deitalk.audio.frames import FRAME_RATE
from deitalk.data.captures.take import VIDEOS, CapturedCurves
from deitalk.research.lips.head_lips import CENTRAL, HeadLips
from deitalk.research.lips.nearest import nearest_curves
from deitalk.research.video.detector import Progress, track_face
from deitalk.research.video.landmarks import (
    BROWS,
    CORNERS,
    IRIS,
    LIDS,
    MIDDLE,
    PLACE,
    RIGID,
    RIGID_MIRROR,
    RIMS,
    FaceTrack,
    at_rig_frames,
    read_landmarks,
)
from rig import ControlSet, RigCurves, default_controls
from rig.arrays import Bool, Float32, Float64, Int64
from rig.face.head import GAZE_DEGREES, Head, build_head

# Measures of a face that landmarks show, as a differentiable function of the 185 curves.
#
# Widens the lips of `HeadLips` by each side of the mouth, brows and lids.
#
# Letters: T frames, C controls, N points, P columns of the rims, M measures.

SIDES = ("L", "R")
MOUTH = (
    "opening", "jaw", "jaw_side", "upper_edge", "lower_edge",
    *(f"{name}_{s}" for name in ("corner_out", "corner", "upper", "lower") for s in SIDES),
)  # fmt: skip
UPPER = tuple(
    f"{name}_{s}"
    for name in ("brow_in", "brow_mid", "brow_out", "brow_squeeze", "lid", "lower_lid")
    for s in SIDES
)
MEASURES = MOUTH + UPPER
"""Gap of the rims, chin to nose base, chin to the left, thickness of both lips; corners from the
middle, and corners and rims below the nose base; brows above the eyes at three places, inner ends
of the brows from the middle, gap of the lids, height of the lower lid. L is the person's left."""
BROW_PLACES = {"in": 0.12, "mid": 0.5, "out": 0.85}
"""Along a brow from its inner end."""


class HeadFace(HeadLips):
    """Curves to measures of one head's face.

    Parameters
    ----------
    head : Head
        An embedded head.

    Attributes
    ----------
    eye_width, iris_radius : float
        Between the corners of one eye, and of the iris's centre about the eye's, cm.
    """

    sides: Tensor

    def __init__(self, head: Head) -> None:
        marks = head.landmarks
        brows = [_brow_place(head, s, place) for s in SIDES for place in BROW_PLACES.values()]
        lids = [marks[f"eye_{part}_{s}"] for s in ("left", "right") for part in ("upper", "lower")]
        edges = [marks["upper_lip_top"], marks["lower_lip_bottom"]]
        super().__init__(head, (*edges, *brows, *lids))
        along = np.linspace(-1, 1, self.n_pairs)
        central = np.abs(along) <= CENTRAL
        sides = np.stack([central * (along > 0), central * (along < 0)])
        self._keep("sides", sides / sides.sum(axis=1, keepdims=True))
        outer, inner = (head.skin.vertices[marks[f"eye_{k}_left"]] for k in ("outer", "inner"))
        self.eye_width = float(np.linalg.norm(outer - inner))
        self.iris_radius = float(head.eyes[0, 3])

    def forward(self, curves: Tensor) -> Tensor:
        """Measure curves (..., C) as `HeadLips.forward`, by `MEASURES` of this module (..., M)."""
        upper, lower, others = self.points(curves)
        left, right, chin, nose, top, bottom = others[..., :6, :].unbind(-2)
        brows = others[..., 6:12, :].reshape(*curves.shape[:-1], 2, 3, 3)
        rims = [(rim[..., 1] @ self.sides.T) for rim in (upper, lower)]
        middle = [(rim * self.central[:, None]).sum(-2) for rim in (upper, lower)]
        below = nose[..., 1, None]
        corners = torch.stack((left, right), dim=-2)
        signs = curves.new_tensor([1.0, -1.0])
        lids = others[..., 12:16, :].reshape(*curves.shape[:-1], 2, 2, 3)
        gap, low = lids[..., 0, 1] - lids[..., 1, 1], lids[..., 1, 1]
        measures = (
            torch.stack(
                (
                    (middle[0] - middle[1])[..., 1],
                    (nose - chin)[..., 1],
                    (chin - nose)[..., 0],
                    (top - middle[0])[..., 1],
                    (middle[1] - bottom)[..., 1],
                ),
                dim=-1,
            ),
            (corners[..., 0] - nose[..., 0, None]) * signs,
            below - corners[..., 1],
            below - rims[0],
            below - rims[1],
            *brows[..., 1].unbind(-1),
            brows[..., 0, 0] * signs,
            gap,
            low,
        )
        return torch.cat(measures, dim=-1)


def _brow_place(head: Head, side: str, place: float) -> tuple[Int64, Float32]:
    """The skin that a place of a brow follows: vertices and their weights."""
    part = head.slices[f"brow_{side}"]
    along = np.abs(head.mesh.vertices[part, 0])
    wanted = along.min() + place * np.ptp(along)
    near = part.start + np.flatnonzero(np.abs(along - wanted) <= 0.08 * np.ptp(along))
    rows = np.searchsorted(head.follow, near)
    weights = head.near_weight[rows] / np.float32(len(rows))
    return head.near[rows].ravel(), weights.ravel()


# Straightened landmarks to the measures of a head's face, fitted to the person's proportions.
#
# People differ in size and in how their faces rest, so that measures become displacements from the
# person's rest, in cm of the head: across by the widths of the mouths, up and down by the heights
# from nose to chin, brows by the distances of the eyes, lids by the gaps of open and closed eyes.
#
# Letters: T frames, M measures (`MEASURES`).

CLOSED_PERCENTILE = 5
"""Of the opening in a take: lips that touch."""
SHUT_LIPS = 0.15
"""Opening of lips at rest, as a share of the way from its 5th percentile to its 95th."""
STILL_FRAMES = 15
"""Of the first pause with shut, still lips, in which the face is taken to rest."""
SHUT_SHARE = 0.25
"""Gap of the lids in a blink over the open gap, where the take shows no blink."""
BLINK_SHARE = 0.5
"""Gap of the lids, as that, below which an eye is shut: the take shows a blink, no gaze is seen."""
LEAST_SHUT = 2
"""Frames of blinks that show where lids meet."""
_GAP = slice(MEASURES.index("lid_L"), MEASURES.index("lid_R") + 1)


@dataclass(frozen=True, eq=False)
class Measured:
    """What landmarks show.

    Parameters
    ----------
    displacements : array [shape=(T, M)], cm
        From the rest of the head.
    gaze : array [shape=(T, 2)] or None
        Of both eyes to the character's left and up, -1 to 1; None if irises are not measured.
    notes : tuple of str
        Assumptions about the person's rest.
    """

    displacements: Float32
    gaze: Float32 | None
    notes: tuple[str, ...] = ()


def measure(track: FaceTrack, seen: Bool, face: HeadFace) -> Measured:
    """Measures of a straightened face as displacements of a head.

    Parameters
    ----------
    track : FaceTrack
        Of `deitalk.research.video.filmed.straightened`.
    seen : array of bool [shape=(T,)]
        Frames with a face.
    face : HeadFace
        The head.
    """
    values = person_measures(track)
    rest = _rest(values, seen)
    head = dict(zip(MEASURES, face(face.rest).tolist(), strict=True))
    person = dict(zip(MEASURES, rest.tolist(), strict=True))
    moved = (values - rest) * _scales(head, person, face.eye_distance)
    gaps = values[:, _GAP]
    shut, is_shown = _shut(gaps[seen], rest[_GAP])
    share = (gaps - shut) / (rest[_GAP] - shut)
    moved[:, _GAP] = (share.clip(min=0) - 1) * head["lid_L"]
    notes = () if is_shown else ("no blink seen, lids taken to meet at a quarter of their gap",)
    return Measured(moved.astype(np.float32), _gaze(track, gaps / rest[_GAP], seen, face), notes)


def person_measures(track: FaceTrack) -> Float64:
    """`MEASURES` of a straightened face [shape=(T, M)], in distances of the eyes."""
    nose, chin = track.at(MIDDLE["nose"]), track.at(MIDDLE["chin"])
    rims = {lip: {s: track.at(*RIMS[lip][s]) for s in SIDES} for lip in RIMS}
    middle = {lip: track.at(*RIMS[lip]["L"], MIDDLE[lip], *RIMS[lip]["R"])[:, 1] for lip in RIMS}
    signs = {"L": 1.0, "R": -1.0}
    columns = [
        middle["upper"] - middle["lower"],
        nose[:, 1] - chin[:, 1],
        chin[:, 0] - nose[:, 0],
        track.at(MIDDLE["upper_edge"])[:, 1] - middle["upper"],
        middle["lower"] - track.at(MIDDLE["lower_edge"])[:, 1],
    ]
    corners = {s: track.at(CORNERS[s]) for s in SIDES}
    columns += [signs[s] * (corners[s][:, 0] - nose[:, 0]) for s in SIDES]
    columns += [nose[:, 1] - corners[s][:, 1] for s in SIDES]
    columns += [nose[:, 1] - rims[lip][s][:, 1] for lip in ("upper", "lower") for s in SIDES]
    columns += [track.at(*BROWS[s][place])[:, 1] for place in ("in", "mid", "out") for s in SIDES]
    columns += [signs[s] * track.at(*BROWS[s]["in"])[:, 0] for s in SIDES]
    lids = {s: {lid: track.at(*LIDS[s][lid])[:, 1] for lid in ("upper", "lower")} for s in SIDES}
    columns += [lids[s]["upper"] - lids[s]["lower"] for s in SIDES]
    columns += [lids[s]["lower"] for s in SIDES]
    return np.stack(columns, axis=1).astype(np.float64)


def _rest(values: Float64, seen: Bool) -> Float64:
    """Measures (M,) of the face at rest: in the first pause with shut, still lips; eyes open.

    Takes without such a pause: the median of all frames with shut, still lips.
    """
    opening = values[:, 0]
    low, high = np.percentile(opening[seen], [CLOSED_PERCENTILE, 100 - CLOSED_PERCENTILE])
    speed = np.abs(np.gradient(values[:, : MEASURES.index("brow_in_L")], axis=0)).sum(axis=1)
    shut = seen & (opening <= low + SHUT_LIPS * (high - low))
    still = shut & (speed <= np.median(speed[seen]))
    runs = np.lib.stride_tricks.sliding_window_view(still, min(STILL_FRAMES, len(still))).all(
        axis=1
    )
    if runs.any():
        first = int(runs.argmax())
        still = still & (np.arange(len(still)) >= first)
        still[first + STILL_FRAMES :] &= np.logical_and.accumulate(still[first + STILL_FRAMES :])
    rest: Float64 = np.median(values[still if still.any() else seen], axis=0)
    rest[0] = low
    rest[_GAP.start :] = np.median(values[seen, _GAP.start :], axis=0)
    return rest


def _scales(head: dict[str, float], person: dict[str, float], eye_distance: float) -> Float64:
    """Factors (M,) from the person's distances of the eyes to cm of the head."""

    def ratio(*names: str) -> float:
        return sum(head[n] for n in names) / max(sum(person[n] for n in names), 1e-6)

    across = ratio("corner_out_L", "corner_out_R")
    up = ratio("jaw")
    lids = ratio("lid_L", "lid_R")
    factors = {"jaw_side": across, "corner_out": across, "brow": eye_distance, "lower_lid": lids}
    return np.array(
        [next((f for part, f in factors.items() if name.startswith(part)), up) for name in MEASURES]
    )


def _shut(gaps: Float64, open_: Float64) -> tuple[Float64, bool]:
    """Gaps (2,) at which the lids of each eye meet, and whether a blink shows them."""
    share = (gaps / open_).mean(axis=1)
    blinks = share < BLINK_SHARE
    if blinks.sum() < LEAST_SHUT:
        return SHUT_SHARE * open_, False
    lowest = np.percentile(gaps[blinks], 25, axis=0)
    return np.minimum(lowest, BLINK_SHARE * open_), True


def _gaze(track: FaceTrack, gap_share: Float64, seen: Bool, face: HeadFace) -> Float32 | None:
    """Gaze of both eyes together (T, 2), against its mean; shut eyes keep the gaze around."""
    if not np.isfinite(track.at(IRIS["L"])[seen]).all():
        return None
    places = []
    for side in SIDES:
        outer, inner = (track.at(corner)[:, :2] for corner in LIDS[side]["corners"])
        width = np.linalg.norm(outer - inner, axis=1, keepdims=True)
        places.append((track.at(IRIS[side])[:, :2] - (outer + inner) / 2) / width)
    moved: Float64 = np.asarray(np.mean(places, axis=0, dtype=np.float64))
    looking = seen & (gap_share.min(axis=1) > BLINK_SHARE)
    if not looking.any():
        return None
    moved -= moved[looking].mean(axis=0)
    sine = np.clip(moved * face.eye_width / face.iris_radius, -1, 1)
    degrees: Float64 = np.asarray(np.degrees(np.arcsin(sine)))
    full = np.where(degrees[:, 1] > 0, GAZE_DEGREES["up"], GAZE_DEGREES["down"])
    gaze = np.clip(degrees / np.stack([np.full_like(full, GAZE_DEGREES["side"]), full], 1), -1, 1)
    at = np.arange(len(gaze))
    kept = [np.interp(at, at[looking], column[looking]) for column in gaze.T]
    return np.stack(kept, axis=1).astype(np.float32)


SIDEWAYS_DEGREES = 30.0
"""Yaw from which on the far side of the face is guessed by the detector."""
SIDEWAYS_SHARE = 0.05


@dataclass(frozen=True, eq=False)
class Filmed:
    """Curves of a filmed face.

    Parameters
    ----------
    curves : RigCurves
        T frames at 30 per second, with the turn of the head.
    known : tuple of str
        Controls that landmarks show.
    seen : array of bool [shape=(T,)]
        Frames with a face; the others hold the nearest ones' values.
    notes : tuple of str
        What a user should know.
    """

    curves: RigCurves
    known: tuple[str, ...]
    seen: Bool
    notes: tuple[str, ...]


def read_capture(path: Path, progress: Progress) -> CapturedCurves:
    """Curves of the face in a video, or of a file of its landmarks; errors as `filmed_curves`."""
    is_video = path.suffix.lower() in VIDEOS
    found = filmed_curves(
        track_face(path, progress) if is_video else read_landmarks(path), str(path)
    )
    return CapturedCurves(found.curves, found.known, "video", notes=found.notes, seen=found.seen)


def filmed_curves(track: FaceTrack, where: str) -> Filmed:
    """Curves of a face whose landmarks are measured.

    Parameters
    ----------
    track : FaceTrack
        At any rate.
    where : str
        Name of the video, for messages.

    Raises
    ------
    DataError
        If the face is in too few frames, or the rate is too low.
    """
    even, seen = at_rig_frames(track, where)
    straight, degrees = straightened(even, seen)
    face, controls = HeadFace(build_head()), default_controls()
    measured = measure(straight, seen, face)
    values = solve_curves(measured, face, controls)
    head = np.pad(degrees, ((0, 0), (0, 3)))
    curves = RigCurves(values, controls.names, float(FRAME_RATE), head=head)
    known = shown_controls(controls, gaze=measured.gaze is not None)
    return Filmed(curves, known, seen, (*track.notes, *measured.notes, *_notes(degrees, seen)))


def _notes(degrees: Float32, seen: Bool) -> list[str]:
    notes = []
    if not seen.all():
        notes.append(f"no face in {1 - seen.mean():.0%} of the frames, left out")
    aside = float((np.abs(degrees[seen, 0]) > SIDEWAYS_DEGREES).mean())
    if aside > SIDEWAYS_SHARE:
        notes.append(
            f"the head is turned more than {SIDEWAYS_DEGREES:.0f} degrees in {aside:.0%} of the "
            "frames, sides there are guessed"
        )
    return notes


# Landmarks without the head's motion, and the head's turn, from one camera.
#
# Every frame is turned, scaled and shifted onto the person's mean shape by the points that move
# with the skull (least squares over rotations, Umeyama 1991, IEEE PAMI 13(4):376, eq. 40-43). The
# mean shape is made symmetric, so that its middle plane faces the camera.
#
# Letters: T frames, P points, R rigid points.


ROUNDS = 4
MOST_FRAMES = 3000
"""Frames that the mean shape is taken from, evenly spread."""


def straightened(track: FaceTrack, seen: Bool) -> tuple[FaceTrack, Float32]:
    """Remove the motion of the head.

    Parameters
    ----------
    track : FaceTrack
        T frames.
    seen : array of bool [shape=(T,)]
        Frames with a face.

    Returns
    -------
    track : FaceTrack
        In distances between the outer corners of the eyes: x to the person's left, y up, z towards
        the camera, 0 between the eyes.
    degrees : array [shape=(T, 3)]
        Yaw, pitch and roll of the head in the signs of `rig.curves.HEAD`, against the median of the
        take: where the camera stood is not known.
    """
    points = track.points * np.array([1, -1, -1], np.float32)
    rigid = points[:, [PLACE[n] for n in RIGID]].astype(np.float64)
    frames = np.flatnonzero(seen)
    frames = frames[np.linspace(0, len(frames) - 1, min(len(frames), MOST_FRAMES)).astype(int)]
    shape = _mean_shape(rigid[frames])
    rotation, scale, center = _onto(rigid, shape)
    corners = [RIGID.index(LIDS[side]["corners"][0]) for side in ("L", "R")]
    unit = float(np.linalg.norm(shape[corners[0]] - shape[corners[1]]))
    middle = shape[corners].mean(axis=0)
    moved = (points - center[:, None]) @ rotation.transpose(0, 2, 1) * scale[:, None, None]
    straight = ((moved - middle) / unit).astype(np.float32)
    return FaceTrack(straight, track.times, track.notes), _degrees(rotation, seen)


def _mean_shape(rigid: Float64) -> Float64:
    """Mean shape (R, 3) about its centre, symmetric to x = 0, of size 1."""
    shape = _centred(rigid[len(rigid) // 2])
    for _ in range(ROUNDS):
        rotation, scale, center = _onto(rigid, shape)
        moved = (rigid - center[:, None]) @ rotation.transpose(0, 2, 1) * scale[:, None, None]
        shape = _centred(np.median(moved, axis=0))
    places = [RIGID.index(n) for n in RIGID_MIRROR]
    for _ in range(ROUNDS):
        other = shape[places] * [-1, 1, 1]
        rotation, scale, center = _onto(other[None], shape)
        shape = _centred((shape + (other - center[0]) @ rotation[0].T * scale[0]) / 2)
        across = (shape - shape[places]).reshape(-1, 3)
        direction = np.linalg.svd(across)[2][0]
        shape = shape @ _turn_to_x(direction if direction[0] > 0 else -direction).T
    return shape


def _centred(shape: Float64) -> Float64:
    shape = shape - shape.mean(axis=0)
    return np.asarray(shape / np.sqrt((shape**2).sum()))


def _turn_to_x(direction: Float64) -> Float64:
    """The smallest rotation (3, 3) that turns a unit vector to x."""
    axis = np.cross(direction, [1.0, 0.0, 0.0])
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1 + direction[0]))


def _onto(rigid: Float64, shape: Float64) -> tuple[Float64, Float64, Float64]:
    """Rotation (T, 3, 3), scale (T,) and centre (T, 3) that lay frames (T, R, 3) on a shape."""
    center = rigid.mean(axis=1)
    around = rigid - center[:, None]
    u, _, v = np.linalg.svd(np.einsum("rk,trl->tkl", shape, around))
    sign = np.sign(np.linalg.det(u @ v))
    u[:, :, 2] *= sign[:, None]
    rotation = u @ v
    along = np.einsum("trk,rk->t", around @ rotation.transpose(0, 2, 1), shape)
    scale = along / np.maximum((around**2).sum(axis=(1, 2)), 1e-12)
    return rotation, scale, center


def _degrees(rotation: Float64, seen: Bool) -> Float32:
    """Yaw, pitch and roll against their medians; `rotation` turns each frame to the camera."""
    head = rotation.transpose(0, 2, 1)  # from the resting head to the turned one
    yaw = -np.degrees(np.arctan2(head[:, 0, 2], head[:, 2, 2]))
    pitch = np.degrees(np.arcsin(np.clip(head[:, 1, 2], -1, 1)))
    roll = np.degrees(np.arctan2(head[:, 1, 0], head[:, 1, 1]))
    turns = np.stack([yaw, pitch, roll], axis=1)
    return np.asarray(turns - np.median(turns[seen], axis=0), np.float32)


# Rig curves that repeat measured faces on the embedded head.
#
# Letters: T frames at 30 per second, C controls, M measures.


LOOSENESS = {
    "CTRL_C_jaw.ty": 0.5,
    "CTRL_C_jaw.tx": 0.15,
    "CTRL_C_mouth.tx": 0.15,
    "mouth_upperLipRaise": 0.4,
    "mouth_lowerLipDepress": 0.4,
    "mouth_cornerPull": 0.4,
    "mouth_cornerDepress": 0.3,
    "mouth_stretch.ty": 0.3,
    "mouth_funnel": 0.3,
    "mouth_purse": 0.3,
    "mouth_lipsTogether": 0.6,
    "brow_down": 0.4,
    "brow_lateral": 0.3,
    "brow_raiseIn": 0.5,
    "brow_raiseOut": 0.5,
    "eye_blink": 0.6,
    "eye_squintInner": 0.3,
}
"""Controls that landmarks show, by parts of their names, and how far they readily move."""
GAZE = tuple(f"CTRL_{side}_eye.{axis}" for axis in ("tx", "ty") for side in SIDES)
TOLERANCE_CM = {
    "opening": 0.02,
    "jaw": 0.2,
    "edge": 0.12,
    "brow_squeeze": 0.12,
    "lower_lid": 0.08,
}
"""Error of a measure that costs as much as a control moved by its looseness, by parts of names:
the detector places the rims of lips and lids well, chin and outer edges of the lips less so."""
USUAL_TOLERANCE_CM = 0.04
CHUNK = 1000
"""Frames that are solved at a time."""


def shown_controls(controls: ControlSet, *, gaze: bool) -> tuple[str, ...]:
    """Controls that landmarks determine: no tongue, teeth, lip bite or cheeks."""
    return tuple(
        name
        for name in controls.names
        if any(part in name for part in LOOSENESS) or (gaze and name in GAZE)
    )


def solve_curves(measured: Measured, face: HeadFace, controls: ControlSet) -> Float32:
    """Curves near rest with which the head does what was measured [shape=(T, C)].

    Bounded least squares (`nearest_curves`): squared errors of the measures
    over `TOLERANCE_CM` plus squared controls over `LOOSENESS`, within the ranges of the controls.
    The gaze is not solved for but taken, since lids follow it.

    Parameters
    ----------
    measured : Measured
        T frames.
    face : HeadFace
        The head.
    controls : ControlSet
        The default board.
    """
    n_frames = len(measured.displacements)
    prior = torch.tensor(np.tile(controls.rest, (n_frames, 1))).float()
    if measured.gaze is not None:
        for name in GAZE:
            column = measured.gaze[:, int(name.endswith(".ty"))]
            prior[:, controls.index(name)] = torch.from_numpy(column.copy())
    loose = torch.tensor(
        [
            next((far for part, far in LOOSENESS.items() if part in name), 0.0)
            for name in controls.names
        ]
    )
    tolerance = torch.tensor(
        [
            next((far for part, far in TOLERANCE_CM.items() if part in name), USUAL_TOLERANCE_CM)
            for name in MEASURES
        ]
    )
    wanted = torch.from_numpy(measured.displacements)
    solved = [
        nearest_curves(
            prior[k : k + CHUNK], wanted[k : k + CHUNK], face, loose, tolerance, controls
        )
        for k in range(0, n_frames, CHUNK)
    ]
    values: Float32 = torch.cat(solved).numpy()
    return values
