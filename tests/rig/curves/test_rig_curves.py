from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig import RigCurves, concatenate, default_controls, frames_to_time, rest_curves
from rig.curves import n_frames_for, snap_fps, time_to_frames
from rig.errors import ControlError, CurveError

JAW = "CTRL_C_jaw.ty"


def jaw(values, fps=30.0, **tracks):
    return RigCurves(np.reshape(values, (-1, 1)), (JAW,), fps, **tracks)


def test_frame_i_is_at_i_over_fps():
    assert frames_to_time([0, 1, 45], fps=30).tolist() == pytest.approx([0, 1 / 30, 1.5])
    assert jaw(np.zeros(91)).times[-1] == pytest.approx(3.0)
    assert jaw(np.zeros(90)).duration == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("seconds", "fps", "frames"),
    [
        (1.0, 30, 30),
        (1.01, 30, 31),
        (0.1, 30, 3),
        (5.1, 30, 153),
        (0, 30, 0),
        (10, 30000 / 1001, 300),
    ],
)
def test_a_clip_has_the_ceiling_of_its_frames(seconds, fps, frames):
    assert n_frames_for(seconds, fps=fps) == frames


@pytest.mark.parametrize(
    ("given_fps", "meant"),
    [(29.97, 30000 / 1001), (23.976, 24000 / 1001), (59.94, 60000 / 1001), (30, 30), (29.9, 29.9)],
)
def test_broadcast_rates_are_exact_fractions(given_fps, meant):
    assert snap_fps(given_fps) == meant


@pytest.mark.parametrize("fps", [0, -1, np.nan, np.inf, 301])
def test_curves_reject_invalid_rates(fps):
    with pytest.raises(CurveError, match=r"must be from 1 to 300"):
        jaw([0.0], fps=fps)


def test_doubling_the_rate_puts_a_frame_between_two():
    doubled = jaw([0.0, 1.0, 0.5]).resample(60)
    assert doubled[JAW].tolist() == pytest.approx([0, 0.5, 1, 0.75, 0.5, 0.5])
    assert doubled.fps == 60


def test_24_fps_samples_every_1_25_frames_of_30_fps():
    # frame j of 24 lies at frame 1.25 j of 30
    values = jaw(np.arange(10) / 10).resample(24)[JAW]
    assert values.tolist() == pytest.approx([0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875])


def test_2997_drifts_by_one_frame_in_a_thousand():
    curves = jaw(np.arange(1001) / 1001).resample(29.97)
    assert len(curves) == 1000
    # after 999 frames of 1001/30000 s the time is 999 * 1.001 frames of 1/30 s
    assert curves[JAW][999] == pytest.approx(999 * 1.001 / 1001, abs=1e-4)


@given(st.integers(1, 200), st.sampled_from([24, 25, 29.97, 30, 50, 60]))
def test_resampling_keeps_the_duration(n_frames, fps):
    curves = jaw(np.zeros(n_frames))
    resampled = curves.resample(fps)
    assert 0 <= resampled.duration - curves.duration < 1 / resampled.fps + 1e-9


@given(st.lists(st.floats(0, 1, width=32), min_size=1, max_size=50))
def test_resampling_to_a_multiple_and_back_changes_nothing(values):
    there = jaw(values).resample(60)
    assert there.resample(30)[JAW].tolist() == pytest.approx(values, abs=1e-6)


def test_resampling_a_straight_line_is_exact_and_bounded():
    line = jaw(np.arange(100) / 100)
    for fps in (24, 25, 29.97, 50, 60):
        resampled = line.resample(fps)
        inside = resampled.times <= 99 / 30
        assert resampled[JAW][inside] == pytest.approx(resampled.times[inside] * 0.3, abs=1e-6)
        assert resampled.values.max() <= line.values.max()


def test_tracks_are_resampled_with_the_values():
    emotion = np.zeros((2, 5))
    emotion[1, 2] = 1
    curves = jaw([0.0, 1.0], emotion=emotion, intensity=[0.0, 2.0]).resample(60)
    assert curves.emotion[:, 2].tolist() == [0, 0.5, 1, 1]
    assert curves.intensity.tolist() == [0, 1, 2, 2]


def test_emotions_without_moods_get_columns_of_zeros():
    curves = jaw([0.0], emotion=[[0, 0, 0.5, 0, 0.5]])
    assert curves.emotion.tolist() == [[0, 0, 0.5, 0, 0.5, 0, 0, 0, 0]]


def test_slices_by_frame_and_by_second_agree():
    curves = jaw(np.arange(60), intensity=np.arange(60))
    by_frame, by_second = curves.slice_frames(15, 45), curves.slice_seconds(0.5, 1.5)
    assert by_frame[JAW].tolist() == by_second[JAW].tolist() == list(range(15, 45))
    assert by_frame.intensity.tolist() == list(range(15, 45))


@given(st.integers(0, 60), st.integers(0, 60))
def test_parts_join_to_the_whole(a, b):
    curves = jaw(np.arange(60), intensity=np.arange(60))
    low, high = sorted((a, b))
    parts = [curves.slice_frames(0, low), curves.slice_frames(low, high), curves.slice_frames(high)]
    whole = concatenate(parts)
    assert whole[JAW].tolist() == curves[JAW].tolist()
    assert whole.intensity.tolist() == curves.intensity.tolist()


