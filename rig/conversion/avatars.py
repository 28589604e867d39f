"""Raw MetaHuman curves to the shapes of avatars, and back: by names, and by a bounded fit.

``avatars.csv`` has the shapes of common avatars as poses of raw curves: Oculus visemes (Ready
Player Me), VRChat, VRM 0 and 1, VRoid's ``Fcl_``, MMD, Character Creator 4, Daz Genesis 8 and 9. In
its names ``@`` is L or R and ``$`` Left or Right; ``viseme.PP`` in a pose is that row of
``visemes.csv``. Which muscle a shape of an artist means is our judgement after its name; Character
Creator's and Daz' own ARKit profiles agree where they have the shape. Expressions that are a mood
(Joy, Fcl_ALL_Angry) have no pose: avatars close the eyes or open the mouth with them.

Letters of shapes: T frames, K shapes.
"""

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from importlib import resources
from typing import Any

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
from rig.conversion.visemes import OCULUS, names, weights_to_curves
from rig.curves import RigCurves
from rig.errors import ControlError

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
            more = f" and {len(curves) - MOST_NAMED} more" if len(curves) > MOST_NAMED else ""
            line += f"; {what} {', '.join(curves[:MOST_NAMED])}{more}" if curves else ""
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

    def fit(self, raw: RigCurves, given: Mapping[int, Float64] | None = None) -> ShapeFit:
        """Fit the weights of every frame.

        Parameters
        ----------
        raw : RigCurves
            Raw curves.
        given : mapping of int to array [shape=(T,)], optional
            Weights by column that are known already; with some of them, lips close.
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
        weights, missed, replaced = fit_shapes(left, free, self.visemes, bare, closes)
        weights = weights + held
        if self.closing is not None:
            close_lips(weights, moved, self.closing, bare, self.close_gain)
        if closes:
            missed[:, together] = 0.0
        return _described(self, weights, moved, missed, replaced)

    def mapping(self) -> dict[str, dict[str, float]]:
        """Return the raw curves of each shape by name; empty for shapes of unknown name."""
        bare = bare_names()
        return {
            name: {bare[i]: round(float(pose[i]), 4) for i in np.flatnonzero(pose)}
            for name, pose in zip(self.names, self.poses, strict=True)
        }


def _described(
    shapes: ShapePoses,
    weights: Float64,
    moved: Float64,
    missed: Float64,
    replaced: Bool,
) -> ShapeFit:
    total = float(np.square(moved).sum())
    lost = min(1.0, float(np.sqrt(np.square(missed).sum() / total))) if total else 0.0
    amount = np.abs(moved).sum(axis=0)
    order = [i for i in np.argsort(-amount) if amount[i] > 1e-3 * max(1.0, amount.sum())]
    bare, covered = bare_names(), np.asarray(shapes.poses.any(axis=0))
    unsaid = [bare[i] for i in order if missed[:, i].any() and not covered[i]]
    similar = tuple(bare[i] for i in order if replaced[i])
    return ShapeFit(shapes.names, weights.astype(np.float32), lost, tuple(unsaid), similar)


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
    for row in _table():
        if row["set"] == avatar:
            is_sided = "@" in row["name"] or "$" in row["name"]
            for side, word in (("L", "Left"), ("R", "Right")) if is_sided else (("", ""),):
                name = row["name"].replace("@", side).replace("$", word)
                rows.append((name, row["pose"].replace("@", side)))
    return tuple(rows)


@cache
def _table() -> list[dict[str, str]]:
    with resources.files("rig.conversion").joinpath("avatars.csv").open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


AVATARS = tuple(dict.fromkeys(row["set"] for row in _table()))
"""Sets of the table."""

# Names of blendshapes to poses of raw curves, and raw curves to weights of the shapes.
#
# The one matcher of `deitalk retarget`, of `rig.conversion.avatars` (files, Live Link, VMC) and of
# the add-on for Blender, which has the text of this file: numpy and the standard library only.
#
# Letters of shapes: T frames, K shapes, R raw curves (251).


SWEEPS = 60
SETTLED = 1e-4
VISEME_DAMPING = 0.05
"""Share of a viseme's own size added to its diagonal: visemes overlap, and the fit stays one."""
STAND_INS = {
    "mouthSharpCornerPull": {"mouthCornerPull": 0.6, "mouthDimple": 0.5},
    "mouthStretchLipsClose": {"mouthStretch": 1.0},
    "mouthLowerLipBite": {"mouthLowerLipRollIn": 0.8},
    "mouthUpperLipBite": {"mouthUpperLipRollIn": 0.8},
    "mouthLowerLipTowardsTeeth": {"mouthLowerLipRollIn": 0.4},
    "mouthUpperLipTowardsTeeth": {"mouthUpperLipRollIn": 0.4},
    "mouthLipsPress": {"mouthPressU": 0.5, "mouthPressD": 0.5},
    "mouthLipsTightenU": {"mouthPressU": 0.5},
    "mouthLipsTightenD": {"mouthPressD": 0.5},
    "mouthLipsTowardsU": {"mouthLipsPurseU": 0.3},
    "mouthLipsTowardsD": {"mouthLipsPurseD": 0.3},
    "mouthCornerUp": {"mouthCornerPull": 0.3},
    "mouthCornerDown": {"mouthCornerDepress": 0.3},
    "mouthCornerWide": {"mouthStretch": 0.3},
    "mouthCornerNarrow": {"mouthLipsPurseU": 0.2, "mouthLipsPurseD": 0.2},
    "mouthUp": {"jawChinRaiseUL": 0.4, "jawChinRaiseUR": 0.4},
    "mouthDown": {"mouthLowerLipDepressL": 0.3, "mouthLowerLipDepressR": 0.3},
    "jawOpenExtreme": {"jawOpen": 0.3},
    "eyeLidPress": {"eyeSquintInner": 0.5},
    "eyeFaceScrunch": {"eyeSquintInner": 0.7, "eyeCheekRaise": 0.7, "noseWrinkle": 0.3},
    "eyeRelax": {"eyeBlink": 0.5},
    "eyeUpperLidUp": {"eyeWiden": 1.0},
    "eyeLowerLidUp": {"eyeSquintInner": 0.6},
    "browLateral": {"browDown": 0.3},
    "noseNasolabialDeepen": {"noseWrinkle": 0.4, "mouthUpperLipRaise": 0.2},
    "mouthLipsBlow": {"mouthCheekBlow": 0.3},
}
"""Raw curves (side letter left out) that few shape sets have, and substitutes for them.

Our judgement after the muscles they share; used only where no shape of the set has the curve."""


