"""Curves to the weights of a user's blendshapes: by name, then bounded least squares.

Every shape is taken as a pose of the 251 raw MetaHuman curves. Names of ARKit, Live Link Face,
ICT-FaceKit, MetaHuman's raw curves and its board are known in the spellings of exporters;
other names come with a mapping file. The weights in [0, 1] whose poses add up nearest to a frame
are its weights.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from rig.arrays import AnyFloat, Float32, Float64
from rig.controls import DEFAULT_ID, ControlSet, default_controls
from rig.conversion.arkit import arkit_controls, arkit_to_raw
from rig.conversion.convert import convert
from rig.conversion.raw import PREFIX, RAW_ID, board_to_raw, raw_controls
from rig.curves import RigCurves
from rig.errors import ControlError, MeshError
from rig.mesh.shapes import ShapeSet
from rig.retarget.bake import Driver, control_halves, face_correctives

_SWEEPS = 60
_SETTLED = 1e-4

_STAND_INS: dict[str, tuple[tuple[str, float], ...]] = {
    "mouthSharpCornerPull": (("mouthCornerPull", 0.6), ("mouthDimple", 0.5)),
    "mouthStretchLipsClose": (("mouthStretch", 1.0),),
    "mouthLowerLipBite": (("mouthLowerLipRollIn", 0.8),),
    "mouthUpperLipBite": (("mouthUpperLipRollIn", 0.8),),
    "mouthLipsPress": (("mouthPressU", 0.5), ("mouthPressD", 0.5)),
    "mouthLipsTightenU": (("mouthPressU", 0.5),),
    "mouthLipsTightenD": (("mouthPressD", 0.5),),
    "mouthUp": (("jawChinRaiseUL", 0.4), ("jawChinRaiseUR", 0.4)),
    "mouthDown": (("mouthLowerLipDepressL", 0.3), ("mouthLowerLipDepressR", 0.3)),
    "jawOpenExtreme": (("jawOpen", 0.3),),
    "eyeLidPress": (("eyeSquintInner", 0.5),),
    "eyeFaceScrunch": (("eyeSquintInner", 0.7), ("eyeCheekRaise", 0.7), ("noseWrinkle", 0.3)),
    "eyeRelax": (("eyeBlink", 0.5),),
    "eyeUpperLidUp": (("eyeWiden", 1.0),),
    "eyeLowerLidUp": (("eyeSquintInner", 0.6),),
    "browLateral": (("browDown", 0.3),),
    "noseNasolabialDeepen": (("noseWrinkle", 0.4), ("mouthUpperLipRaise", 0.2)),
    "mouthLipsBlow": (("mouthCheekBlow", 0.3),),
}
"""Raw curves (side letter left out) that few shape sets have, and substitutes for them.

