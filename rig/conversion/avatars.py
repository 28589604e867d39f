"""Raw MetaHuman curves to the shapes of avatars, and back, by names.

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
from rig.conversion.arkit import LIPS_TOGETHER, arkit_controls, arkit_to_raw, lips_together
from rig.conversion.raw import PREFIX, RAW_ID, board_to_raw, raw_controls
from rig.conversion.shape_fit import close_lips, closing_columns, fit_shapes, pose_of, shape_key
from rig.conversion.visemes import OCULUS, names, weights_to_curves
from rig.curves import RigCurves
from rig.errors import listed
from rig.files.reading import rows_of

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
        closes = self.closing is not None or bool(given)
        left = moved - held @ self.poses
        weights, missed, replaced = fit_shapes(left, free, self.visemes, bare, closes, linear)
        weights = weights + held
        if self.closing is not None:
            close_lips(weights, moved, self.closing, bare, self.close_gain)
        if closes:
            missed[:, raw_controls().indices(LIPS_TOGETHER)] = 0.0
        total = float(np.square(moved).sum())
        lost = min(1.0, float(np.sqrt(np.square(missed).sum() / total))) if total else 0.0
        amount = np.abs(moved).sum(axis=0)
        order = [i for i in np.argsort(-amount) if amount[i] > 1e-3 * max(1.0, amount.sum())]
        covered = np.asarray(self.poses.any(axis=0))
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
        If a curve is no raw curve.
    """
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
        together = lips_together(close, jaw)
        values[:, raw.indices(LIPS_TOGETHER)] = together[:, None]
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
