from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.optimize import lsq_linear

from rig import RigCurves, default_controls, rest_curves
from rig.conversion.arkit import (
    ARKIT_ID,
    LIPS_TOGETHER,
    arkit_controls,
    arkit_to_raw,
    raw_to_arkit,
    udp_order,
)
from rig.conversion.convert import convert
from rig.conversion.raw import RAW_ID, raw_controls
from rig.errors import ControlError

ARKIT = arkit_controls()
SHAPES = ARKIT.names[:52]
OUT = raw_controls().index("tongueOut")
POSED = [name for name in SHAPES if name != "MouthClose"]


def arkit(**values):
    frame = np.zeros((1, 61), np.float32)
    for name, value in values.items():
        frame[0, ARKIT.index(name)] = value
    return RigCurves(frame, ARKIT.names, control_set=ARKIT_ID)


def raw(**values):
    frame = raw_controls().rest.copy()[None]
    for name, value in values.items():
        frame[0, raw_controls().index(name)] = value
    return RigCurves(frame, raw_controls().names, control_set=RAW_ID)


def test_names_and_order_are_those_of_a_real_capture(shared):
    with (shared / "data/curves/livelink/alex_rom_3.csv").open() as stream:
        header = stream.readline().strip().split(",")
    assert list(ARKIT.names) == header[2:]


def test_packets_put_left_before_right_and_files_right_before_left():
    udp = [ARKIT.names[i] for i in udp_order()]
    assert udp[15:17] == ["JawLeft", "JawRight"] and udp[21:23] == ["MouthLeft", "MouthRight"]
    assert ARKIT.names[15:17] == ("JawRight", "JawLeft")
    assert sorted(udp) == sorted(ARKIT.names) and udp[17] == "JawOpen"


def test_apple_spelling_resolves():
    assert ARKIT.canonical("mouthSmileLeft") == "MouthSmileLeft"


@pytest.mark.parametrize("strength", [0.1, 0.6, 1.0])
@pytest.mark.parametrize("name", POSED)
def test_each_posed_shape_is_recovered(name, strength):
    fit = raw_to_arkit(arkit_to_raw(arkit(**{name: strength})))
    assert fit.curves.values[:, :52] == pytest.approx(
        arkit(**{name: strength}).values[:, :52], abs=1e-3
    )
    assert fit.lost < 1e-3


@settings(max_examples=30, deadline=None)
@given(hnp.arrays(np.float32, (2, 52), elements=st.floats(0, 0.5, width=32)))
def test_mixtures_are_recovered_where_no_raw_curve_is_clamped(weights):
    values = np.zeros((2, 61), np.float32)
    values[:, :52] = weights
    jaw, close = ARKIT.index("JawOpen"), ARKIT.index("MouthClose")
    values[:, close] = np.where(
        values[:, jaw] > 1e-3, np.minimum(values[:, close], values[:, jaw]), 0
    )
    fit = raw_to_arkit(arkit_to_raw(RigCurves(values, ARKIT.names, control_set=ARKIT_ID)))
    assert fit.curves.values[:, :52] == pytest.approx(values[:, :52], abs=1e-3)


def test_real_capture_is_recovered(shared):
    import pandas as pd

    table = pd.read_csv(shared / "data/curves/livelink/alex_rom_3.csv")
    shapes = table[list(ARKIT.names)].to_numpy(np.float32)[::10]
    shapes[:, :52] = shapes[:, :52].clip(0, 1)
    shapes[:, 52:] = 0
    jaw, close = ARKIT.index("JawOpen"), ARKIT.index("MouthClose")
    shapes[:, close] = np.minimum(shapes[:, close], shapes[:, jaw])
    fit = raw_to_arkit(arkit_to_raw(RigCurves(shapes, ARKIT.names, control_set=ARKIT_ID)))
    assert fit.curves.values[:, :52] == pytest.approx(shapes[:, :52], abs=1e-3)
    assert fit.lost < 1e-4


def test_fit_equals_bounded_least_squares(rng):
    """Coupled and single shapes against scipy's solver, on raw curves below 1."""
    shapes = [arkit(**{name: 1e-3}) for name in SHAPES]
    rest = raw_controls().rest
    poses = np.stack(
        [1e3 * (arkit_to_raw(shape).values[0] - rest.astype(float)) for shape in shapes]
    )
    for _ in range(5):
        target = np.where(rest == 1, 1, rng.uniform(0, 0.95, 251)).astype(np.float32)
        fit = raw_to_arkit(RigCurves(target[None], raw_controls().names, control_set=RAW_ID))
        best = lsq_linear(poses.T, target - rest, bounds=(0, 1), tol=1e-12)
        for name, weight in zip(SHAPES, best.x, strict=True):
            if name == "TongueOut":
                weight = min(weight, target[OUT] / poses[SHAPES.index(name), OUT])
            if name != "MouthClose":
                assert fit.curves[name][0] == pytest.approx(weight, abs=1e-3)


def test_clamped_brows_give_both_shapes():
    full = raw(
        browRaiseInL=1,
        browRaiseInR=1,
        browLateralL=1,
        browLateralR=1,
        browRaiseOuterL=1,
        browRaiseOuterR=1,
    )
    fit = raw_to_arkit(full)
    for name in ("BrowInnerUp", "BrowOuterUpLeft", "BrowOuterUpRight"):
        assert fit.curves[name][0] == pytest.approx(1, abs=1e-3)
    assert fit.lost < 1e-3