def shape_key(name: str) -> str:
    """Bring spellings of one shape together: lower case, the side as a last ``_l`` or ``_r``.

    What comes before the last ``.``, ``:``, ``|``, ``/`` or ``__`` does not count, nor do the
    prefixes of MetaHuman (``CTRL_expressions_``), Daz (``facs_bs_`` and ``_div2``) and what VRoid
    puts before ``Fcl_``. Letters of any script are kept.
    """
    bare = re.split(r"[.:|/](?!t[xyz]$)|__", name)[-1]
    bare = re.sub(r"^CTRL_expressions_|^facs_[a-z]+_|^.*(?=Fcl_)|_div2$", "", bare, flags=re.I)
    bare = re.sub(r"^CTRL_([LRC])_(.+)$", r"board_\2_\1", bare)
    bare = re.sub(r"_?(?:Left|left|LEFT|_[Ll])$", "_l", bare)
    bare = re.sub(r"_?(?:Right|right|RIGHT|_[Rr])$", "_r", bare)
    bare = re.sub(r"(?<=[a-zUD])L$", "_l", bare)
    bare = re.sub(r"(?<=[a-zUD])R$", "_r", bare)
    side = bare[-2:] if bare[-2:] in ("_l", "_r") else ""
    stem = bare[: len(bare) - len(side)]
    # jawLeft, mouthRight and lookLeft are directions, not sides.
    if stem.lower() in ("jaw", "mouth", "look"):
        return stem.lower() + {"_l": "left", "_r": "right", "": ""}[side]
    return re.sub(r"[\W_]", "", stem.lower()) + side


def pose_of(key: str, known: dict[str, Any], raw_names: list[str]) -> Any:
    """Pose [shape=(R,)] of a key; half or both sides of one that is known so; else zeros."""
    key = key.replace("pupildilate", "eyepupilwide")  # ICT-FaceKit's word
    if key in known:
        return known[key]
    stem, side = (key[:-2], key[-2:]) if key.endswith(("_l", "_r")) else (key, "")
    if side and stem in known:
        ends_so = np.array([name.endswith(side[1].upper()) for name in raw_names])
        return np.where(ends_so, known[stem], 0.0)
    if not side and f"{key}_l" in known and f"{key}_r" in known:
        return known[f"{key}_l"] + known[f"{key}_r"]
    return np.zeros(len(raw_names))


