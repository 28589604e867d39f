import numpy as np
import pytest

from rig import RigCurves, clamp, default_controls, gain, rest_curves, smooth
from rig.curves.edit import parse_gains
from rig.errors import ControlError, CurveError
from tests.errors import one_line

JAW = "CTRL_C_jaw.ty"
WRINKLE = "CTRL_L_nose_wrinkleUpper.ty"


def jaw(values):
    return RigCurves(np.reshape(values, (-1, 1)), (JAW,))


def test_clamp_reports_which_how_often_and_how_far():
    values = np.tile(default_controls().rest, (4, 1))
    column = default_controls().index
    values[:2, column(JAW)] = [1.5, 1.25]
    values[3, column("CTRL_C_jaw.tx")] = -1.1
    clamped, report = clamp(RigCurves(values, default_controls().names))
    assert clamped[JAW].tolist() == [1, 1, 0, 0]
    assert [(c.name, c.n_frames) for c in report.clipped] == [(JAW, 2), ("CTRL_C_jaw.tx", 1)]
    assert report.clipped[0].worst_excess == pytest.approx(0.5)
    assert (
        str(report)
        == "3 values of 2 controls were clamped to their ranges; worst CTRL_C_jaw.ty by 0.5"
    )


def test_clamp_returns_the_same_object_within_range():
    curves = rest_curves(3)
    clamped, report = clamp(curves)
    assert clamped is curves and not report
    assert str(report) == "all values are within their ranges"


def test_gain_scales_the_distance_from_rest():
    curves = rest_curves(1)
    values = curves.values.copy()
    values[0, curves.index(WRINKLE)] = 0.5
    values[0, curves.index(JAW)] = 0.25
    changed = gain(RigCurves(values, curves.names), {"all": 2.0})
    assert changed[JAW][0] == pytest.approx(0.5)
    assert changed[WRINKLE][0] == pytest.approx(0.0)  # 1 + 2 * (0.5 - 1)
    assert gain(curves, {"all": 0.0}).values.tolist() == curves.values.tolist()


def test_gains_multiply_and_offsets_add_over_sets_and_controls():
    changed = gain(jaw([0.1]), {"jaw": 2.0, JAW: 3.0}, {"jaw": 0.1, "CTRL_C_jaw.Y": 0.05})
    assert changed[JAW][0] == pytest.approx(0.1 * 6 + 0.15)


def test_gain_of_a_region_leaves_the_others():
    curves = RigCurves(np.full((1, 185), 0.5), default_controls().names)
    changed = gain(curves, {"brow": 0.5})
    moved = {
        n
        for n, a, b in zip(curves.names, curves.values[0], changed.values[0], strict=True)
        if a != b
    }
    assert moved == {default_controls().names[i] for i in default_controls().subset("brow")}


def test_gains_are_read_from_a_text():
    assert parse_gains("brow=0.5, mouth=1.2") == {"brow": 0.5, "mouth": 1.2}
    assert parse_gains({"jaw": 2}) == {"jaw": 2} and parse_gains(None) == {}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("brow", "NAME=NUMBER"),
        ("", "NAME=NUMBER"),
        ("jaw=x", "NAME=NUMBER"),
        ("jaw=inf", "gain of jaw is inf"),
        ("jaw=1.2,brow=1,jaw=2", "gain of jaw is given twice"),
        ({"jaw": "2"}, "it must be a number"),
    ],
)
def test_gains_that_are_none_are_one_line(text, message):
    with one_line(CurveError, match=message):
        parse_gains(text)


def test_gain_rejects_invalid_numbers_and_names():
    with pytest.raises(CurveError, match="gain of jaw is nan"):
        gain(jaw([0.0]), {"jaw": float("nan")})
    with pytest.raises(ControlError, match="unknown control 'jar'"):
        gain(jaw([0.0]), {"jar": 1.0})


def test_smoothing_lowers_jitter_and_keeps_the_mean(rng):
    noisy = jaw(0.6 + 0.05 * rng.standard_normal(300))
    smoothed = smooth(noisy, 0.05)
    assert np.diff(smoothed[JAW]).std() < 0.3 * np.diff(noisy[JAW]).std()
    assert smoothed[JAW].mean() == pytest.approx(noisy[JAW].mean(), abs=0.002)


def test_smoothing_keeps_closures_shut_where_a_low_pass_opens_them():
    values = np.full(60, 0.5)
    values[30:32] = 0.02  # a p of 67 ms
    assert smooth(jaw(values), 0.05, keep_closures=False)[JAW][30] > 0.15
    kept = smooth(jaw(values), 0.05)[JAW]
    assert kept[30:32] == pytest.approx(0.02)
    assert np.abs(np.diff(kept)).max() <= 0.5


def test_smoothing_one_region_leaves_the_others(rng):
    curves = RigCurves(rng.random((50, 185)), default_controls().names)
    smoothed = smooth(curves, 0.05, names=["brow"])
    changed = np.flatnonzero((smoothed.values != curves.values).any(axis=0))
    assert changed.tolist() == default_controls().subset("brow").tolist()


def test_constant_curves_and_zero_width_stay():
    curves = rest_curves(10)
    assert smooth(curves, 0.1).values == pytest.approx(curves.values, abs=1e-6)
    assert smooth(curves, 0.0) is curves


@pytest.mark.parametrize("seconds", [-0.1, float("nan"), float("inf")])
def test_smooth_rejects_invalid_widths(seconds):
    with pytest.raises(CurveError, match="finite time of 0 or more"):
        smooth(rest_curves(3), seconds)
