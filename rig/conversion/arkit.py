"""Raw MetaHuman curves to the shapes of Apple ARKit, and back.

Unreal's own pose asset holds the raw curves that each of 51 ARKit shapes moves (``arkit.csv``: its
weights, without those below 0.04; the 5.7 asset agrees within 0.02). Back from raw
curves to shapes is a least-squares fit with weights in [0, 1].

**The ARKit file is a lossy preview.** 76 of the 251 raw curves move under no shape at all, and in
Epic's own captures about 45 % of the deformation cannot be expressed by the shapes. The residual
of the fit is reported per frame and summed.

``MouthClose`` has no pose. Unreal's face blueprint sets the four lips-together curves to
clamp(MouthClose / JawOpen, 0, 1); we use the same rule, both ways. So MouthClose never exceeds
JawOpen: lips meet and do not cross. ``TongueOut`` is no more than the tongue is out: one that moves
within the mouth has none.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from rig.arrays import Float32
from rig.controls import DEFAULT_ID, Control, ControlSet
from rig.conversion.raw import PREFIX, RAW_ID, board_to_raw, raw_controls
from rig.curves import RigCurves
from rig.files.reading import rows_of

ARKIT_ID = "arkit-61"
N_SHAPES = 52
"""Number of ARKit's shapes; its other controls are angles, which few files have."""
HEAD = ("HeadYaw", "HeadPitch", "HeadRoll")
ROTATION_LIMIT = 3.2
"""Rotations are radians, within half a turn."""
HEAD_DEGREES = (-50.0, 50.0, 50.0)
"""Turn of the head for a value of 1 in Unreal's face blueprint, degrees of a head track: its
animation turns by 50 times a value, the yaw negated, so that a value is nearly one radian."""
GAZE_SIDE_DEGREES, GAZE_UP_DEGREES, GAZE_DOWN_DEGREES = 40.0, 30.0, 40.0
"""Turn of an eye for a raw look curve at 1 (mh4 rig)."""
LIPS_TOGETHER = tuple(f"{PREFIX}mouthLipsTogether{half}" for half in ("UL", "UR", "DL", "DR"))
FRAMES_AT_ONCE = 8192
"""Frames fitted at once, so that an hour fits."""
SMALLEST_JAW = 1e-4
"""JawOpen below which MouthClose / JawOpen is taken as 0, as Unreal's safe division does."""
MAX_SWEEPS = 60
"""Most sweeps of coordinate descent; the worst group (Pucker, Funnel) gains a factor 3 in each."""


@dataclass(frozen=True, eq=False)
class ArkitFit:
    """ARKit shapes fitted to raw curves, and the residual.

    Parameters
    ----------
    curves : RigCurves
        Of `arkit_controls`.
    residual : array [shape=(T,), >= 0]
        Distance between the raw curves and those of the shapes, per frame.
    lost : float [range 0 to 1]
        Share of the movement that the shapes do not reproduce, over all frames: the root
        of the ratio of the summed squares.
    """

    curves: RigCurves
    residual: Float32
    lost: float

    def __str__(self) -> str:
        return (
            f"ARKit is a lossy preview: {self.lost:.0%} of the movement cannot be shown by its 52 "
            "shapes (root mean square over the 251 raw curves)"
        )


@cache
def arkit_controls() -> ControlSet:
    """Return the 52 shapes and 9 rotations in the order of a Live Link Face CSV, ``arkit-61``.

    Other programs' spellings resolve too: ``eyeBlinkLeft``, ``eyeBlink_L``, ``eye_blink_left`` …
    """
    controls = []
    for row in rows_of("conversion/arkit.csv"):
        is_shape = row["kind"] == "blendshape"
        low, high = (0.0, 1.0) if is_shape else (-ROTATION_LIMIT, ROTATION_LIMIT)
        controls.append(Control(row["name"], low, high, aliases=_spellings(row["name"])))
    return ControlSet(ARKIT_ID, tuple(controls))


def _spellings(name: str) -> tuple[str, ...]:
    """Spellings of a name of the app: Apple's, with ``_L``, with underscores, all small, spaced.

    ``JawLeft`` and ``MouthLeft`` are directions: they keep their last word.
    """
    words = re.findall("[A-Z][a-z]*", name)
    camel = words[0].lower() + "".join(words[1:])
    found = [camel, "_".join(words), "_".join(words).lower(), "_".join(words).upper()]
    found += [camel.lower(), camel.upper(), " ".join(words), " ".join(words).lower()]
    if words[-1] in ("Left", "Right") and len(words) > 2:
        letter = words[-1][0]
        for stem in (camel[: -len(words[-1])], "".join(words[:-1]), "_".join(words[:-1]).lower()):
            found += [f"{stem}_{side}" for side in (letter, letter.lower(), words[-1])]
            found += [f"{stem}.{letter}", f"{stem}{letter}", f"{stem}_{words[-1].lower()}"]
    return tuple(dict.fromkeys(spelling for spelling in found if spelling != name))


