"""Map from the 185 controls of the board to the shapes and inputs of the head.

A target is a linear shape (`shapes_*`) or a named input of the non-linear parts: ``jaw.*``,
``lid.*_L``, ``seal.*``, ``tongue.*``, ``teeth.*``, ``gaze.*``, ``pupil_*``, ``lash.*``, ``ear_*``.
"""

from functools import lru_cache

import numpy as np

from rig.arrays import Float64
from rig.controls import default_controls

Effect = tuple[str, float]

_SIDED: dict[str, tuple[tuple[Effect, ...], tuple[Effect, ...]]] = {
    # control without CTRL_L_ / CTRL_R_: effects of a positive value, of a negative value
    "brow_down.ty": ((("browDown_", 1), ("lid.frown_", 1)), ()),
    "brow_lateral.ty": ((("browLateral_", 1),), ()),
    "brow_raiseIn.ty": ((("browRaiseIn_", 1),), ()),
    "brow_raiseOut.ty": ((("browRaiseOut_", 1),), ()),
    "ear_up.ty": ((("ear_", 1),), ()),
    "eye_blink.ty": ((("lid.close_", 1),), (("lid.widen_", 1), ("lid.upperUp_", 0.5))),
    "eye_lidPress.ty": ((("lidPress_", 1), ("lid.upper_", 0.22), ("lid.lower_", 0.30)), ()),
    "eye_squintInner.ty": ((("squintInner_", 1), ("lid.lower_", 0.32), ("lid.upper_", 0.12)), ()),
    "eye_cheekRaise.ty": ((("cheekRaise_", 1), ("lid.lower_", 0.36)), ()),
    "eye_faceScrunch.ty": ((("scrunch_", 1), ("lid.lower_", 0.36), ("lid.upper_", 0.40)), ()),
    "eye_eyelidU.ty": ((("lid.upper_", 0.38),), (("lid.upperUp_", 1),)),
    "eye_eyelidD.ty": ((("lid.lower_", 0.34),), (("lid.lowerDown_", 1),)),
    "eye.ty": ((("gaze.y_", 1), ("lid.lookUp_", 1)), (("gaze.y_", -1), ("lid.lookDown_", 1))),
    "eye.tx": ((("gaze.x_", 1),), (("gaze.x_", -1),)),
    "eye_pupil.ty": ((("pupil_", 1),), (("pupil_", -1),)),
    "eyelashes_tweakerIn.ty": ((("lash.in_", -1),), (("lash.in_", 1),)),
    "eyelashes_tweakerOut.ty": ((("lash.out_", -1),), (("lash.out_", 1),)),
    "nose.ty": ((("noseWrinkle_", 1), ("wrinkle_", 1)), (("nostrilDepress_", 1),)),
    "nose.tx": ((("nostrilDilate_", 1),), (("nostrilDilate_", -0.8),)),
    "nose_nasolabialDeepen.ty": ((("nasolabialDeepen_", 1),), ()),
    "mouth_suckBlow.ty": ((("cheekBlow_", 1),), (("cheekSuck_", 1),)),
    "mouth_lipsBlow.ty": ((("lipsBlow_", 1),), ()),
    "mouth_upperLipRaise.ty": ((("upperLipRaise_", 1),), ()),
    "mouth_lowerLipDepress.ty": ((("lowerLipDepress_", 1),), ()),
    "mouth_cornerPull.ty": ((("cornerPull_", 1),), ()),
    "mouth_stretch.ty": ((("stretch_", 1),), ()),
    "mouth_stretchLipsClose.ty": ((("stretch_", 1), ("seal.upper_", 1), ("seal.lower_", 1)), ()),
    "mouth_dimple.ty": ((("dimple_", 1),), ()),
    "mouth_cornerDepress.ty": ((("cornerDepress_", 1),), ()),
    "mouth_sharpCornerPull.ty": ((("sharpCornerPull_", 1),), ()),
    "mouth_pressU.ty": ((("pressU_", 1), ("seal.upper_", 1)), ()),
    "mouth_pressD.ty": ((("pressD_", 1), ("seal.lower_", 1)), ()),
    "mouth_lipsPressU.ty": (
        (("pressU_", 0.8), ("pressD_", 0.8), ("seal.upper_", 1), ("seal.lower_", 1)),
        (),
    ),
    "mouth_purseU.ty": ((("purseU_", 1),), ()),
    "mouth_purseD.ty": ((("purseD_", 1),), ()),
    "mouth_towardsU.ty": ((("towardsU_", 1),), ()),
    "mouth_towardsD.ty": ((("towardsD_", 1),), ()),
    "mouth_funnelU.ty": ((("funnelU_", 1),), ()),
    "mouth_funnelD.ty": ((("funnelD_", 1),), ()),
    "mouth_lipsTogetherU.ty": ((("seal.upper_", 1),), ()),
    "mouth_lipsTogetherD.ty": ((("seal.lower_", 1),), ()),
    "mouth_lipBiteU.ty": ((("biteU_", 1),), ()),
    "mouth_lipBiteD.ty": ((("biteD_", 1),), ()),
    "mouth_tightenU.ty": ((("tightenU_", 1),), ()),
    "mouth_tightenD.ty": ((("tightenD_", 1),), ()),
    "mouth_stickyInnerU.ty": ((("seal.innerUpper_", 1),), ()),
    "mouth_stickyInnerD.ty": ((("seal.innerLower_", 1),), ()),
    "mouth_stickyOuterU.ty": ((("seal.outerUpper_", 1),), ()),
    "mouth_stickyOuterD.ty": ((("seal.outerLower_", 1),), ()),
    "mouth_lipSticky.ty": ((("seal.zip_", 1),), ()),
    "mouth_pushPullU.ty": ((("pushU_", 1),), (("pushU_", -0.7),)),
    "mouth_pushPullD.ty": ((("pushD_", 1),), (("pushD_", -0.7),)),
    "mouth_thicknessU.ty": ((("thickU_", -1),), (("thickU_", 1),)),
    "mouth_thicknessD.ty": ((("thickD_", -1),), (("thickD_", 1),)),
    "mouth_thicknessInwardU.ty": ((("thickInwardU_", -1),), (("thickInwardU_", 1),)),
    "mouth_thicknessInwardD.ty": ((("thickInwardD_", -1),), (("thickInwardD_", 1),)),
    "mouth_cornerSharpnessU.ty": ((("cornerSharpU_", 1),), (("cornerSharpU_", -1),)),
    "mouth_cornerSharpnessD.ty": ((("cornerSharpD_", 1),), (("cornerSharpD_", -1),)),
    "mouth_lipsTowardsTeethU.ty": ((("towardsTeethU_", 1),), ()),
    "mouth_lipsTowardsTeethD.ty": ((("towardsTeethD_", 1),), ()),
    "mouth_lipsRollU.ty": ((("rollInU_", 1),), (("rollOutU_", 1),)),
    "mouth_lipsRollD.ty": ((("rollInD_", 1),), (("rollOutD_", 1),)),
    "mouth_corner.ty": ((("cornerUp_", 1),), (("cornerUp_", -1),)),
    "mouth_corner.tx": ((("cornerWide_", 1),), (("cornerWide_", -0.8),)),
    "jaw_clench.ty": ((("jawClench_", 1),), ()),
    "jaw_ChinRaiseU.ty": ((("chinRaiseU_", 1),), ()),
    "jaw_ChinRaiseD.ty": ((("chinRaiseD_", 1),), ()),
    "jaw_chinCompress.ty": ((("chinCompress_", 1),), ()),
    "neck_stretch.ty": ((("neckStretch_", 1),), ()),
    "neck_mastoidContract.ty": ((("mastoid_", 1),), ()),
}

