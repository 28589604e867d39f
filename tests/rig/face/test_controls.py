"""Every control moves its landmark in its direction and on its side."""

import functools

import numpy as np
import pytest

from deitalk.research.poses import pose_values
from rig import default_controls
from rig.face import build_head

CONTROLS = default_controls()
X, Y, Z = 0, 1, 2

SIDED = {
    # control on the left side: landmark, axis and sign at its positive end, at its negative end
    "brow_down.ty": ("brow_in", Y, -1, None),
    "brow_lateral.ty": ("brow_in", X, -1, None),
    "brow_raiseIn.ty": ("brow_in", Y, 1, None),
    "brow_raiseOut.ty": ("brow_out", Y, 1, None),
    "ear_up.ty": ("ear", Y, 1, None),
    "eye_blink.ty": ("lid_up", Y, -1, 1),
    "eye_lidPress.ty": ("lid_low", Y, 1, None),
    "eye_squintInner.ty": ("lid_low", Y, 1, None),
    "eye_cheekRaise.ty": ("cheek", Y, 1, None),
    "eye_faceScrunch.ty": ("lid_up", Y, -1, None),
    "eye_eyelidU.ty": ("lid_up", Y, -1, 1),
    "eye_eyelidD.ty": ("lid_low", Y, 1, -1),
    "eye.ty": ("pupil", Y, 1, -1),
    "eye.tx": ("pupil", X, 1, -1),
    "eyelashes_tweakerIn.ty": ("lash_in", Y, -1, 1),
    "eyelashes_tweakerOut.ty": ("lash_out", Y, -1, 1),
    "nose.ty": ("wing", Y, 1, -1),
    "nose.tx": ("wing", X, 1, -1),
    "nose_nasolabialDeepen.ty": ("fold", Z, 1, None),
    "mouth_suckBlow.ty": ("hollow", X, 1, -1),
    "mouth_lipsBlow.ty": ("above_lip", Z, 1, None),
    "mouth_upperLipRaise.ty": ("lip_up", Y, 1, None),
    "mouth_lowerLipDepress.ty": ("lip_low", Y, -1, None),
    "mouth_cornerPull.ty": ("corner", Y, 1, None),
    "mouth_stretch.ty": ("corner", X, 1, None),
    "mouth_stretchLipsClose.ty": ("corner", X, 1, None),
    "mouth_dimple.ty": ("corner", Z, -1, None),
    "mouth_cornerDepress.ty": ("corner", Y, -1, None),
    "mouth_pressU.ty": ("red_up", Y, -1, None),
    "mouth_pressD.ty": ("red_low", Y, 1, None),
    "mouth_lipsPressU.ty": ("red_up", Y, -1, None),
    "mouth_purseU.ty": ("lip_up", Z, 1, None),
    "mouth_purseD.ty": ("lip_low", Z, 1, None),
    "mouth_towardsU.ty": ("red_up", Y, -1, None),
    "mouth_towardsD.ty": ("red_low", Y, 1, None),
    "mouth_funnelU.ty": ("lip_up", Y, 1, None),
    "mouth_funnelD.ty": ("lip_low", Y, -1, None),
    "mouth_lipBiteU.ty": ("red_up", Z, -1, None),
    "mouth_lipBiteD.ty": ("red_low", Z, -1, None),
    "mouth_tightenU.ty": ("red_up", Y, -1, None),
    "mouth_tightenD.ty": ("red_low", Y, 1, None),
    "mouth_sharpCornerPull.ty": ("corner", Y, 1, None),
    "mouth_pushPullU.ty": ("red_up", Z, 1, -1),
    "mouth_pushPullD.ty": ("red_low", Z, 1, -1),
    "mouth_thicknessU.ty": ("red_up", Y, -1, 1),
    "mouth_thicknessD.ty": ("red_low", Y, 1, -1),
    "mouth_thicknessInwardU.ty": ("lip_up", Z, -1, 1),
    "mouth_thicknessInwardD.ty": ("lip_low", Z, -1, 1),
    "mouth_cornerSharpnessU.ty": ("red_up_side", Y, -1, 1),
    "mouth_cornerSharpnessD.ty": ("red_low_side", Y, 1, -1),
    "mouth_lipsTowardsTeethU.ty": ("red_up", Z, -1, None),
    "mouth_lipsTowardsTeethD.ty": ("red_low", Z, -1, None),
    "mouth_lipsRollU.ty": ("red_up", Z, -1, 1),
    "mouth_lipsRollD.ty": ("red_low", Z, -1, 1),
    "mouth_corner.ty": ("corner", Y, 1, -1),
    "mouth_corner.tx": ("corner", X, 1, -1),
    "jaw_clench.ty": ("jaw_angle", X, 1, None),
    "jaw_ChinRaiseU.ty": ("red_up", Y, 1, None),
    "jaw_ChinRaiseD.ty": ("chin", Y, 1, None),
    "jaw_chinCompress.ty": ("chin", Y, 1, None),
    "neck_stretch.ty": ("neck_front", Z, 1, None),
    "neck_mastoidContract.ty": ("neck_side", X, 1, None),
}
CENTER = {
    "CTRL_C_eye.ty": ("pupil", Y, 1, -1),
    "CTRL_C_eye.tx": ("pupil", X, 1, -1),
    "CTRL_C_mouth.ty": ("lip_up_mid", Y, 1, -1),
    "CTRL_C_mouth.tx": ("lip_up_mid", X, 1, -1),
    "CTRL_C_mouth_lipShiftU.ty": ("lip_up_mid", X, 1, -1),
    "CTRL_C_mouth_lipShiftD.ty": ("lip_low_mid", X, 1, -1),
    "CTRL_C_jaw.ty": ("chin_mid", Y, -1, None),
    "CTRL_C_jaw.tx": ("chin_mid", X, -1, 1),
    "CTRL_C_jaw_fwdBack.ty": ("chin_mid", Z, -1, 1),
    "CTRL_C_jaw_openExtreme.ty": ("chin_mid", Y, -1, None),
    "CTRL_C_neck_swallow.ty": ("larynx_high", Z, 1, None),
    "CTRL_neck_throatUpDown.ty": ("larynx_high", Z, 1, -1),
    "CTRL_neck_digastricUpDown.ty": ("floor", Y, 1, -1),
    "CTRL_neck_throatExhaleInhale.ty": ("larynx", Z, -1, 1),
    "CTRL_C_teethU.ty": ("tooth_up", Y, 1, -1),
    "CTRL_C_teethU.tx": ("tooth_up", X, 1, -1),
    "CTRL_C_teeth_fwdBackU.ty": ("tooth_up", Z, -1, 1),
    "CTRL_C_teethD.ty": ("tooth_low", Y, 1, -1),
    "CTRL_C_teethD.tx": ("tooth_low", X, 1, -1),
    "CTRL_C_teeth_fwdBackD.ty": ("tooth_low", Z, -1, 1),
    "CTRL_C_tongue_inOut.ty": ("tongue_tip", Z, -1, 1),
    "CTRL_C_tongue_move.ty": ("tongue_body", Y, 1, -1),
    "CTRL_C_tongue_move.tx": ("tongue_tip", X, 1, -1),
    "CTRL_C_tongue_press.ty": ("tongue_body", Y, 1, None),
    "CTRL_C_tongue_wideNarrow.ty": ("tongue_left", X, 1, -1),
    "CTRL_C_tongue_bendTwist.ty": ("tongue_tip", Y, 1, -1),
    "CTRL_C_tongue_bendTwist.tx": ("tongue_left", Y, 1, -1),
    "CTRL_C_tongue_roll.ty": ("tongue_left", Y, 1, None),
    "CTRL_C_tongue_tipMove.ty": ("tongue_tip", Y, 1, -1),
    "CTRL_C_tongue_tipMove.tx": ("tongue_tip", X, 1, -1),
    "CTRL_C_tongue_thickThin.ty": ("tongue_left", X, None, None),
}