def test_concatenate_rejects_parts_that_differ():
    with pytest.raises(CurveError, match="part 2 has 60 fps and part 1 has 30; resample"):
        concatenate([jaw([0.0]), jaw([0.0], fps=60)])
    with pytest.raises(CurveError, match="other controls"):
        concatenate([jaw([0.0]), RigCurves(np.zeros((1, 1)), ("CTRL_C_jaw.tx",))])
    with pytest.raises(CurveError, match="no curves"):
        concatenate([])


def test_track_is_dropped_where_one_part_lacks_it():
    assert concatenate([jaw([0.0], intensity=[1.0]), jaw([0.0])]).intensity is None


def test_mirror_swaps_sides_and_negates_the_jaw(rng):
    curves = RigCurves(rng.random((3, 185)), default_controls().names)
    mirrored = curves.mirror()
    assert (mirrored["CTRL_L_mouth_cornerPull.ty"] == curves["CTRL_R_mouth_cornerPull.ty"]).all()
    assert (mirrored["CTRL_C_jaw.tx"] == -curves["CTRL_C_jaw.tx"]).all()
    assert (mirrored[JAW] == curves[JAW]).all()
    assert (mirrored.mirror().values == curves.values).all()


def test_mirror_needs_the_other_side():
    with pytest.raises(ControlError, match=r"CTRL_R_brow_down.ty"):
        RigCurves(np.zeros((1, 1)), ("CTRL_L_brow_down.ty",)).mirror()


def test_reorder_fills_with_rest_and_select_takes_back():
    full = jaw([0.25, 0.5]).reorder()
    assert full.names == default_controls().names
    assert full["CTRL_L_nose_wrinkleUpper.ty"].tolist() == [1, 1]
    assert full.select(["CTRL_C_jaw.Y"])[JAW].tolist() == [0.25, 0.5]


def test_rest_curves_are_the_rest_values():
    rest = rest_curves(3, fps=25)
    assert (rest.values == default_controls().rest).all() and rest.fps == 25


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"values": np.zeros(3)}, r"values has shape \(3,\); it must be \(frames, 1\)"),
        ({"values": np.zeros((3, 2))}, r"it must be \(frames, 1\)"),
        ({"values": [[0.0], [np.nan]]}, r"values is nan at \(1, 0\)"),
        ({"values": [[np.inf]]}, "must be finite"),
        ({"values": [[1e39]]}, "must be finite"),
        ({"values": [[0.0]], "emotion": np.zeros((1, 4))}, r"it must be \(1, 9\)"),
        ({"values": [[0.0]], "intensity": [1.0, 1.0]}, r"it must be \(1\)"),
        ({"values": [[0.0]], "intensity": [-0.5]}, "intensity falls to -0.5"),
    ],
)
@pytest.mark.filterwarnings("ignore:overflow encountered")
def test_curves_reject_wrong_shapes_and_values(fields, message):
    with pytest.raises(CurveError, match=message):
        RigCurves(names=(JAW,), **fields)


def test_curves_reject_doubled_names():
    with pytest.raises(ControlError, match="occurs twice"):
        RigCurves(np.zeros((1, 2)), (JAW, JAW))


def test_values_are_a_private_copy_and_cannot_be_changed():
    values = np.zeros((2, 1), np.float32)
    curves = jaw(values)
    values[0] = 9
    assert curves.values[0, 0] == 0
    with pytest.raises(ValueError, match="read-only"):
        curves.values[0, 0] = 1


def test_absent_control_is_in_the_message():
    with pytest.raises(ControlError, match=r"'CTRL_C_jaw.tx' is not among these 1 curves"):
        jaw([0.0])["CTRL_C_jaw.tx"]


def test_time_to_frames_rejects_times_that_are_no_numbers():
    with pytest.raises(CurveError, match="not a finite number"):
        time_to_frames(float("nan"), fps=30)


HEAD_ROWS = np.array([[10, -5, 2, 0.1, 0.2, 0.3], [20, 5, -4, 0.3, 0.0, -0.1]], np.float32)


def test_head_track_follows_slices_rates_and_joins():
    curves = replace(rest_curves(2), head=HEAD_ROWS)
    np.testing.assert_array_equal(curves.slice_frames(1).head, HEAD_ROWS[1:])
    np.testing.assert_allclose(curves.resample(60).head[1], HEAD_ROWS.mean(axis=0), rtol=1e-6)
    np.testing.assert_array_equal(concatenate([curves, curves]).head[2:], HEAD_ROWS)
    assert concatenate([curves, rest_curves(2)]).head is None
    assert list(curves.tracks) == ["head"]


def test_mirrored_head_turns_to_the_other_side():
    mirrored = replace(rest_curves(2), head=HEAD_ROWS).mirror().head
    np.testing.assert_allclose(mirrored[0], [-10, -5, -2, -0.1, 0.2, 0.3])


@pytest.mark.parametrize("head", [np.zeros((2, 3)), np.full((2, 6), np.nan), np.zeros((3, 6))])
def test_head_track_rejects_other_shapes_and_nan(head):
    with pytest.raises(CurveError, match="head"):
        replace(rest_curves(2), head=head)