_BOTH_EYES_Y = (("gaze.y_L", 1.0), ("gaze.y_R", 1.0))
_BOTH_EYES_X = (("gaze.x_L", 1.0), ("gaze.x_R", 1.0))
_CENTER: dict[str, tuple[tuple[Effect, ...], tuple[Effect, ...]]] = {
    "CTRL_C_eye.ty": (
        (*_BOTH_EYES_Y, ("lid.lookUp_L", 1), ("lid.lookUp_R", 1)),
        (("gaze.y_L", -1), ("gaze.y_R", -1), ("lid.lookDown_L", 1), ("lid.lookDown_R", 1))),
    "CTRL_C_eye.tx": (_BOTH_EYES_X, (("gaze.x_L", -1), ("gaze.x_R", -1))),
    "CTRL_C_eye_parallelLook.ty": ((("gaze.parallel", 1),), ()),
    "CTRL_C_mouth.ty": ((("mouthUp", 1),), (("mouthDown", 1),)),
    "CTRL_C_mouth.tx": ((("mouthSide", 1),), (("mouthSide", -1),)),
    "CTRL_C_mouth_stickyU.ty": ((("seal.centerUpper", 1),), ()),
    "CTRL_C_mouth_stickyD.ty": ((("seal.centerLower", 1),), ()),
    "CTRL_C_mouth_lipShiftU.ty": ((("lipShiftU", 1),), (("lipShiftU", -1),)),
    "CTRL_C_mouth_lipShiftD.ty": ((("lipShiftD", 1),), (("lipShiftD", -1),)),
    "CTRL_C_tongue_inOut.ty": ((("tongue.in", 1),), (("tongue.out", 1),)),
    "CTRL_C_tongue_move.ty": ((("tongue.up", 1),), (("tongue.up", -0.6),)),
    "CTRL_C_tongue_move.tx": ((("tongue.left", 1),), (("tongue.left", -1),)),
    "CTRL_C_tongue_press.ty": ((("tongue.press", 1),), ()),
    "CTRL_C_tongue_wideNarrow.ty": ((("tongue.wide", 1),), (("tongue.wide", -1),)),
    "CTRL_C_tongue_bendTwist.ty": ((("tongue.bend", 1),), (("tongue.bend", -1),)),
    "CTRL_C_tongue_bendTwist.tx": ((("tongue.twist", 1),), (("tongue.twist", -1),)),
    "CTRL_C_tongue_roll.ty": ((("tongue.roll", 1),), ()),
    "CTRL_C_tongue_tipMove.ty": ((("tongue.tipUp", 1),), (("tongue.tipUp", -1),)),
    "CTRL_C_tongue_tipMove.tx": ((("tongue.tipLeft", 1),), (("tongue.tipLeft", -1),)),
    "CTRL_C_tongue_thickThin.ty": ((("tongue.thick", 1),), (("tongue.thick", -1),)),
    "CTRL_C_jaw.ty": ((("jaw.open", 1),), ()),
    "CTRL_C_jaw.tx": ((("jaw.left", -1),), (("jaw.left", 1),)),
    "CTRL_C_jaw_fwdBack.ty": ((("jaw.forward", -0.6),), (("jaw.forward", 1),)),
    "CTRL_C_jaw_openExtreme.ty": ((("jaw.open", 0.35),), ()),
    "CTRL_C_neck_swallow.ty": ((("swallow", 1),), ()),
    "CTRL_neck_throatUpDown.ty": ((("larynxUp", 0.7),), (("larynxUp", -0.7),)),
    "CTRL_neck_digastricUpDown.ty": ((("floorDown", -0.6),), (("floorDown", 1),)),
    "CTRL_neck_throatExhaleInhale.ty": ((("throatOut", -0.8),), (("throatOut", 0.8),)),
    "CTRL_C_teethU.ty": ((("teeth.upper_y", 1),), (("teeth.upper_y", -1),)),
    "CTRL_C_teethU.tx": ((("teeth.upper_x", 1),), (("teeth.upper_x", -1),)),
    "CTRL_C_teeth_fwdBackU.ty": ((("teeth.upper_z", -1),), (("teeth.upper_z", 1),)),
    "CTRL_C_teethD.ty": ((("teeth.lower_y", 1),), (("teeth.lower_y", -1),)),
    "CTRL_C_teethD.tx": ((("teeth.lower_x", 1),), (("teeth.lower_x", -1),)),
    "CTRL_C_teeth_fwdBackD.ty": ((("teeth.lower_z", -1),), (("teeth.lower_z", 1),)),
}  # fmt: skip

