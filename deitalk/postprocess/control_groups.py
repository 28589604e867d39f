"""Columns of the controls that the rules change together."""

from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from deitalk.config.rules import KeepContacts
from rig import ControlSet
from rig.arrays import Bool
from rig.controls import DEFAULT_ID
from rig.curves.apply_layers import Closures

LIVELY = ("jaw.ty", "upperLipRaise", "lowerLipDepress")
OPENING = ("jaw.ty", "jaw_openExtreme", "upperLipRaise", "lowerLipDepress", "funnel", "lipsRoll",
           "lipsBlow", "suckBlow")  # fmt: skip
"""Parts of the names of controls that part the lips."""
SPEAKING = ("lipsTogether", "lipBite", "purse", "owards", "mouth_press", "tongue", "teeth", "icky",
            "lipsPress", "pushPull", "jaw_fwdBack")  # fmt: skip
"""Parts of the names of the other controls that speech moves."""
ROUNDING = ("mouth_funnel", "mouth_purse")


class ControlGroups:
    """Columns of the controls that the rules of one control set change together."""

    def __init__(self, controls: ControlSet) -> None:
        self.controls = controls

    @cached_property
    def opening(self) -> NDArray[np.intp]:
        """Controls that part the lips."""
        return self._named(*OPENING)

    @cached_property
    def lively(self) -> NDArray[np.intp]:
        """Controls that `scale_opening` scales; they rest at 0."""
        return self._named(*LIVELY)

    @cached_property
    def lips(self) -> NDArray[np.intp]:
        """The jaw, the raises of the upper lip and the depressions of the lower one; or none."""
        places = np.concatenate([self._named(part) for part in LIVELY])
        return places if len(places) == 5 else places[:0]

    @cached_property
    def rounding(self) -> tuple[NDArray[np.intp], ...]:
        """Controls of funnel, and of purse."""
        return tuple(self._named(part) for part in ROUNDING)

    @cached_property
    def together(self) -> NDArray[np.intp]:
        """The four lips-together controls."""
        return self._named("lipsTogether")

    @cached_property
    def bite(self) -> NDArray[np.intp]:
        """The lower lip's bite."""
        return self._named("lipBiteD")

    @cached_property
    def seals(self) -> NDArray[np.intp]:
        """Controls that close the lips; an expression may increase them only."""
        return np.concatenate((self.together, self.bite))

    @cached_property
    def tongue(self) -> NDArray[np.intp]:
        """The control by which the tongue comes out, below 0; or none."""
        return self._named("tongue_inOut")

    @cached_property
    def tongue_tip(self) -> NDArray[np.intp]:
        """The control that raises its tip; or none."""
        return self._named("tongue_tipMove.ty")

    def closures(self, rule: KeepContacts) -> Closures:
        """What layers of edits do not part, by the rule for expressions."""
        seals = self.together.tolist(), self.bite.tolist()
        return Closures(seals, self.opening.tolist(), rule.begin, rule.full)

    @cached_property
    def follows_mouth(self) -> Bool:
        """Controls that the mouth gate brings to rest: those of speech and of parted lips.

        Controls of the expression alone (corners, brows, lids, cheeks) stay through pauses. Of a
        rig other than the board, those of its lip set follow it.
        """
        speaks = np.zeros(len(self.controls.names), bool)
        if self.controls.id != DEFAULT_ID:
            speaks[self.controls.subset("lip")] = True
            return speaks
        speaks[self.opening] = True
        speaks[self._named(*SPEAKING)] = True
        return speaks

    def _named(self, *parts: str) -> NDArray[np.intp]:
        return _places(self.controls.names, parts)


@lru_cache(maxsize=64)
def _places(names: tuple[str, ...], parts: tuple[str, ...]) -> NDArray[np.intp]:
    """Places of the names that hold one of some parts; not to be changed."""
    places = np.array([i for i, n in enumerate(names) if any(p in n for p in parts)], np.intp)
    places.setflags(write=False)
    return places