@cache
def apple_names() -> tuple[str, ...]:
    """Return the 52 shapes as Apple spells them, ``eyeBlinkLeft``."""
    return tuple(name[0].lower() + name[1:] for name in arkit_controls().names[:N_SHAPES])


@cache
def udp_order() -> NDArray[np.intp]:
    """Return the CSV columns in the order of a Live Link Face packet [shape=(61,)]."""
    return np.argsort([int(row["udp_index"]) for row in rows_of("conversion/arkit.csv")])


def arkit_to_raw(curves: RigCurves, *, least_jaw: float = 0.0) -> RigCurves:
    """Convert ARKit shapes to raw curves as Unreal does: sum of poses, clamped to [0, 1].

    Head and eye rotations move no raw curve: the head's become the head track, the look shapes
    carry the gaze.

    Parameters
    ----------
    curves : RigCurves
        ARKit shapes.
    least_jaw : float [range 0 to 1]
        JawOpen at which lips-together is half of MouthClose / JawOpen. A closed mouth has both
        near 0, and their ratio is then noise: 1 or more in 60 % of the frames of a face at rest.
        With 0, Unreal's rule.

    Raises
    ------
    ControlError
        If a curve is no ARKit shape.
    """
    shapes = curves.reorder(arkit_controls())
    raw = raw_controls()
    values = shapes.values @ _poses() + raw.rest
    together = lips_together(shapes["MouthClose"], shapes["JawOpen"], least_jaw)
    values[:, raw.indices(LIPS_TOGETHER)] = together[:, None]
    values = np.clip(values, 0, 1)
    # The head track of curves, or that of their rotations, if the head turns at all.
    turns = shapes.values[:, arkit_controls().indices(HEAD)]
    if shapes.head is not None or not turns.any():
        head = shapes.head
    else:
        head = np.pad(turns * np.array(HEAD_DEGREES, np.float32), ((0, 0), (0, 3)))
    return replace(shapes, values=values, names=raw.names, control_set=RAW_ID, head=head)


def lips_together(close: Float32, jaw: Float32, least_jaw: float = 0.0) -> Float32:
    """Values [shape=(T,), range 0 to 1] of `LIPS_TOGETHER` for a closing shape over an open jaw."""
    held = np.maximum(jaw, SMALLEST_JAW)
    share = close / held / (1 + (least_jaw / held) ** 2)
    return np.clip(np.where(jaw > SMALLEST_JAW, share, 0), 0, 1)


def raw_curves_of_shapes(names: Iterable[str]) -> set[str]:
    """Return the raw curves that some shapes move; lips-together needs MouthClose and JawOpen."""
    arkit, raw = arkit_controls(), raw_controls()
    shapes = set(names)
    moved = (_poses()[arkit.indices(shapes)] != 0).any(axis=0)
    together = LIPS_TOGETHER if {"MouthClose", "JawOpen"} <= shapes else ()
    return {raw.names[i] for i in np.flatnonzero(moved)} | set(together)


def raw_to_arkit(curves: RigCurves) -> ArkitFit:
    """Fit ARKit shapes to raw curves; the head track becomes the head's rotations.

    Parameters
    ----------
    curves : RigCurves
        Raw curves, or those of the board; those that are absent rest.

    Returns
    -------
    ArkitFit

    Raises
    ------
    ControlError
        If a curve is neither.
    """
    rest, arkit = raw_controls().rest, arkit_controls()
    shapes, missed, total = [], [], 0.0
    for first in range(0, max(len(curves), 1), FRAMES_AT_ONCE):
        part = curves.slice_frames(first, first + FRAMES_AT_ONCE)
        part = board_to_raw(part) if part.control_set == DEFAULT_ID else part
        raw = part.reorder(raw_controls())
        shapes.append(_shapes(raw))
        fitted = replace(raw, values=shapes[-1], names=arkit.names, control_set=ARKIT_ID)
        found = arkit_to_raw(fitted).values
        missed.append(np.linalg.norm(found - raw.values, axis=1))
        total += float(np.square(raw.values - rest, dtype=np.float64).sum())
    residual = np.concatenate(missed)
    lost = float(np.sqrt(np.square(residual, dtype=np.float64).sum() / total)) if total else 0.0
    values = np.concatenate(shapes)
    whole = replace(curves, values=values, names=arkit.names, control_set=ARKIT_ID)
    return ArkitFit(whole, residual, min(lost, 1.0))