def test_weights_of_a_hand_worked_pose():
    pucker = arkit_to_raw(arkit(MouthPucker=0.5))
    assert pucker["CTRL_expressions_mouthFunnelUL"][0] == pytest.approx(0.37595)
    assert pucker["CTRL_expressions_mouthLipsTowardsDR"][0] == pytest.approx(0.2061)
    assert pucker["CTRL_expressions_noseWrinkleUpperL"][0] == 1
    left = arkit_to_raw(arkit(EyeLookInLeft=0.5, EyeLookInRight=0.25))
    assert left["CTRL_expressions_eyeLookRightL"][0] == 0.5
    assert left["CTRL_expressions_eyeLookLeftR"][0] == 0.25


@given(st.floats(0, 1), st.lists(st.floats(0, 1), min_size=4, max_size=4))
def test_lips_never_cross(jaw, together):
    names = (name.removeprefix("CTRL_expressions_") for name in LIPS_TOGETHER)
    fit = raw_to_arkit(raw(jawOpen=jaw, **dict(zip(names, together, strict=True))))
    close, jaw_open = fit.curves["MouthClose"][0], fit.curves["JawOpen"][0]
    assert 0 <= close <= jaw_open + 1e-6


def test_mouth_close_needs_an_open_jaw():
    ul = {
        "mouthLipsTogetherUL": 1,
        "mouthLipsTogetherUR": 1,
        "mouthLipsTogetherDL": 1,
        "mouthLipsTogetherDR": 1,
    }
    assert raw_to_arkit(raw(jawOpen=0.6, **ul)).curves["MouthClose"][0] == pytest.approx(0.6)
    assert raw_to_arkit(raw(jawOpen=0.0, **ul)).curves["MouthClose"][0] == 0
    shut = arkit_to_raw(arkit(JawOpen=0.0, MouthClose=0.7))
    assert shut[LIPS_TOGETHER[0]][0] == 0
    crossed = arkit_to_raw(arkit(JawOpen=0.2, MouthClose=0.7))
    assert crossed[LIPS_TOGETHER[0]][0] == 1


@pytest.mark.parametrize(
    ("moved", "expected"),
    [
        ({"tongueDown": 0.8, "tongueWide": 0.6, "tongueBendDown": 0.3}, 0),
        ({"tongueDown": 0.826, "tongueWide": 0.628, "tongueOut": 0.07689}, 0.1),
    ],
)
def test_a_tongue_is_out_no_more_than_its_own_curve(moved, expected):
    assert raw_to_arkit(raw(**moved)).curves["TongueOut"][0] == pytest.approx(expected, abs=1e-4)


def test_gaze_turns_the_eyes_as_in_captures():
    """In real captures a left eye that looks in has positive yaw, and looking down positive pitch."""
    board = rest_curves(1).values.copy()
    board[0, default_controls().index("CTRL_L_eye.tx")] = -0.5  # towards the right: in
    board[0, default_controls().index("CTRL_L_eye.ty")] = -0.25
    board[0, default_controls().index("CTRL_R_eye.ty")] = 1.0
    curves = convert(RigCurves(board, default_controls().names), ARKIT_ID)
    assert curves["EyeLookInLeft"][0] == pytest.approx(0.5)
    assert curves["LeftEyeYaw"][0] == pytest.approx(np.radians(20))
    assert curves["LeftEyePitch"][0] == pytest.approx(np.radians(10))
    assert curves["RightEyePitch"][0] == pytest.approx(-np.radians(30))


def test_head_turns_as_unreals_blueprint_turns_it_and_back():
    turned = replace(raw(), head=[[10.0, -20.0, 5.0, 0.0, 0.0, 0.0]])
    curves = raw_to_arkit(turned).curves
    assert curves["HeadYaw"][0] * -50 == pytest.approx(10)
    assert curves["HeadPitch"][0] * 50 == pytest.approx(-20)
    assert curves["HeadRoll"][0] * 50 == pytest.approx(5)
    columns = replace(curves, head=None)  # as a Live Link CSV holds them
    np.testing.assert_allclose(arkit_to_raw(columns).head, turned.head, atol=1e-5)
    assert arkit_to_raw(replace(raw_to_arkit(raw()).curves)).head is None


def test_movement_outside_arkit_is_reported():
    fit = raw_to_arkit(raw(earUpL=1.0))
    assert fit.lost == 1.0 and fit.residual[0] == pytest.approx(1.0)
    assert "lossy preview: 100%" in str(fit)
    assert raw_to_arkit(raw()).lost == 0


def test_conversion_rejects_other_control_sets():
    with pytest.raises(ControlError, match=r"unknown control .* in arkit-61"):
        arkit_to_raw(raw())
    with pytest.raises(ControlError, match=r"unknown control .* in metahuman-raw"):
        raw_to_arkit(arkit())


def test_least_jaw_halves_contact_at_that_jaw_and_frees_a_resting_face():
    names = ("JawOpen", "MouthClose")
    pairs = np.array([[0.03, 0.03], [0.01, 0.012], [0.3, 0.3], [0.3, 0.15]], np.float32)
    shapes = RigCurves(pairs, names, control_set=ARKIT_ID).reorder(ARKIT)
    held = arkit_to_raw(shapes, least_jaw=0.03)[LIPS_TOGETHER[0]]
    # MouthClose * jaw / (jaw^2 + least^2)
    np.testing.assert_allclose(held, [0.5, 0.12, 0.09 / 0.0909, 0.045 / 0.0909], rtol=1e-5)
    np.testing.assert_allclose(arkit_to_raw(shapes)[LIPS_TOGETHER[0]], [1, 1, 1, 0.5], rtol=1e-6)
