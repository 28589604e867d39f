"""Raw MetaHuman curves to the shapes of avatars, and back, by names; gestures and visemes.

``avatars.csv`` has the shapes of common avatars as poses of raw curves: Oculus visemes (Ready
Player Me), VRChat, VRM 0 and 1, VRoid's ``Fcl_``, MMD, Character Creator 4, Daz Genesis 8 and 9. In
its names ``@`` is L or R and ``$`` Left or Right; ``viseme.PP`` in a pose is that row of
``visemes.csv``. Which muscle a shape of an artist means is our judgement after its name; Character
Creator's and Daz' own ARKit profiles agree where they have the shape. Expressions that are a mood
(Joy, Fcl_ALL_Angry) have no pose: avatars close the eyes or open the mouth with them.

Letters of shapes: T frames, K shapes.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from rig.arrays import Bool, Float32, Float64
from rig.controls import Control, ControlSet, default_controls
from rig.conversion.arkit import (
    PREFIX,
    RAW_ID,
    arkit_controls,
    arkit_to_raw,
    board_to_raw,
    raw_controls,
)
from rig.conversion.shape_fit import close_lips, closing_columns, fit_shapes, pose_of, shape_key
from rig.curves import RigCurves, check_clip, n_frames_for, rest_curves
from rig.errors import ControlError, FormatError, listed, quoted
from rig.files.reading import rows_of

LIPS_TOGETHER = "mouthLipsTogether"
MOST_NAMED = 6


@dataclass(frozen=True, eq=False)
class ShapeFit:
    """Weights of shapes over time, and the movement that they lack.

    Parameters
    ----------
    names : tuple of str
        The shapes.
    weights : array [shape=(T, K), range 0 to 1]
    lost : float [range 0 to 1]
        Share of the raw curves' movement that no shape shows: root of the ratio of summed squares.
    unsaid : tuple of str
        Raw curves that move and that no shape shows, most movement first.
    replaced : tuple of str
        Those that a similar shape shows.
    """

    names: tuple[str, ...]
    weights: Float32
    lost: float
    unsaid: tuple[str, ...]
    replaced: tuple[str, ...] = ()

    def __str__(self) -> str:
        line = f"the shapes show {1 - self.lost:.0%} of the movement"
        for curves, what in ((self.replaced, "similar shapes show"), (self.unsaid, "no shape for")):
            line += f"; {what} {listed(curves, MOST_NAMED)}" if curves else ""
        return line


@dataclass(frozen=True, eq=False)
class ShapePoses:
    """Shapes as poses of raw curves.

    Parameters
    ----------
    names : tuple of str
        All shapes of a set, in its order.
    poses : array [shape=(K, 251)]
        Change of the raw curves at weight 1; zero for unknown shapes.
    visemes : array of bool [shape=(K,)]
        Shapes that are whole mouths.
    close_gain : float [range 0 to 1]
        Weight of ``mouthClose`` at which the lips just meet over ``jawOpen`` at 1.
    """

    names: tuple[str, ...]
    poses: Float64
    visemes: Bool
    close_gain: float = 1.0

    @cached_property
    def closing(self) -> tuple[int, int] | None:
        """Columns of ``mouthClose`` and ``jawOpen``; None if one is missing."""
        found = closing_columns([shape_key(name) for name in self.names])
        return found and (found[0], found[1])

    @property
    def understood(self) -> tuple[str, ...]:
        """Names with a known meaning."""
        moving = np.asarray(self.poses.any(axis=1))
        close = self.closing[0] if self.closing else None
        return tuple(n for i, n in enumerate(self.names) if moving[i] or i == close)

    def fit(
        self, raw: RigCurves, given: Mapping[int, Float64] | None = None, *, linear: bool = False
    ) -> ShapeFit:
        """Fit the weights of every frame.

        Parameters
        ----------
        raw : RigCurves
            Raw curves.
        given : mapping of int to array [shape=(T,)], optional
            Weights by column that are known already; with some of them, lips close.
        linear : bool
            Whether weights may leave [0, 1], so that those of two poses add up.
        """
        raw = raw.reorder(raw_controls())
        bare, given = bare_names(), given or {}
        moved = raw.values.astype(np.float64) - raw_controls().rest
        is_given = np.isin(np.arange(len(self.names)), list(given))
        held = np.zeros((len(moved), len(self.names)))
        for column, weight in given.items():
            held[:, column] = weight
        free = np.where(is_given[:, None], 0.0, self.poses)
        together = [i for i, name in enumerate(bare) if name.startswith(LIPS_TOGETHER)]
        closes = self.closing is not None or bool(given)
        left = moved - held @ self.poses
        weights, missed, replaced = fit_shapes(left, free, self.visemes, bare, closes, linear)
        weights = weights + held
        if self.closing is not None:
            close_lips(weights, moved, self.closing, bare, self.close_gain)
        if closes:
            missed[:, together] = 0.0
        total = float(np.square(moved).sum())
        lost = min(1.0, float(np.sqrt(np.square(missed).sum() / total))) if total else 0.0
        amount = np.abs(moved).sum(axis=0)
        order = [i for i in np.argsort(-amount) if amount[i] > 1e-3 * max(1.0, amount.sum())]
        bare, covered = bare_names(), np.asarray(self.poses.any(axis=0))
        unsaid = [bare[i] for i in order if missed[:, i].any() and not covered[i]]
        similar = tuple(bare[i] for i in order if replaced[i])
        return ShapeFit(self.names, weights.astype(np.float32), lost, tuple(unsaid), similar)

    def mapping(self) -> dict[str, dict[str, float]]:
        """Return the raw curves of each shape by name; empty for shapes of unknown name."""
        bare = bare_names()
        return {
            name: {bare[i]: round(float(pose[i]), 4) for i in np.flatnonzero(pose)}
            for name, pose in zip(self.names, self.poses, strict=True)
        }


@cache
def bare_names() -> list[str]:
    """Return the raw curves' names without their prefix."""
    return [name.removeprefix(PREFIX) for name in raw_controls().names]


