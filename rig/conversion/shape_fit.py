"""Names of blendshapes to poses of raw curves, and raw curves to weights of the shapes.

The one matcher of `deitalk retarget`, of `rig.conversion.avatars` (files, Live Link, VMC) and of
the add-on for Blender, which has the text of this file: numpy and the standard library only.

Letters of shapes: T frames, K shapes, R raw curves (251).
"""

import re
from typing import Any

import numpy as np

SWEEPS = 60
SETTLED = 1e-4
LEAST_INDEPENDENT = 1e-3
"""Share of the largest singular value of poses below which they count as the same."""
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


def fit_shapes(
    moved: Any, poses: Any, visemes: Any, raw_names: list[str], closes: bool, linear: bool = False
) -> Any:
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
    linear : bool
        Whether weights may leave [0, 1], so that those of two poses add up.

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
    if linear and not poses[visemes].any():
        weights = target @ np.linalg.pinv(poses, rcond=LEAST_INDEPENDENT)
    else:
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
