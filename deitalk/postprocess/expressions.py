"""Expressions after the network: what an emotion adds to the neutral reading, by a table.

The network was taught poses of the five emotions; on renders they were too faint or ambiguous:
anger with drowsy lids, joy without cheeks and teeth. ``expressions.csv`` has, by emotion and
control, a gain on the network's difference of the readings and a pose in units of the control at
intensity 1, with the action unit (Ekman, Friesen and Hager 2002). Both grow in proportion to the
intensity. Sizes follow what acted faces do against the same actor's neutral face, and how raw
controls move together in a MetaHuman take ("the take": the slope of one control on another).

Moods are procedural: the network reads their mixture of the trained emotions
(`rig.emotions.MOODS`) and the table adds the prototype of their action units; contempt is of one
side.

``taught_poses.csv`` has the poses of the five at intensity 1 that networks are taught as in the
training corpus, with the action unit. They complete the difference of its readings where that is
faint, as in silence.

Rows with a variant are what it differs by from its emotion: a factor on the emotion's gains, and
what is added to its poses. Its rows ``upper`` and ``lower`` are factors on all that it shows of
brows, eyes and nose, and of the rest: with them it is about as large as its emotion's own pose, so
that a strong take is not smaller than a weak one for its variant; in sadness, whose strong takes
were, the variant of strong voices is larger than that of weak ones. Weights are those of
`deitalk.postprocess.variants`.

A smile yields to rounding: spread corners and a raised upper lip are muscles that act against
those of /u/ and /o/.

Letters: S rows, K controls of the table.
"""

from collections.abc import Collection
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deitalk.emotions import EMOTIONS, LABELS, MOODS
from deitalk.emotions.variants import EMOTION_OF
from rig.arrays import Bool, Float32
from rig.files.reading import rows_of

SPREADING = ("cornerPull", "CornerPull", "stretch", "dimple", "corner.", "upperLipRaise")
"""Parts of the names of the controls whose expression yields to rounding."""
UPPER = ("brow", "eye", "nose")
"""Parts of the names of the controls of the upper face."""
PARTING = ("jaw.ty", "lowerLipDepress", "upperLipRaise")
"""Parts of the names of the controls whose poses yield to closed lips. Corners of a trained emotion
yield too; those of a mood, up to .8 of a range, would jump at every closure."""


@dataclass(frozen=True)
class ExpressionTable:
    """Gains and poses of the emotions, and what their variants add, for the controls of one rig.

    Attributes
    ----------
    places : array [shape=(K,)]
        Columns of the controls.
    gains, poses, parting : array [shape=(S, K)]
        Factor on the difference of the readings, what is added to it at intensity 1, and what is
        added as far as the lips are open. Rows: the emotions; their variants, which are added
        to them; then of all these what the left side does more than the right one.
    spreading : array [shape=(K,), 0 or 1]
        Whether a control yields to rounding.
    taught : array [shape=(9, K)]
        Difference of the readings that a network is taught, at intensity 1.
    changed : array [shape=(9,), 0 or 1]
        0 of emotions that stay as captures show them.
    is_mood : array of bool [shape=(S,)]
        Whether a row is of a procedural emotion.
    """

    places: NDArray[np.intp]
    gains: Float32
    poses: Float32
    parting: Float32
    spreading: Float32
    taught: Float32
    changed: Float32
    is_mood: Bool


@lru_cache(maxsize=8)
def expression_table(names: tuple[str, ...], captured: Collection[str] = ()) -> ExpressionTable:
    """The table for the columns of a rig; controls that it lacks are left out.

    Emotions that captures show have a gain of 1 and no pose.
    """
    folder = Path(__file__).parent
    content = list(rows_of(folder / "expressions.csv"))
    rows = [
        (row["emotion"], row["variant"], name, float(row["gain"]), float(row["pose"]))
        for row in content
        for name in (row["control"].replace("*", side) for side in "LR")
        if name in names
    ]
    learnt = taught_poses(names)
    named = {name for row in rows for name in (row[2], _mirrored(row[2])) if name in names}
    moved = sorted(named | learnt.keys(), key=names.index)
    taught = np.zeros((len(LABELS), len(moved)), np.float32)
    for name, sizes in learnt.items():
        taught[:, moved.index(name)] = [
            sum(share * sizes[one] for one, share in MOODS.get(label, {label: 1.0}).items())
            for label in LABELS
        ]
    own = [*LABELS, *EMOTION_OF.values()]  # emotion of each row of the table
    places = [*LABELS, *EMOTION_OF]
    gains, poses = np.zeros((2, len(own), len(moved)), np.float32)
    gains[: len(LABELS)] = 1
    parting = np.zeros_like(gains)
    for emotion, variant, name, gain, pose in rows:  # those of an emotion before its variants
        column = moved.index(name)
        place, base = places.index(variant or emotion), gains[LABELS.index(emotion), column]
        yielding = PARTING + (SPREADING if emotion in EMOTIONS else ())
        gains[place, column] = (gain - 1) * base if variant else gain
        (parting if any(part in name for part in yielding) else poses)[place, column] = pose
    is_upper = np.array([any(part in name for part in UPPER) for name in moved], bool)
    for row in content:
        if row["control"] in ("upper", "lower"):
            columns = is_upper == (row["control"] == "upper")
            base, place = LABELS.index(row["emotion"]), places.index(row["variant"])
            for values in (gains, poses, parting):
                whole = float(row["gain"]) * (values[base] + values[place])
                values[place, columns] = (whole - values[base])[columns]
    changed = np.array([label not in captured for label in own], np.float32)[:, None]
    gains *= changed
    gains[: len(LABELS)] += 1 - changed[: len(LABELS)]
    mirrored = [moved.index(n if (n := _mirrored(name)) in moved else name) for name in moved]

    def both(rows: Float32) -> Float32:
        other = rows[:, mirrored]
        halves: Float32 = np.concatenate((rows + other, rows - other)) * np.float32(0.5)
        return halves

    return ExpressionTable(
        np.array([names.index(name) for name in moved], np.intp),
        both(gains),
        both(changed * poses),
        both(changed * parting),
        np.array([any(part in name for part in SPREADING) for name in moved], np.float32),
        changed[: len(LABELS)] * taught,
        changed[: len(LABELS), 0],
        np.array([label not in EMOTIONS for label in 2 * own]),
    )


def taught_poses(names: tuple[str, ...]) -> dict[str, dict[str, float]]:
    """Size of each emotion's pose at intensity 1, by control of a rig and by emotion."""
    return {
        name: {emotion: float(row.get(emotion) or 0) for emotion in EMOTIONS}
        for row in rows_of(Path(__file__).with_name("taught_poses.csv"))
        for name in dict.fromkeys(row["control"].replace("*", side) for side in "LR")
        if name in names
    }


def _mirrored(name: str) -> str:
    """Name of the control of the other side; of the middle the same."""
    for side, other in ("LR", "RL"):
        if name.startswith(f"CTRL_{side}_"):
            return f"CTRL_{other}_{name.removeprefix(f'CTRL_{side}_')}"
    return name