def _shapes(raw: RigCurves) -> Float32:
    """Values of the shapes fitted to all raw curves [shape=(T, 61)]."""
    arkit = arkit_controls()
    # Return weights in [0, 1] that best fit the poses [shape=(T, 61)].
    # A raw curve at 1 may have been clamped, so the fit is to the clamped sum.
    moved = raw.values - raw_controls().rest
    poses = _poses()
    values = np.zeros((len(moved), len(poses)), np.float32)
    for shapes in _groups():
        columns = np.flatnonzero(poses[shapes].any(axis=0))
        values[:, shapes] = _fit_group(moved[:, columns], poses[shapes][:, columns])
    jaw = values[:, arkit.index("JawOpen")]
    together = np.stack([raw[name] for name in LIPS_TOGETHER], axis=1).mean(axis=1)
    values[:, arkit.index("MouthClose")] = np.where(jaw > SMALLEST_JAW, together * jaw, 0)
    tongue = arkit.index("TongueOut")
    out = raw[PREFIX + "tongueOut"] / poses[tongue, raw_controls().index(PREFIX + "tongueOut")]
    values[:, tongue] = np.minimum(values[:, tongue], out)
    _turn_eyes(values, raw)
    if raw.head is not None:
        values[:, arkit.indices(HEAD)] = head_values(raw.head)
    return values


def head_values(track: Float32) -> Float32:
    """Values of `HEAD` (T, 3) for a head track (T, 6)."""
    values: Float32 = (track[:, : len(HEAD)] / np.array(HEAD_DEGREES)).astype(np.float32)
    return values


def _fit_group(moved: Float32, poses: Float32) -> Float32:
    """Fit shapes that share raw curves, by coordinate descent; one shape takes one exact step."""
    weights = np.zeros((len(moved), len(poses)), np.float32)
    size = (poses * poses).sum(axis=1)
    is_clamped = moved >= 1 - 1e-6
    if len(poses) == 1:
        alone: Float32 = np.clip(moved @ poses.T / size, 0, 1)
        return alone
    model = np.zeros_like(moved)
    for _ in range(MAX_SWEEPS):
        change = 0.0
        for j, pose in enumerate(poses):
            missed = np.where(is_clamped, np.maximum(moved - model, 0), moved - model)
            better = np.clip(weights[:, j] + missed @ pose / size[j], 0, 1)
            step = better - weights[:, j]
            weights[:, j] = better
            model += step[:, None] * pose
            change = max(change, float(np.abs(step).max(initial=0)))
        if change < 1e-6:
            break
    return weights


@cache
def _groups() -> list[list[int]]:
    """Return shapes with a pose, those that share raw curves together."""
    moved = (_poses() > 0).astype(np.float32)
    shares = moved @ moved.T > 0
    groups: list[list[int]] = []
    for shape in np.flatnonzero(shares.diagonal()).tolist():
        touching = [g for g in groups if shares[shape, g].any()]
        groups = [g for g in groups if g not in touching]
        groups.append(sorted([shape, *(member for g in touching for member in g)]))
    return groups


def shapes_together(names: Iterable[str]) -> set[str]:
    """Some shapes, and those that share raw curves with them, directly or through others."""
    arkit, found = arkit_controls(), set(names)
    for group in _groups():
        members = {arkit.names[shape] for shape in group}
        found |= members if members & found else set()
    return found | ({"MouthClose", "JawOpen"} if "MouthClose" in found else set())


def _turn_eyes(values: Float32, raw: RigCurves) -> None:
    """Write eye rotations in radians: yaw to the character's right and pitch down are positive."""
    arkit = arkit_controls()
    for side, letter in (("Left", "L"), ("Right", "R")):
        right, up = np.radians(gaze_degrees(raw, letter))
        values[:, arkit.index(f"{side}EyeYaw")] = right
        values[:, arkit.index(f"{side}EyePitch")] = -up


def gaze_degrees(raw: RigCurves, side: str) -> Float32:
    """Turn of an eye (``L`` or ``R``) to the character's right, and up [shape=(2, T)]."""
    up, down, left, right = (
        raw[f"{PREFIX}eyeLook{way}{side}"] for way in ("Up", "Down", "Left", "Right")
    )
    turned = GAZE_SIDE_DEGREES * (right - left), GAZE_UP_DEGREES * up - GAZE_DOWN_DEGREES * down
    return np.stack(turned)


@cache
def _poses() -> Float32:
    """Return the raw curves that each shape moves [shape=(61, 251)]."""
    raw = raw_controls()
    table = rows_of("conversion/arkit.csv")
    poses = np.zeros((len(table), len(raw)), np.float32)
    for i, row in enumerate(table):
        for term in filter(None, row["pose"].split("|")):
            name, weight = term.split(":")
            poses[i, raw.index(name)] = float(weight)
    return poses
