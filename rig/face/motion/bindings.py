"""Map from the 185 controls of the board to the shapes and inputs of the head.

``bindings.csv`` has what a positive and a negative value of each control move, as targets with
factors; ``@`` is L or R. A target is a linear shape (`rig.face.motion.shape_list`) or a named input
of the non-linear parts: ``jaw.*``, ``lid.*_L``, ``seal.*``, ``tongue.*``, ``teeth.*``, ``gaze.*``,
``pupil_*``, ``lash.*``, ``ear_*``. Controls that move nothing by themselves
have a note.
"""

from functools import lru_cache

import numpy as np

from rig.arrays import Float64
from rig.controls import default_controls
from rig.files.reading import rows_of


class Bindings:
    """The map as a matrix: (T, 185) values to (T, K) inputs of the head.

    Attributes
    ----------
    inputs : tuple of str
        Names of the K inputs.
    """

    def __init__(self) -> None:
        controls = default_controls()
        links: list[tuple[int, int, str, float]] = []
        effects = _effects()
        for control, name in enumerate(controls.names):
            for sign, text in enumerate(effects[name]):
                for effect in filter(None, text.split("|")):
                    target, _, factor = effect.partition(":")
                    links.append((control, sign, target, float(factor)))
        self.inputs = tuple(dict.fromkeys(link[2] for link in links))
        self._place = {name: k for k, name in enumerate(self.inputs)}
        count = len(controls.names)
        self._matrix = np.zeros((2 * count, len(self.inputs)))
        for control, sign, target, gain in links:
            self._matrix[control + sign * count, self._place[target]] += gain
        self._upper = [controls.index(f"CTRL_{s}_nose_wrinkleUpper.ty") for s in "LR"]

    def __call__(self, values: Float64) -> dict[str, Float64]:
        """Inputs by name, each (T,), of control values (T, 185)."""
        table = np.concatenate([np.maximum(values, 0), np.maximum(-values, 0)], 1) @ self._matrix
        inputs = {name: table[:, k] for name, k in self._place.items()}
        for side, control in zip("LR", self._upper, strict=True):
            inputs[f"noseWrinkleUpper_{side}"] = inputs.pop(f"wrinkle_{side}") * values[:, control]
        return inputs


def _effects() -> dict[str, tuple[str, str]]:
    """Effects of each control's positive and negative side, both sides written out."""
    return {
        row["control"].replace("@", side): (
            row["positive"].replace("@", side),
            row["negative"].replace("@", side),
        )
        for row in rows_of("face/motion/bindings.csv")
        for side in ("LR" if "@" in row["control"] else "C")
    }


@lru_cache(maxsize=1)
def bindings() -> Bindings:
    """The map, built once."""
    return Bindings()
