"""Curves to mouth shapes and back: the 15 Oculus visemes, and Rhubarb's cues A to H and X.

Both sets are drawn by hand, so there is no exact map. Ten gestures are measured on the board (jaw,
lips together, lip bite …), and each frame gets the viseme with the nearest gestures. The poses
(``visemes.csv``) are our interpretation of the two sets.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from rig.arrays import Float32
from rig.controls import default_controls
from rig.curves import RigCurves, check_clip, n_frames_for, rest_curves
from rig.errors import FormatError, quoted
from rig.files.reading import rows_of

GESTURES: dict[str, dict[str, float]] = {
    "jaw": {"CTRL_C_jaw.ty": 0.55},
    "together": {"CTRL_*_mouth_lipsTogetherU.ty": 1.0, "CTRL_*_mouth_lipsTogetherD.ty": 1.0},
    "bite": {"CTRL_*_mouth_lipBiteD.ty": 0.78},
    "funnel": {"CTRL_*_mouth_funnelU.ty": 0.75, "CTRL_*_mouth_funnelD.ty": 0.75},
    "purse": {"CTRL_*_mouth_purseU.ty": 0.8, "CTRL_*_mouth_purseD.ty": 0.8},
    "spread": {"CTRL_*_mouth_stretch.ty": 0.42},
    "tip": {"CTRL_C_tongue_tipMove.ty": 0.75},
    "out": {"CTRL_C_tongue_inOut.ty": -0.5},
    "back": {"CTRL_C_tongue_bendTwist.ty": -0.35},
    "hiss": {"CTRL_C_jaw_fwdBack.ty": -0.18},
}
"""Controls (``*`` is both sides) and the value at which the gesture is full."""
EMPHASIS = {
    "together": 1.6,
    "bite": 1.6,
    "jaw": 1.4,
    "purse": 1.2,
    "tip": 0.7,
    "back": 0.7,
    "hiss": 0.6,
}
"""Weight of each gesture in the distance: lips that meet most, the hidden tongue least."""
WIDTH = 0.28
"""Distance at which a pose's share has fallen to exp(-1/2)."""
MINIMUM_CUE_SECONDS = 0.06
TRANSITION_SECONDS = 0.08
OCULUS = "oculus"
RHUBARB = "rhubarb"


@dataclass(frozen=True)
class Cue:
    """One mouth shape of Rhubarb: ``A`` to ``H`` or ``X``, from start to end in seconds."""

    start: float
    end: float
    shape: str


@cache
def _gestures() -> dict[str, dict[str, float]]:
    """Return `GESTURES` with both sides written out."""
    return {
        gesture: {pattern.replace("*", side): full for pattern, full in controls.items()
                  for side in ("LR" if "*" in pattern else "C")}
        for gesture, controls in GESTURES.items()
    }  # fmt: skip


def gesture_controls() -> frozenset[str]:
    """Return the controls of all gestures."""
    return frozenset(name for controls in _gestures().values() for name in controls)


def names(viseme_set: str) -> tuple[str, ...]:
    """Return the names of ``oculus`` (15) or ``rhubarb`` (9)."""
    return tuple(row["name"] for row in _viseme_rows(viseme_set))


def weights(curves: RigCurves, viseme_set: str = OCULUS) -> Float32:
    """Return the weight of every viseme in each frame [shape=(T, visemes), rows sum to 1].

    Parameters
    ----------
    curves : RigCurves
        Of the default board.
    viseme_set : str
        ``oculus`` or ``rhubarb``.
    """
    emphasis = np.array([EMPHASIS.get(name, 1.0) for name in GESTURES], np.float32)
    measured = gestures(curves) * emphasis
    poses = _poses(viseme_set) * emphasis
    squares = np.stack([((measured - pose) ** 2).sum(axis=1) for pose in poses], axis=1)
    share = np.exp((squares.min(axis=1, keepdims=True) - squares) / (2 * WIDTH**2))
    share[share < 0.01] = 0
    total: Float32 = share / share.sum(axis=1, keepdims=True)
    return total