def poses_of(shapes: Sequence[str]) -> tuple[Float64, Bool]:
    """Return poses [shape=(K, 251)] of shapes by their names, and which are visemes.

    Zero for unknown names; a mouth that closes over an open jaw has no pose.
    """
    known, whole = known_poses()
    keys = [shape_key(name) for name in shapes]
    found = np.array([pose_of(key, known, bare_names()) for key in keys], np.float64)
    return found.reshape(len(keys), len(bare_names())), np.array([k in whole for k in keys], bool)


@cache
def known_poses() -> tuple[dict[str, Float64], frozenset[str]]:
    """Return poses by `shape_key` of board, ARKit, raw curves and avatars, and keys of visemes."""
    known: dict[str, Float64] = {}
    for controls, to_raw in (
        (default_controls(), board_to_raw),
        (arkit_controls(), arkit_to_raw),
        (raw_controls(), lambda curves: curves),
    ):
        values = np.tile(controls.rest, (len(controls), 1))
        values[np.arange(len(controls)), np.arange(len(controls))] = controls.maximum
        raw = to_raw(RigCurves(values, controls.names, control_set=controls.id))
        change = raw.values.astype(np.float64) - raw_controls().rest
        for name, row in zip(controls.names, change, strict=True):
            known[shape_key(name)] = row
            # A control of one axis is also known by its name alone.
            alone = re.sub(r"\.t[xyz]$", "", name)
            if sum(other.startswith(alone + ".") for other in controls.names) == 1:
                known[shape_key(alone)] = row
    known = {key: pose for key, pose in known.items() if pose.any()}
    rows = [row for avatar in AVATARS for row in _rows(avatar)]
    for name, pose in rows:
        known.setdefault(shape_key(name), _pose(pose))
    return known, frozenset(shape_key(name) for name, pose in rows if pose.startswith("viseme."))


@cache
def avatar_controls(avatar: str) -> ControlSet:
    """Return the shapes of an avatar of `AVATARS`, each in [0, 1]."""
    return ControlSet(avatar, tuple(Control(name) for name, _ in _rows(avatar)))


def raw_to_avatar(curves: RigCurves, avatar: str) -> tuple[RigCurves, ShapeFit]:
    """Fit the shapes of an avatar to raw curves; the head track stays.

    Raises
    ------
    ControlError
        If the curves are not raw curves.
    """
    if curves.control_set != RAW_ID:
        raise ControlError(f"curves are of {curves.control_set!r}; raw curves are {RAW_ID!r}")
    fit = _shapes(avatar).fit(curves)
    return replace(curves, values=fit.weights, names=fit.names, control_set=avatar), fit