@pytest.fixture(scope="module")
def head():
    return build_head(0)


@pytest.fixture(scope="module")
def landmarks(head) -> dict[str, np.ndarray]:
    """Vertices (indices into the joined mesh) of each landmark on the character's left."""
    v, marks = head.mesh.vertices, {k: head.skin.vertices[i] for k, i in head.landmarks.items()}
    skin = head.skin.vertices
    start = {k: s.start for k, s in head.slices.items()}

    def near(x, y, z_least=2.0, count=4):
        off = (skin[:, 0] - x) ** 2 + (skin[:, 1] - y) ** 2 + 100 * (skin[:, 2] < z_least)
        off = off + np.where(np.abs(y - mouth[1]) < 2, 0, 1) * (8 - skin[:, 2]).clip(0) * 0.2
        return np.argsort(off)[:count]

    def part(name, chosen):
        return start[name] + np.flatnonzero(chosen(v[head.slices[name]]))

    def lip(which, low, high):
        ids = head.motion.lips[which].rim
        return ids[(skin[ids, 0] > low) & (skin[ids, 0] < high)]

    def red(which, low, high):
        reach, share = head.motion.lips[which].reach, head.motion.lips[which].share
        own = reach[(share > 0.45) & (share < 0.9)]
        own = own[(skin[own, 0] > low) & (skin[own, 0] < high)]
        return own[skin[own, 2] > skin[own, 2].max() - 1.2]

    mouth = marks["upper_rim"]
    brow, lash = v[head.slices["brow_L"]][:, 0], v[head.slices["lash_L"]]
    tongue = v[head.slices["tongue"]]
    eye = marks["eye_upper_left"]
    side = np.argsort(np.linalg.norm(skin - [3.6, -11.5, 0.4], axis=1))[:3]
    tip_z = tongue[:, 2].max()
    chin = marks["chin"]
    return {
        "brow_in": part("brow_L", lambda p: p[:, 0] < brow.min() + 0.5),
        "brow_out": part("brow_L", lambda p: p[:, 0] > brow.max() - 1.2),
        "ear": np.argsort(-skin[:, 0] + 100 * (np.abs(skin[:, 1]) > 3))[:9],
        "lid_up": [head.landmarks["eye_upper_left"]],
        "lid_low": [head.landmarks["eye_lower_left"]],
        "cheek": near(3.9, eye[1] - 2.6),
        "pupil": np.arange(40) + start["eye_L"],
        "lash_in": part("lash_L", lambda p: (p[:, 0] < lash[:, 0].min() + 0.8) & (p[:, 1] > 0)),
        "lash_out": part("lash_L", lambda p: (p[:, 0] > lash[:, 0].max() - 0.6) & (p[:, 1] > 0)),
        "wing": near(1.5, marks["nose_wing_left"][1], 7.5, 3),
        "fold": near(2.6, marks["nose_wing_left"][1] - 0.8),
        "hollow": near(4.4, mouth[1] + 0.6),
        "above_lip": near(1.6, mouth[1] + 1.3),
        "corner": [head.landmarks["mouth_corner_left"]],
        "lip_up": lip(0, 0.4, 1.1),
        "lip_low": lip(1, 0.4, 1.1),
        "red_up": red(0, 0.4, 1.1),
        "red_low": red(1, 0.4, 1.1),
        "red_up_side": red(0, 1.4, 2.1),
        "red_low_side": red(1, 1.4, 2.1),
        "jaw_angle": near(5.6, mouth[1] + 0.3),
        "chin": near(1.2, chin[1] + 0.3),
        "neck_front": near(1.4, -14.6, -1.0),
        "neck_side": side,
        "lip_up_mid": lip(0, -0.2, 0.2),
        "lip_low_mid": lip(1, -0.2, 0.2),
        "chin_mid": near(0, chin[1]),
        "larynx": near(0, -13.6, 0.0),
        "larynx_high": near(0, -12.6, 0.0),
        "floor": np.argsort(np.linalg.norm(skin - [0, chin[1] - 1.3, 4.6], axis=1))[:3],
        "tooth_up": np.arange(40) + start["teeth_upper"],
        "tooth_low": np.arange(40) + start["teeth_lower"],
        "tongue_tip": part("tongue", lambda p: p[:, 2] > tip_z - 0.6),
        "tongue_body": part("tongue", lambda p: (p[:, 2] < tip_z - 1.6) & (p[:, 2] > tip_z - 3)),
        "tongue_left": part("tongue", lambda p: (p[:, 0] > 0.9) & (p[:, 2] > tip_z - 2.6)),
    }