def cues(curves: RigCurves) -> tuple[Cue, ...]:
    """Return Rhubarb's cues: the strongest shape per frame, cues shorter than 60 ms merged.

    Closed lips (``A``) of any length are kept, since their absence is the most visible error.
    """
    shapes = names(RHUBARB)
    best = [shapes[i] for i in weights(curves, RHUBARB).argmax(axis=1)]
    runs, first = [], 0
    for shape, frames in itertools.groupby(best):
        stop = first + len(list(frames))
        runs.append(Cue(first / curves.fps, stop / curves.fps, shape))
        first = stop
    return _merged(runs)


def cues_to_curves(given: Sequence[Cue], fps: float = 30.0) -> RigCurves:
    """Return board curves of cues: poses held, with transitions of 80 ms.

    Raises
    ------
    FormatError
        If a cue is unknown, ends before it starts, or overlaps the one before.
    """
    poses = dict(zip(names(RHUBARB), _poses(RHUBARB), strict=True))
    n_frames = max(n_frames_for(max((cue.end for cue in given), default=0.0), fps=fps), 1)
    check_clip(n_frames, len(default_controls()))
    amounts = np.zeros((n_frames, len(GESTURES)), np.float32)
    last = 0.0
    for number, cue in enumerate(given, start=1):
        if cue.shape not in poses:
            raise FormatError(f"cue {number} is {quoted(cue.shape)}; known: {', '.join(poses)}")
        if cue.start < last - 1e-6 or cue.end < cue.start:
            raise FormatError(
                f"cue {number} runs from {cue.start:g} to {cue.end:g} s, out of order"
            )
        last = cue.end
        first, stop = round(cue.start * fps), round(cue.end * fps)
        amounts[first : max(stop, first + 1)] = poses[cue.shape]
    from scipy.ndimage import uniform_filter1d

    size = max(1, round(TRANSITION_SECONDS * fps)) | 1
    return posed(uniform_filter1d(amounts, size, axis=0, mode="nearest"), fps)


def weights_to_curves(shares: Float32, fps: float) -> RigCurves:
    """Return board curves of `weights` of the Oculus visemes [shape=(T, 15), rows sum to 1]."""
    check_clip(len(shares), len(default_controls()))
    return posed(shares @ _poses(OCULUS), fps)


def gestures(curves: RigCurves) -> Float32:
    """Return the ten gestures [shape=(T, 10), range 0 to 1]; controls that are absent rest."""
    board = curves.reorder(default_controls())
    measured = [
        np.mean([np.clip(board[name] / full, 0, 1) for name, full in controls.items()], axis=0)
        for controls in _gestures().values()
    ]
    return np.stack(measured, axis=1).astype(np.float32)


def posed(amounts: Float32, fps: float) -> RigCurves:
    """Return board curves of gestures [amounts shape=(T, 10)]; the inverse of `gestures`."""
    rest = rest_curves(len(amounts), fps=fps)
    values = rest.values.copy()
    for column, controls in enumerate(_gestures().values()):
        for name, full in controls.items():
            values[:, rest.index(name)] = amounts[:, column] * full
    values.setflags(write=False)  # not copied again
    return replace(rest, values=values)


def _merged(runs: list[Cue]) -> tuple[Cue, ...]:
    """Merge runs that are too short into their longer neighbour, then join equal neighbours."""
    merged: list[Cue] = []
    for i, run in enumerate(runs):
        is_short = run.end - run.start < MINIMUM_CUE_SECONDS - 1e-9 and run.shape != "A"
        shape = run.shape
        if is_short and merged:
            shape = merged[-1].shape
        elif is_short and i + 1 < len(runs):
            shape = runs[i + 1].shape
        if merged and merged[-1].shape == shape:
            merged[-1] = Cue(merged[-1].start, run.end, shape)
        else:
            merged.append(Cue(run.start, run.end, shape))
    return tuple(merged)


@cache
def _poses(viseme_set: str) -> Float32:
    """Return the poses [shape=(visemes, 10)]."""
    rows = _viseme_rows(viseme_set)
    return np.array([[float(row[gesture]) for gesture in GESTURES] for row in rows], np.float32)


def _viseme_rows(viseme_set: str) -> list[dict[str, str]]:
    rows = [row for row in rows_of("conversion/visemes.csv") if row["set"] == viseme_set]
    if not rows:
        raise FormatError(f"unknown set of visemes {viseme_set!r}; known: {OCULUS}, {RHUBARB}")
    return rows