def avatar_to_raw(curves: RigCurves) -> RigCurves:
    """Convert an avatar's shapes to raw curves: sum of poses, clamped to [0, 1].

    ``Mouth_Close`` counts as ARKit's: lips together by its ratio to the open jaw.
    """
    shapes, raw = _shapes(curves.control_set), raw_controls()
    weights = curves.reorder(avatar_controls(curves.control_set)).values
    values = weights @ shapes.poses.astype(np.float32) + raw.rest
    if shapes.closing is not None:
        close, jaw = (weights[:, i] for i in shapes.closing)
        together = [i for i, name in enumerate(bare_names()) if name.startswith(LIPS_TOGETHER)]
        ratio = np.clip(close / np.maximum(jaw, 1e-4), 0, 1)
        values[:, together] = np.where(jaw > 1e-4, ratio, 0)[:, None]
    values = np.clip(values, 0, 1)
    return replace(curves, values=values, names=raw.names, control_set=RAW_ID)


@cache
def _shapes(avatar: str) -> ShapePoses:
    shapes = tuple(name for name, _ in _rows(avatar))
    return ShapePoses(shapes, *poses_of(shapes))


def _pose(text: str) -> Float64:
    pose = np.zeros(len(bare_names()))
    for term in filter(None, text.split("|")):
        name, _, weight = term.rpartition(":")
        whole = name.removeprefix("viseme.")
        move = _viseme(whole) if whole != name else np.eye(len(pose))[bare_names().index(name)]
        pose += float(weight) * move
    return pose


@cache
def _viseme(name: str) -> Float64:
    shares = np.array([[float(name == other) for other in names(OCULUS)]], np.float32)
    raw = board_to_raw(weights_to_curves(shares, 30.0))
    return np.asarray(raw.values[0].astype(np.float64) - raw_controls().rest)


@cache
def _rows(avatar: str) -> tuple[tuple[str, str], ...]:
    """Names and poses of an avatar's shapes, both sides written out."""
    rows = []
    for row in rows_of("conversion/avatars.csv"):
        if row["set"] == avatar:
            is_sided = "@" in row["name"] or "$" in row["name"]
            for side, word in (("L", "Left"), ("R", "Right")) if is_sided else (("", ""),):
                name = row["name"].replace("@", side).replace("$", word)
                rows.append((name, row["pose"].replace("@", side)))
    return tuple(rows)


AVATARS = tuple(dict.fromkeys(row["set"] for row in rows_of("conversion/avatars.csv")))
"""Sets of the table."""

# Curves to mouth shapes and back: the 15 Oculus visemes, and Rhubarb's cues A to H and X.
#
# Both sets are drawn by hand, so there is no exact map. Ten gestures are measured on the board
# (jaw, lips together, lip bite …), and each frame gets the viseme with the nearest gestures. The
# poses (``visemes.csv``) are our interpretation of the two sets.


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


def gesture_controls() -> frozenset[str]:
    """Return the controls of all gestures."""
    patterns = [pattern for controls in GESTURES.values() for pattern in controls]
    return frozenset(pattern.replace("*", side) for pattern in patterns for side in "LR")


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
    runs: list[list[float | str]] = []
    for i, shape in enumerate(best):
        if runs and runs[-1][2] == shape:
            runs[-1][1] = (i + 1) / curves.fps
        else:
            runs.append([i / curves.fps, (i + 1) / curves.fps, shape])
    return _merged([Cue(float(a), float(b), str(shape)) for a, b, shape in runs])


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
        np.mean([np.clip(board[name] / full, 0, 1) for name, full in _controls(gesture)], axis=0)
        for gesture in GESTURES
    ]
    return np.stack(measured, axis=1).astype(np.float32)


def posed(amounts: Float32, fps: float) -> RigCurves:
    """Return board curves of gestures [amounts shape=(T, 10)]; the inverse of `gestures`."""
    rest = rest_curves(len(amounts), fps=fps)
    values = rest.values.copy()
    for column, gesture in enumerate(GESTURES):
        for name, full in _controls(gesture):
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


def _controls(gesture: str) -> list[tuple[str, float]]:
    pairs = []
    for pattern, full in GESTURES[gesture].items():
        sides = "LR" if "*" in pattern else "C"
        pairs += [(pattern.replace("*", side), full) for side in sides]
    return pairs


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