@functools.cache
def before(base: tuple[tuple[str, float], ...]) -> np.ndarray:
    return build_head(0).pose(pose_values(dict(base)))


def motion(head, name: str, value: float, base: dict[str, float]) -> np.ndarray:
    return head.pose(pose_values({**base, name: value})) - before(tuple(base.items()))


OPEN = {"CTRL_C_jaw.ty": 0.35}
"""Open mouth, so that contact does not limit motion."""
CASES = [(f"CTRL_L_{stem}", *rest) for stem, rest in SIDED.items()] + [
    (name, *rest) for name, rest in CENTER.items()
]


@pytest.mark.parametrize(("name", "landmark", "axis", "plus", "minus"), CASES)
def test_control_moves_its_landmark_in_its_direction(
    head, landmarks, name, landmark, axis, plus, minus
):
    base = {k: v for k, v in OPEN.items() if not name.startswith("CTRL_C_jaw")}
    at = landmarks[landmark]
    end = 0.5 if "swallow" in name else 1.0
    k = CONTROLS.index(name)
    assert (CONTROLS.minimum[k] < 0) == (minus is not None or name.endswith("thickThin.ty"))
    for value, sign in ((end, plus), (-1.0, minus)):
        if sign is not None:
            moved = motion(head, name, value, base)[at, axis].mean()
            assert sign * moved > 0.015, f"{name}={value} moves {landmark} by {moved:.3f} cm"