NOTHING: dict[str, str] = {
    "CTRL_L_mouth_lipsPressD.ty": "drives nothing on a MetaHuman either (lipsPressU has the pose)",
    "CTRL_R_mouth_lipsPressD.ty": "drives nothing on a MetaHuman either (lipsPressU has the pose)",
    "CTRL_lookAtSwitch.ty": "chooses how Unreal aims the eyes; no shape of its own",
    "CTRL_convergenceSwitch.ty": "chooses how Unreal aims the eyes; no shape of its own",
    "CTRL_eyesAimFollowHead.ty": "moves a handle of the board, not the face",
    "CTRL_faceGUIfollowHead.ty": "moves the board itself, not the face",
    "CTRL_neckCorrectivesMultiplyerU.ty": "corrects the neck in head turns; a take has none",
    "CTRL_neckCorrectivesMultiplyerM.ty": "corrects the neck in head turns; a take has none",
    "CTRL_neckCorrectivesMultiplyerD.ty": "corrects the neck in head turns; a take has none",
}
"""Controls without effect on this head, and the reason."""


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
        for name in controls.names:
            for sign, effects in enumerate(_effects(name)):
                links += [(controls.index(name), sign, target, gain) for target, gain in effects]
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


def _effects(name: str) -> tuple[tuple[Effect, ...], tuple[Effect, ...]]:
    """Effects of a control's positive and negative side."""
    if name in _CENTER:
        return _CENTER[name]
    side, _, stem = name.removeprefix("CTRL_").partition("_")
    if side in ("L", "R") and stem in _SIDED:
        positive, negative = _SIDED[stem]
        return (
            tuple((target + side, gain) for target, gain in positive),
            tuple((target + side, gain) for target, gain in negative),
        )
    return (), ()


@lru_cache(maxsize=1)
def bindings() -> Bindings:
    """The map, built once."""
    return Bindings()