Our judgement after the muscles they share; used only where no shape of the set has the curve."""


@dataclass(frozen=True, eq=False)
class BlendshapeFit:
    """Weights of a shape set over time, and the movement that it lacks.

    Parameters
    ----------
    names : tuple of str
        The set's shapes.
    weights : array [shape=(T, K), range 0 to 1]
    lost : float [range 0 to 1]
        Share of the raw curves' movement outside the shapes.
    unsaid : tuple of str
        Raw curves that move in the take and that no shape has, most movement first.
    """

    names: tuple[str, ...]
    weights: Float32
    lost: float
    unsaid: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class ShapePoses:
    """Shapes of a set as raw poses.

    Parameters
    ----------
    names : tuple of str
        All shapes of the set, in its order.
    poses : array [shape=(K, 251)]
        Change of the raw curves at weight 1; zero for unknown shapes.
    mouth_close, jaw_open : int or None
        The corrective that closes the lips over an open jaw, and the jaw.
    close_gain : float [range 0 to 1]
        Weight of `mouth_close` at which the lips just meet over `jaw_open` at 1.
    drivers : mapping of int to Driver
        Shapes of our own export, which are driven and not fitted.
    """

    names: tuple[str, ...]
    poses: Float64
    mouth_close: int | None
    jaw_open: int | None
    close_gain: float = 1.0
    drivers: Mapping[int, Driver] = field(default_factory=dict)

    @property
    def understood(self) -> tuple[str, ...]:
        """Names with a known meaning."""
        moving = np.asarray(self.poses.any(axis=1))
        driven = {*self.drivers, *arkit_halves(self.names), self.mouth_close}
        return tuple(n for i, n in enumerate(self.names) if moving[i] or i in driven)

    def weights(self, curves: RigCurves) -> BlendshapeFit:
        """Fit the weights of every frame.

        Parameters
        ----------
        curves : RigCurves
            Board, raw or ARKit curves.

        Returns
        -------
        BlendshapeFit
        """
        raw = convert(curves, RAW_ID).reorder(raw_controls())
        moved = raw.values.astype(np.float64) - raw_controls().rest
        covered = np.asarray(self.poses.any(axis=0))
        weights = self._fitted(_stand_in(moved, covered), curves)
        missed = moved - weights @ self.poses
        together = _columns("mouthLipsTogether")
        if self.mouth_close is not None and self.jaw_open is not None:
            jaw = weights[:, self.jaw_open]
            closing = np.clip(moved[:, together].mean(axis=1), 0, 1)
            weights[:, self.mouth_close] = self.close_gain * closing * jaw
        if self._closes_lips:
            missed[:, together] = 0.0
            covered[together] = True
        for half, driving in arkit_halves(self.names).items():
            weights[:, half] = half_weight([weights[:, k] for k in driving])
        total = float(np.square(moved).sum())
        lost = min(1.0, float(np.sqrt(np.square(missed).sum() / total))) if total else 0.0
        amount = np.where(covered, 0.0, np.abs(moved).sum(axis=0))
        order = [i for i in np.argsort(-amount) if amount[i] > 1e-3 * max(1.0, amount.sum())]
        bare = tuple(raw.names[i].removeprefix(PREFIX) for i in order)
        return BlendshapeFit(self.names, weights.astype(np.float32), lost, bare)

    @property
    def _closes_lips(self) -> bool:
        """Whether correctives reproduce the lips-together curves."""
        of_arkit = self.mouth_close is not None and self.jaw_open is not None
        return of_arkit or any(len(driver.groups) > 1 for driver in self.drivers.values())

    def _fitted(self, moved: Float64, curves: RigCurves) -> Float64:
        """Weights of all shapes: driven where there is a driver, else fitted to the remainder."""
        if not self.drivers:
            return _bounded_fit(moved, self.poses)
        driven = np.zeros((len(moved), len(self.names)))
        for k, weight in driver_weights(self.drivers, curves).items():
            driven[:, k] = weight
        free = self.poses.copy()
        free[list(self.drivers)] = 0.0
        return driven + _bounded_fit(moved - driven @ self.poses, free)


def match_shapes(
    names: Sequence[str],
    *,
    mapping: Mapping[str, Mapping[str, float]] | None = None,
    shapes: ShapeSet | None = None,
) -> ShapePoses:
    """Interpret the names of a blendshape set.

    Parameters
    ----------
    names : sequence of str
        Shape names as exported; prefixes up to the last ``.``, ``:`` or ``|`` do not count,
        ``_L``, ``Left`` and ``left`` are the same.
    mapping : mapping of str to mapping of str to float, optional
        Own shapes: the controls (board, raw or ARKit names) each stands for, and their values.
        Comes before the known names.
    shapes : ShapeSet, optional
        The geometry, from which the weight of `mouthClose` that just closes the lips is measured.

    Raises
    ------
    MeshError
        If no name is known, or the mapping names a shape that the set has not.
    ControlError
        If the mapping names an unknown control.
    """
    own = dict(mapping or {})
    missing = [name for name in own if name not in names]
    if missing:
        raise MeshError(f"the mapping names shape {missing[0]!r}, which the mesh does not have")
    drivers = own_drivers(["" if name in own else name for name in names])
    poses = driver_poses(drivers, len(names))
    keys = [shape_key(name) for name in names]
    for i, (name, key) in enumerate(zip(names, keys, strict=True)):
        if i not in drivers:
            poses[i] = _own_pose(own[name]) if name in own else _known_pose(key)
    close = keys.index("mouthclose") if "mouthclose" in keys else None
    jaw = keys.index("jawopen") if "jawopen" in keys else None
    if not poses.any():
        raise MeshError(
            f"none of the shapes ({', '.join(names[:6])} ...) has a known name; "
            "give a mapping file with rows shape,control,value"
        )
    gain = 1.0
    if shapes is not None and close is not None and jaw is not None:
        gain = closing_weight(shapes, names[jaw], names[close])
    return ShapePoses(tuple(names), poses, close, jaw, gain, drivers)


def shape_key(name: str) -> str:
    """Bring spellings of one shape together: lower case, the side as a last ``_l`` or ``_r``.

    What comes before the last ``.``, ``:``, ``|`` or ``__`` does not count, nor does
    ``CTRL_expressions_``. The add-on for Blender has the text of this function.
    """
    bare = re.split(r"[.:|](?!t[xyz]$)|__", name)[-1]
    bare = re.sub(r"^CTRL_expressions_", "", bare, flags=re.IGNORECASE)
    bare = re.sub(r"^CTRL_([LRC])_(.+)$", r"board_\2_\1", bare)
    bare = re.sub(r"_?(?:Left|left|LEFT|_[Ll])$", "_l", bare)
    bare = re.sub(r"_?(?:Right|right|RIGHT|_[Rr])$", "_r", bare)
    bare = re.sub(r"(?<=[a-zUD])L$", "_l", bare)
    bare = re.sub(r"(?<=[a-zUD])R$", "_r", bare)
    side = bare[-2:] if bare[-2:] in ("_l", "_r") else ""
    stem = bare[: len(bare) - len(side)]
    # jawLeft and mouthRight are directions, not sides.
    if stem.lower() in ("jaw", "mouth"):
        return stem.lower() + {"_l": "left", "_r": "right", "": ""}[side]
    return re.sub(r"[^a-z0-9]", "", stem.lower()) + side


def closing_weight(shapes: ShapeSet, jaw_open: str, mouth_close: str) -> float:
    """Weight of the closing corrective at which the lips meet as in the neutral face.

    Pairs across the slit are vertices close together that the jaw parts and the corrective
    brings together; the weight is the median over the pairs. (ICT's corrective at 1 overlaps
    the lips by 5 mm.) 1 if there are no such pairs.
    """
    jaw, close = shapes.delta(jaw_open), shapes.delta(mouth_close)
    rest, size = shapes.neutral.vertices, shapes.neutral.size
    motion = np.linalg.norm(jaw, axis=1)
    moved = np.flatnonzero(motion > 0.5 * motion.max())
    still = np.flatnonzero(motion < 0.3 * motion.max())
    if motion.max() == 0 or len(moved) == 0 or len(still) == 0:
        return 1.0
    found = KDTree(rest[still]).query(rest[moved])
    distance, nearest = np.asarray(found[0]), np.asarray(found[1], dtype=np.int64)
    near = distance < 0.02 * size
    low, high = moved[near], still[nearest[near]]
    torn, closed = jaw[low] - jaw[high], close[low] - close[high]
    strength = np.einsum("pc,pc->p", torn, torn)
    back = -np.einsum("pc,pc->p", closed, torn)
    useful = back > 0.3 * strength
    if useful.sum() < 4:
        return 1.0
    return float(np.clip(np.median(strength[useful] / back[useful]), 0.0, 1.0))


def _known_pose(key: str) -> Float64:
    """Pose of a known name; half or both sides of it where only those are known; else zeros."""
    known = _known_poses()
    key = key.replace("pupildilate", "eyepupilwide")  # ICT-FaceKit's word
    if key in known:
        return known[key]
    stem, side = (key[:-2], key[-2:]) if key.endswith(("_l", "_r")) else (key, "")
    if side and stem in known:
        ends_so = np.array([n.endswith(side[1].upper()) for n in raw_controls().names])
        return np.where(ends_so, known[stem], 0.0)
    if not side and f"{key}_l" in known and f"{key}_r" in known:
        return known[f"{key}_l"] + known[f"{key}_r"]
    return np.zeros(len(raw_controls()))


@cache
def _known_poses() -> dict[str, Float64]:
    known: dict[str, Float64] = {}
    for controls, to_raw in (
        (default_controls(), board_to_raw),
        (arkit_controls(), arkit_to_raw),
        (raw_controls(), None),
    ):
        values = np.tile(controls.rest, (len(controls), 1))
        values[np.arange(len(controls)), np.arange(len(controls))] = controls.maximum
        curves = RigCurves(values, controls.names, control_set=controls.id)
        raw = curves if to_raw is None else to_raw(curves)
        change = raw.values.astype(np.float64) - raw_controls().rest
        for name, row in zip(controls.names, change, strict=True):
            known[shape_key(name)] = row
            # A control of one axis is also known by its name alone.
            alone = re.sub(r"\.t[xyz]$", "", name)
            if sum(other.startswith(alone + ".") for other in controls.names) == 1:
                known[shape_key(alone)] = row
    return {key: pose for key, pose in known.items() if pose.any()}


def _own_pose(controls: Mapping[str, float]) -> Float64:
    """Raw change for controls given by board, raw or ARKit names."""
    change = np.zeros(len(raw_controls()))
    for name, value in controls.items():
        owner = _owner(name)
        values = owner.rest.copy()[None]
        values[0, owner.index(name)] += value
        raw = convert(RigCurves(values, owner.names, control_set=owner.id), RAW_ID)
        change += raw.reorder(raw_controls()).values[0] - raw_controls().rest
    return change


def _owner(name: str) -> ControlSet:
    for controls in (default_controls(), raw_controls(), arkit_controls()):
        try:
            controls.index(name)
        except ControlError:
            continue
        return controls
    raise ControlError(
        f"the mapping names control {name!r}, which is no board channel, raw curve or ARKit shape"
    )


@cache
def _columns(stem: str) -> NDArray[np.intp]:
    names = raw_controls().names
    return np.flatnonzero(np.array([n.startswith(PREFIX + stem) for n in names]))


def _stand_in(moved: Float64, covered: NDArray[Any]) -> Float64:
    """Move curves that no shape has to similar curves that some shape has."""
    index = {n.removeprefix(PREFIX): i for i, n in enumerate(raw_controls().names)}
    result = np.where(covered, moved, 0.0)
    for stem, relatives in _STAND_INS.items():
        for side in ("", "L", "R"):
            column = index.get(stem + side)
            if column is None or covered[column]:
                continue
            for relative, share in relatives:
                target = index.get(relative + side)
                if target is not None and covered[target]:
                    result[:, target] += share * moved[:, column]
    return result


def _bounded_fit(moved: Float64, poses: Float64) -> Float64:
    """Weights in [0, 1] minimising |moved - weights @ poses| frame by frame [shape=(T, K)].

    Coordinate descent over shapes, all frames at once; shapes that share no curve with another
    are exact after the first step.
    """
    gram, target = poses @ poses.T, moved @ poses.T
    weights = np.zeros_like(target)
    posed = np.flatnonzero(np.diag(gram) > 0)
    for _ in range(_SWEEPS):
        largest = 0.0
        for k in posed:
            others = np.flatnonzero(gram[k])
            slope = target[:, k] - weights[:, others] @ gram[others, k]
            better = np.clip(weights[:, k] + slope / gram[k, k], 0.0, 1.0)
            largest = max(largest, float(np.abs(better - weights[:, k]).max(initial=0.0)))
            weights[:, k] = better
        if largest < _SETTLED:
            break
    return weights


# Correctives of our own exports, recognised by name and driven as the exporters drive them.
#
# ``deitalk face export`` writes ARKit's shapes and halves of some (`ARKIT_HALVES`).
# ``deitalk convert`` to a GLB writes a shape for each half of a board control, named after it, and
# the correctives of `rig.retarget.bake.face_correctives`; each has a `Driver`.


ARKIT_HALVES: Mapping[str, tuple[str, ...]] = {
    "jawOpen_half": ("jawOpen",),
    "eyeBlinkLeft_half": ("eyeBlinkLeft",),
    "eyeBlinkRight_half": ("eyeBlinkRight",),
    "mouthClose_half": ("jawOpen", "mouthClose"),
}
"""Shapes whose least weight drives each half."""


def half_weight(weights: Sequence[AnyFloat]) -> Float64:
    """Weight of a half [shape=(T,), range 0 to 1]: 1 where the least weight is 0.5, 0 at 0 and 1.

    Parameters
    ----------
    weights : sequence of array [shape=(T,), range 0 to 1]
        Of the shapes that drive it.
    """
    least = np.min([np.asarray(weight, np.float64) for weight in weights], axis=0)
    return np.asarray(np.maximum(1 - np.abs(2 * least - 1), 0.0))


def arkit_halves(names: Sequence[str]) -> dict[int, tuple[int, ...]]:
    """Columns of the halves among shape names, and the columns that drive each."""
    place = {name: k for k, name in enumerate(names)}
    return {
        place[half]: tuple(place[name] for name in drivers)
        for half, drivers in ARKIT_HALVES.items()
        if half in place and all(name in place for name in drivers)
    }


def own_drivers(names: Sequence[str]) -> dict[int, Driver]:
    """Drivers by column, if the names are of our own export of the board's shapes; else none.

    The board's names alone are ambiguous: other rigs use them too, and get fitted weights.
    """
    drivers, telling = _drivers()
    if not telling & set(names):
        return {}
    return {k: drivers[name] for k, name in enumerate(names) if name in drivers}


def driver_poses(drivers: Mapping[int, Driver], n_shapes: int) -> Float64:
    """Change of the raw curves at weight 1 [shape=(K, 251)]; zero for correctives."""
    board, rest = default_controls(), raw_controls().rest
    poses = np.zeros((n_shapes, len(raw_controls())))
    halves = {k: d for k, d in drivers.items() if len(d.groups) == 1 and d.peak is None}
    if halves:
        values = np.stack([driver.pose(board) for driver in halves.values()])
        curves = RigCurves(values, board.names, control_set=board.id)
        raw = convert(curves, RAW_ID).reorder(raw_controls())
        poses[list(halves)] = raw.values.astype(np.float64) - rest
    return poses


def driver_weights(drivers: Mapping[int, Driver], curves: RigCurves) -> dict[int, Float64]:
    """Weights by column [each shape=(T,), range 0 to 1] of board, raw or ARKit curves."""
    board = default_controls()
    values = convert(curves, DEFAULT_ID).reorder(board).values
    return {k: driver.weight(values, board) for k, driver in drivers.items()}


@cache
def _drivers() -> tuple[dict[str, Driver], frozenset[str]]:
    """Drivers of all names of our exporter, and the names that only it uses."""
    halves, correctives = dict(control_halves(default_controls())), dict(face_correctives())
    telling = {name for name in halves if name.endswith("_negative")} | set(correctives)
    return halves | correctives, frozenset(telling)