@pytest.mark.parametrize("stem", [*SIDED, "eye_pupil.ty"])
def test_sided_control_moves_its_own_side(head, stem):
    x = head.mesh.vertices[:, 0]
    for side, sign in (("L", 1), ("R", -1)):
        moved = np.linalg.norm(motion(head, f"CTRL_{side}_{stem}", 1.0, OPEN), axis=1)
        own, other = moved[sign * x > 0.6].sum(), moved[sign * x < -0.6].sum()
        assert own > 6 * other, stem


def test_pupil_widens_and_narrows(head):
    ring = head.slices["eye_L"].start + 5 * 36 + np.arange(36)

    def radius(value):
        points = head.pose(pose_values({"CTRL_L_eye_pupil.ty": value}))[ring]
        return np.linalg.norm(points - points.mean(0), axis=1).mean()

    assert radius(-1) < 0.92 * radius(0) < 0.92 * 0.92 * radius(1)


def test_thick_tongue_is_taller(head):
    def height(value):
        points = head.pose(pose_values({**OPEN, "CTRL_C_tongue_thickThin.ty": value}))
        return np.ptp(points[head.slices["tongue"], 1])

    assert height(-1) < height(0) < height(1)


@pytest.mark.parametrize("lip", ["U", "D"])
def test_lips_together_moves_its_own_lip(head, lip):
    moved = motion(head, f"*mouth_lipsTogether{lip}.ty", 1.0, OPEN)
    upper, lower = (
        moved[part.rim[np.abs(head.skin.vertices[part.rim, 0]) < 0.3], Y].mean()
        for part in head.motion.lips
    )
    assert (upper < -0.1 and abs(lower) < 0.02) if lip == "U" else (lower > 0.1 > abs(upper) * 5)


