"""Left and right of the mouth: no face speaks or smiles evenly.

Speech leans to the character's side, an expression further, and from event to event with the brows.
`LEANS` are of the size of six Live Link takes, medians of the difference of the sides over their
mean: smiles .03 to .20, corners pulled down .09 to .46, stretch .02 to .31, parted lips .01 to .08;
a character's `side` is .10 to .15.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from rig import ControlSet
from rig.arrays import Float32, Float64

LEANS = {
    "mouth_cornerPull": 0.7,
    "mouth_sharpCornerPull": 0.7,
    "mouth_dimple": 0.7,
    "mouth_cornerDepress": 1.0,
    "mouth_stretch": 0.6,
    "mouth_upperLipRaise": 0.3,
    "mouth_lowerLipDepress": 0.3,
    "nose": 1.0,
    "nose_nasolabialDeepen": 0.8,
}
"""Factor on the character's side, by control; of the nose the wrinkle, as lips are sneered."""
SPOKEN = 0.5
"""Share of it in the neutral reading."""
EVENT = 0.4
"""Of the difference of the brows' accents."""


def lean_mouth(
    curves: Float32,
    neutral: Float32,
    controls: ControlSet,
    accents: Float64,
    side: float,
    amount: float,
) -> None:
    """Let one side do more, in place; in the neutral reading too, so intensity 0 stays it.

    Parameters
    ----------
    curves : array [shape=(T, C)]
        Changed.
    neutral : array [shape=(T, K)]
        `mouth_columns` of the neutral reading as the network gave it.
    controls : ControlSet
        Columns.
    accents : array [shape=(T, 2), range 0 to 1]
        Swells of the brows' accents on the left and the right.
    side : float
        How much stronger the left side is.
    amount : float
        Factor.
    """
    columns = mouth_columns(controls)
    event = side + EVENT * (accents[:, 0] - accents[:, 1])[:, None]
    leans = 0.5 * amount * np.array([sign * lean for lean in LEANS.values() for sign in (1, -1)])
    expression = curves[:, columns] - neutral
    curves[:, columns] += SPOKEN * side * leans * neutral + event * leans * expression


def mouth_columns(controls: ControlSet) -> NDArray[np.intp]:
    """Columns of `LEANS`, left before right [shape=(K,)]."""
    return _columns(controls.names)


@lru_cache(maxsize=8)
def _columns(names: tuple[str, ...]) -> NDArray[np.intp]:
    found = [names.index(f"CTRL_{side}_{stem}.ty") for stem in LEANS for side in "LR"]
    return np.array(found, np.intp)
