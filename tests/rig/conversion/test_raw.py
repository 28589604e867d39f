import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from rig import RigCurves, default_controls, rest_curves
from rig.conversion.raw import RAW_ID, board_to_raw, raw_controls, raw_to_board

BOARD = default_controls()


def board(**values):
    """One frame of the board at rest with some channels set; `__` stands for the dot."""
    curves = rest_curves(1)
    frame = curves.values.copy()
    for name, value in values.items():
        frame[0, BOARD.index(name.replace("__", "."))] = value
    return RigCurves(frame, BOARD.names)


def raw_frame(curves):
    names = (name.removeprefix("CTRL_expressions_") for name in curves.names)
    return dict(zip(names, curves.values[0].tolist(), strict=True))


def moved(curves):
    rest = raw_controls().rest
    return {
        name: pytest.approx(value, abs=1e-6)
        for (name, value), at_rest in zip(raw_frame(curves).items(), rest, strict=True)
        if abs(value - at_rest) > 1e-6
    }


def test_there_are_251_raw_curves_and_only_wrinkle_upper_rests_at_one():
    raw = raw_controls()
    assert len(raw) == 251
    assert [n for n, r in zip(raw.names, raw.rest, strict=True) if r] == [
        "CTRL_expressions_noseWrinkleUpperL",
        "CTRL_expressions_noseWrinkleUpperR",
    ]


def test_rest_is_converted_to_rest():
    assert moved(board_to_raw(rest_curves(1))) == {}
    rest = raw_to_board(board_to_raw(rest_curves(1)))
    assert rest.values == pytest.approx(rest_curves(1).values)


@pytest.mark.parametrize(
    ("channel", "value", "expected"),
    [
        ("CTRL_C_jaw__ty", 0.5, {"jawOpen": 0.5}),
        ("CTRL_C_jaw__tx", 0.5, {"jawRight": 0.5}),
        ("CTRL_C_jaw__tx", -0.5, {"jawLeft": 0.5}),
        ("CTRL_C_mouth__tx", -0.25, {"mouthRight": 0.25}),
        ("CTRL_L_eye_blink__ty", -1.0, {"eyeWidenL": 1.0}),
        ("CTRL_C_tongue_inOut__ty", -0.3, {"tongueOut": 0.3}),
        ("CTRL_L_mouth_lipsPressU__ty", 1.0, {"mouthLipsPressL": 1.0}),
        ("CTRL_L_mouth_lipsPressD__ty", 1.0, {}),
        ("CTRL_L_nose_wrinkleUpper__ty", 0.25, {"noseWrinkleUpperL": 0.25}),
        ("CTRL_C_neck_swallow__ty", 0.3, {"neckSwallowPh1": 0.5, "neckSwallowPh2": 0.5}),
        ("CTRL_C_neck_swallow__ty", 0.9, {"neckSwallowPh4": 0.5}),
        ("CTRL_L_mouth_lipSticky__ty", 0.33, {"mouthLipsStickyLPh1": 1.0}),
        (
            "CTRL_L_mouth_lipSticky__ty",
            0.83,
            {"mouthLipsStickyLPh2": 0.5, "mouthLipsStickyLPh3": 0.5},
        ),
    ],
)
def test_raw_values_of_hand_worked_channels(channel, value, expected):
    assert moved(board_to_raw(board(**{channel: value}))) == expected


def test_middle_eye_is_added_to_both_eyes_and_clamped():
    curves = board(CTRL_C_eye__tx=0.75, CTRL_L_eye__tx=0.5, CTRL_R_eye__tx=-0.25)
    assert moved(board_to_raw(curves)) == {"eyeLookLeftL": 1.0, "eyeLookLeftR": 0.5}
    back = raw_to_board(board_to_raw(curves))
    assert back["CTRL_C_eye.tx"][0] == 0
    assert back["CTRL_R_eye.tx"][0] == pytest.approx(0.5)


@settings(max_examples=40, deadline=None)
@given(hnp.arrays(np.float32, (3, 185), elements=st.floats(0, 1, width=32)))
def test_round_trip_is_exact_where_the_map_is_invertible(unit):
    invertible = np.zeros(185, bool)
    invertible[BOARD.subset("driver")] = True
    values = np.where(
        invertible, BOARD.minimum + unit * (BOARD.maximum - BOARD.minimum), BOARD.rest
    )
    swallow = BOARD.index("CTRL_C_neck_swallow.ty")
    values[:, swallow] = np.minimum(values[:, swallow], 0.999)  # 1 looks like 0
    back = raw_to_board(board_to_raw(RigCurves(values, BOARD.names)))
    assert back.values == pytest.approx(values, abs=1e-6)


@settings(max_examples=20, deadline=None)
@given(hnp.arrays(np.float32, (2, 251), elements=st.floats(0, 1, width=32)))
def test_raw_to_board_is_a_projection(unit):
    """Raw vectors outside the board's range: a second round trip changes nothing."""
    raw = RigCurves(unit, raw_controls().names, control_set=RAW_ID)
    once = raw_to_board(raw)
    twice = raw_to_board(board_to_raw(once))
    assert twice.values == pytest.approx(once.values, abs=1e-5)


def test_agrees_with_the_published_links(shared, rng):
    import json

    links = json.loads((shared / "rig" / "gui_to_raw.json").read_text())["mappings"]
    values = rng.uniform(BOARD.minimum, BOARD.maximum, (50, 185)).astype(np.float32)
    for both in ("CTRL_C_eye.tx", "CTRL_C_eye.ty"):
        values[:, BOARD.index(both)] = 0
    curves = RigCurves(values, BOARD.names)
    expected = np.zeros((50, 251))
    reached = np.zeros((50, 251), bool)
    for link in links:
        x, column = curves[link["gui"]].astype(float), raw_controls().index(link["raw"])
        inside = (x >= link["from"]) & (x <= link["to"])
        # published slopes have six digits
        expected[:, column] = np.where(inside, link["slope"] * x + link["cut"], expected[:, column])
        reached[:, column] |= inside
    got = board_to_raw(curves).values
    assert got == pytest.approx(expected, abs=2e-5)
    assert reached.any(axis=0).all()


def test_names_without_prefix_and_of_the_older_rig_resolve():
    raw = raw_controls()
    assert raw.canonical("jawOpen") == "CTRL_expressions_jawOpen"
    assert raw.canonical("CTRL_expressions_tongueRollUp") == "CTRL_expressions_tongueBendUp"