@pytest.mark.parametrize(("names", "at"), [
    (("L_mouth_stickyInner",), 0.45), (("L_mouth_stickyOuter",), 0.85), (("C_mouth_sticky",), 0.0),
])  # fmt: skip
def test_sticky_closes_its_part_of_the_lips(head, names, at):
    both = {f"CTRL_{name}{lip}.ty": 1.0 for name in names for lip in "UD"}
    gaps, open_ = (
        head.lip_gaps(head.pose(pose_values(p))[None])[0] for p in ({**OPEN, **both}, OPEN)
    )
    column = round((0.5 + 0.5 * at * 2.5 / 2.6) * (len(gaps) - 1))
    assert gaps[column] < 0.25 * open_[column] + 0.02
    if at:
        assert gaps[-1 - column] > 0.8 * open_[-1 - column]


def test_lip_sticky_closes_the_lips(head):
    gaps = [
        head.lip_gaps(head.pose(pose_values({**OPEN, "*mouth_lipSticky.ty": v}))[None]).max()
        for v in (0, 0.5, 1)
    ]
    assert gaps[2] < 0.03 < gaps[1] < 0.8 * gaps[0]


def test_parallel_look_makes_the_eyes_parallel(head):
    crossed = {"CTRL_L_eye.tx": -0.6, "CTRL_R_eye.tx": 0.6}

    def aim(pose):
        posed = head.pose(pose_values(pose)).astype(float)
        axes = []
        for name, side in (("eye_L", 1), ("eye_R", -1)):
            center = head.eyes[0 if side == 1 else 1, :3]
            axes.append(posed[head.slices[name]][:40].mean(0) - center)
        return axes

    a, b = aim(crossed)
    assert abs(a[0] - b[0]) > 0.5
    a, b = aim({**crossed, "CTRL_C_eye_parallelLook.ty": 1})
    assert np.abs(a - b).max() < 1e-3


ONLY_WITH = {
    "CTRL_L_nose_wrinkleUpper.ty": "scales the upper wrinkle of CTRL_L_nose.ty (rests at 1)",
    "CTRL_R_nose_wrinkleUpper.ty": "scales the upper wrinkle of CTRL_R_nose.ty (rests at 1)",
    **{
        f"CTRL_{side}_mouth_{name}.ty": "closes lips that are apart; at rest they touch already"
        for side in "LR"
        for name in ("lipsTogetherU", *(f"sticky{part}{lip}" for part in ("Inner", "Outer") for lip in "UD"))
    },
    "CTRL_C_mouth_stickyU.ty": "closes lips that are apart; at rest they touch already",
    "CTRL_C_mouth_stickyD.ty": "closes lips that are apart; at rest they touch already",
}  # fmt: skip
"""Controls with an effect only together with another one."""


def test_every_control_has_an_effect_or_a_reason(head):
    """Each of the 185 moves a vertex, alone or with another control, or is listed with a reason."""
    base = {**OPEN, "*nose.ty": 0.5, "CTRL_L_eye.tx": 0.5}
    still = {n for n, m in _motions(head, pose_values(base)).items() if m < 0.02}
    assert still == {
        "CTRL_L_mouth_lipsPressD.ty", "CTRL_R_mouth_lipsPressD.ty", "CTRL_lookAtSwitch.ty",
        "CTRL_convergenceSwitch.ty", "CTRL_eyesAimFollowHead.ty", "CTRL_faceGUIfollowHead.ty",
        *(f"CTRL_neckCorrectivesMultiplyer{part}.ty" for part in "UMD"),
    }  # fmt: skip
    alone = {n for n, m in _motions(head, CONTROLS.rest.astype(float)).items() if m < 0.02}
    assert alone - still == set(ONLY_WITH)


def _motions(head, base: np.ndarray) -> dict[str, float]:
    """Largest motion of any vertex when each control alone leaves `base` for its far end."""
    values = np.repeat(base[None], 185, 0)
    far = np.where(base < CONTROLS.maximum, CONTROLS.maximum, CONTROLS.minimum)
    np.fill_diagonal(values, far)
    swallow = CONTROLS.index("CTRL_C_neck_swallow.ty")
    values[swallow, swallow] = 0.5
    moved = np.abs(head.pose(values) - head.pose(base)).max((1, 2))
    return dict(zip(CONTROLS.names, moved, strict=True))
