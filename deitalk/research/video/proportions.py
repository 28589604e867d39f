"""Straightened landmarks to the measures of a head's face, fitted to the person's proportions.

People differ in size and in how their faces rest, so that measures become displacements from the
person's rest, in cm of the head: across by the widths of the mouths, up and down by the heights
from nose to chin, brows by the distances of the eyes, lids by the gaps of open and closed eyes.

Letters: T frames, M measures (`MEASURES`).
"""

from dataclasses import dataclass

import numpy as np

from deitalk.research.video.head_face import MEASURES, SIDES, HeadFace
from deitalk.research.video.landmarks import BROWS, CORNERS, IRIS, LIDS, MIDDLE, RIMS, FaceTrack
from rig.arrays import Bool, Float32, Float64
from rig.face.head import GAZE_DEGREES

CLOSED_PERCENTILE = 5
"""Percentile of the opening in a take at which lips touch."""
SHUT_LIPS = 0.15
"""Opening of lips at rest, as a share of the way from its 5th percentile to its 95th."""
STILL_FRAMES = 15
"""Length of the first pause with shut, still lips, in which the face is taken to rest."""
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
        Of `deitalk.research.video.straighten.straightened`.
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