def fit_shapes(moved: Any, poses: Any, visemes: Any, raw_names: list[str], closes: bool) -> Any:
    """Weights in [0, 1] of shapes whose poses add up nearest to raw curves, frame by frame.

    Visemes rest where the set has the jaw and the rounding of the lips as shapes of their own.
    Where no shape holds the lips together over an open jaw, the jaw opens by what the lips leave.

    Parameters
    ----------
    moved : array [shape=(T, R)]
        Raw curves, less their values at rest.
    poses : array [shape=(K, R)]
        Change of the raw curves at weight 1.
    visemes : array of bool [shape=(K,)]
        Shapes that are whole mouths.
    raw_names : list of str [R]
        Without the prefix.
    closes : bool
        Whether the set has a corrective of its own that closes the lips.

    Returns
    -------
    weights : array [shape=(T, K)]
    missed : array [shape=(T, R)]
        Movement that is not shown.
    replaced : array of bool [shape=(R,)]
        Curves that only a similar shape shows.
    """
    place = {name: i for i, name in enumerate(raw_names)}
    poses = np.where(visemes[:, None] & _has_mouth(poses[~visemes], place), 0.0, poses)
    covered = poses.any(axis=0)
    target, replaced = _stood_in(moved, covered, place)
    together = [i for name, i in place.items() if name.startswith("mouthLipsTogether")]
    jaw = place["jawOpen"]
    shuts = not closes and not poses[~visemes][:, together].any()
    if shuts:
        target[:, jaw] *= 1 - np.clip(moved[:, together].mean(axis=1), 0, 1)
    weights = bounded_fit(target, poses, np.where(visemes, VISEME_DAMPING, 0.0))
    missed = np.where(covered, target - weights @ poses, moved)
    if shuts:
        missed[:, jaw] = moved[:, jaw] - weights @ poses[:, jaw]
        missed[:, [i for i in together if not covered[i]]] = 0.0
    return weights, np.where(replaced, 0.0, missed), replaced


def close_lips(weights: Any, moved: Any, columns: Any, raw_names: list[str], gain: float) -> None:
    """Set the corrective that closes the lips over the open jaw; `columns` are those of both."""
    together = [i for i, name in enumerate(raw_names) if name.startswith("mouthLipsTogether")]
    shut = np.clip(moved[:, together].mean(axis=1), 0, 1)
    weights[:, columns[0]] = gain * shut * weights[:, columns[1]]


def closing_columns(keys: list[str]) -> Any:
    """Columns of the corrective ``mouthClose`` and of the jaw; None if one is missing."""
    wanted = ("mouthclose", "jawopen")
    return [keys.index(key) for key in wanted] if set(wanted) <= set(keys) else None


def _has_mouth(poses: Any, place: dict[str, int]) -> bool:
    """Whether shapes open the jaw and round the lips, each for itself."""
    rounds = [i for name, i in place.items() if re.match("mouth(Funnel|LipsPurse)", name)]
    return bool(poses[:, place["jawOpen"]].any() and poses[:, rounds].any())


def _stood_in(moved: Any, covered: Any, place: dict[str, int]) -> Any:
    """Movement of curves that no shape has put on similar curves that some shape has."""
    target, replaced = np.where(covered, moved, 0.0), np.zeros(len(covered), bool)
    for stem, relatives in STAND_INS.items():
        for side in ("", "L", "R"):
            column = place.get(stem + side)
            if column is None or covered[column]:
                continue
            for relative, share in relatives.items():
                other = place.get(relative + side, place.get(relative))
                if other is not None and covered[other]:
                    target[:, other] += share * moved[:, column]
                    replaced[column] = True
    return target, replaced


def bounded_fit(target: Any, poses: Any, damping: Any = 0.0) -> Any:
    """Weights in [0, 1] minimising |target - weights @ poses| frame by frame [shape=(T, K)].

    Coordinate descent over shapes, all frames at once; shapes that share no curve with another
    are exact after the first step. `damping` [shape=(K,)] adds this share of a shape's own size.
    """
    gram, slope_at_0 = poses @ poses.T, target @ poses.T
    size = np.diag(gram) * (1 + np.asarray(damping))
    weights = np.zeros_like(slope_at_0)
    for _ in range(SWEEPS):
        largest = 0.0
        for k in np.flatnonzero(size > 0):
            others = np.flatnonzero(gram[k])
            slope = slope_at_0[:, k] - weights[:, others] @ gram[others, k]
            slope += weights[:, k] * (gram[k, k] - size[k])
            better = np.clip(weights[:, k] + slope / size[k], 0.0, 1.0)
            largest = max(largest, float(np.abs(better - weights[:, k]).max(initial=0.0)))
            weights[:, k] = better
        if largest < SETTLED:
            break
    return weights
