"""Measures of the evaluation on curves made by hand."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from deitalk.audio.load import Recording
from deitalk.errors import DataError
from deitalk.pipeline.curves import Performance
from deitalk.research.evaluation.clip_scores import (
    captured_smoothness,
    global_lag_ms,
    lag_scores,
    opening_in_silence,
    unlabelled_speech,
)
from deitalk.research.evaluation.contour_scores import contours_report
from deitalk.research.evaluation.contours import level_curve, spearman
from deitalk.research.evaluation.gestures import (
    CLOSURE,
    gesture_peaks,
    jaw_in_contact,
    phone_table,
    shut_frames,
    shut_table,
)
from deitalk.research.evaluation.noise import read_noises
from deitalk.research.evaluation.styles import lip_range, style_distances
from rig import RigCurves, default_controls, write_curves
from tests.dataset import waveform

CONTROLS = default_controls()
PHONES = [(0.0, 1.0, "SIL"), (1.0, 1.1, "M"), (1.1, 1.12, "IY"), (1.3, 1.5, "AA"), (1.8, 1.9, "F")]


def recording(seed: int = 0) -> Recording:
    return Recording(waveform(seed), "test", 16_000, 1, 0.0)


def test_a_closure_two_frames_early_counts_and_three_frames_early_does_not():
    for early, found in ((2, 1.0), (3, 0.0)):
        curve = np.zeros(90, np.float32)
        curve[30 - early] = 1
        assert gesture_peaks(curve, PHONES, CLOSURE)["M"] == [found]


def test_phone_table_counts_hits_over_the_alarm_level():
    collected = [{"P": [0.9, 0.1], "-": [0.2] * 10}, {"M": [0.5], "-": [0.2] * 10}]
    table = phone_table(collected, CLOSURE)
    assert table["P"] == {"n": 2, "hits": 0.5, "auc": 0.5}
    assert table["M"]["hits"] == 1
    assert table["B"]["n"] == 0
    assert np.isnan(table["B"]["hits"])


def test_jaw_in_contact_uses_held_lips_only():
    lips, jaw = np.array([0, 0.95, 1.0]), np.array([1, 0.2, 0.4])
    assert jaw_in_contact(lips, jaw) == pytest.approx(0.3)
    assert np.isnan(jaw_in_contact(lips * 0.5, jaw))


@pytest.mark.parametrize("late_ms", [-50.0, 0.0, 17.0, 100.0])
def test_lag_is_interpolated_between_frames(late_ms):
    times = np.arange(300) / 30
    target = np.sin(2 * np.pi * 1.3 * times)
    predicted = np.sin(2 * np.pi * 1.3 * (times - late_ms / 1000))
    assert global_lag_ms([lag_scores(target, predicted)]) == pytest.approx(late_ms, abs=2)


def test_shut_lips_are_counted_away_from_contacts():
    """M from 1 to 1.1 s; AA from 1.3 to 1.5 s (6 frames) is shut in two; IY is beside M."""
    lips = np.zeros(90, np.float32)
    lips[30:34] = 1
    lips[40:42] = 0.6
    counts = shut_frames(lips, PHONES)
    assert counts == {"AA": (6, 2), "IY": (0, 0)}
    table = shut_table([counts, {"AA": (6, 0), "S": (3, 1)}])
    assert table["AA"] == {"n": 12, "shut": pytest.approx(1 / 6)}
    assert table["all"] == {"n": 15, "shut": pytest.approx(0.2)}


def test_speech_that_the_phones_call_silence_is_counted():
    """Speech from 0 to 1 s and 2 to 3 s; a phone covers 0.15 s beyond its ends."""
    activity = np.repeat([1, 0, 1], 30).astype(np.float32)
    whole = [(0, 1, "AA"), (1, 2, "SIL"), (2, 3, "B")]
    assert unlabelled_speech(activity, whole) == 0
    assert unlabelled_speech(activity, [(0, 1, "AA"), (1, 3, "SIL")]) == pytest.approx(0.5)
    # to 2.5 + 0.15 s: frames 60 to 79 of 60 to 89
    half = [*whole[:2], (2, 2.5, "B"), (2.5, 3, "SIL")]
    assert unlabelled_speech(activity, half) == pytest.approx(10 / 60)
    assert unlabelled_speech(activity, []) == 1 and unlabelled_speech(0 * activity, whole) == 0


def test_opening_in_silence_uses_the_times_of_the_phones():
    """Silence from 0 to 1 s, of which 0.25 to 0.85 s counts, whatever the sound is."""
    opening = np.zeros(60, np.float32)
    opening[30:] = 0.5
    assert opening_in_silence(opening, [(0, 1, "SIL"), (1, 2, "AA")]) == 0
    opening[:30] = 0.25
    assert opening_in_silence(opening, [(0, 1, "SIL"), (1, 2, "AA")]) == pytest.approx(0.5)
    assert np.isnan(opening_in_silence(opening, [(0, 0.5, "SIL"), (0.5, 2, "AA")]))


def test_style_distances_by_hand():
    """Two styles 4 apart; the first's recordings are each 2 from the other."""
    faces = {
        "a": np.array([[0, 1], [0, -1]], np.float32),
        "b": np.array([[4, 0], [4, 0]], np.float32),
        "c": np.array([[0, 10], [0, 10]], np.float32),
    }
    styles, pairs = style_distances(faces)
    assert styles["a"] == {"spread": 2, "nearest": "b", "distance": 4, "separation": 2}
    assert styles["b"]["nearest"] == "a" and styles["b"]["separation"] == 2
    assert pairs["a-c"] == 10 and len(pairs) == 3
    alone, _ = style_distances({name: rows[:1] for name, rows in faces.items()})
    assert np.isnan(alone["a"]["separation"])


def test_range_of_the_lips_by_hand():
    opening = np.linspace(0, 1, 101, dtype=np.float32)
    speaking = np.ones(101, bool)
    assert lip_range(opening, speaking) == pytest.approx(0.9)
    assert lip_range(opening, opening < 0.5) < 0.46
    assert np.isnan(lip_range(opening, ~speaking))


def test_spearman_uses_frames_of_speech_only():
    label = np.arange(40.0)
    predicted = np.concatenate((np.arange(20.0) ** 3, np.zeros(20)))
    within = np.arange(40) < 20
    assert spearman(label, predicted, within) == pytest.approx(1)
    assert spearman(label, -predicted, within) == pytest.approx(-1)
    assert np.isnan(spearman(label, predicted, np.arange(40) >= 20))


def syllables(seconds: float, until: float) -> Recording:
    """Syllables of 0.2 s every 0.3 s, up to a moment."""
    t = np.arange(int(seconds * 16_000)) / 16_000
    tone = np.sin(2 * np.pi * 200 * t) + 0.5 * np.sin(2 * np.pi * 700 * t)
    tone *= (np.mod(t, 0.3) > 0.1) & (t > 0.2) & (t < until)
    noise = 1e-4 * np.random.default_rng(0).standard_normal(len(t))
    return Recording((0.05 * tone + noise).astype(np.float32), "test", 16_000, 1, 0.0)


def test_intensity_is_compared_with_level_and_its_error(monkeypatch):
    """Level itself is 0 above level; negated, it is twice level's correlation below it.

    Of the two, the mean is -r and its standard error r, where r is level's in the second.
    """
    flipped = replace(syllables(6, 6), source="upside down")

    def follows_the_level(take, emotion, **_):
        sign = -1 if take.source == "upside down" else 1
        curves = RigCurves(np.zeros((take.n_frames, 185)), CONTROLS.names, fps=30)
        level = sign * level_curve(take.waveform, take.n_frames)
        return Performance(curves, curves, level, level, take, 0)

    monkeypatch.setattr("deitalk.research.evaluation.contour_scores.animate", follows_the_level)
    model = SimpleNamespace(controls=CONTROLS)
    alone = contours_report(model, [flipped])  # type: ignore[arg-type]
    both = contours_report(model, [syllables(5, 5), flipped])  # type: ignore[arg-type]
    assert alone["above_level"] == pytest.approx(-2 * alone["level_rho"])
    assert alone["network_rho"] == alone["intensity_rho"] and alone["index_rho"] > 0
    assert np.isnan(alone["above_level_error"])
    assert both["above_level"] < 0
    assert both["above_level_error"] == pytest.approx(-both["above_level"])


def test_captured_curves_are_measured_or_refused(tmp_path: Path):
    values = np.zeros((90, len(CONTROLS.names)), np.float32)
    values[:, CONTROLS.index("CTRL_C_jaw.ty")] = 0.5 + 0.5 * np.sin(np.arange(90) / 5)
    write_curves(tmp_path / "a.csv", RigCurves(values, CONTROLS.names, fps=30))
    assert captured_smoothness(tmp_path / "a.csv", CONTROLS)["largest_step"] < 0.11
    write_curves(tmp_path / "b.csv", RigCurves(values * 0, CONTROLS.names, fps=30))
    with pytest.raises(DataError, match="moves; give a take"):
        captured_smoothness(tmp_path / "b.csv", CONTROLS)


def test_noise_comes_from_a_folder_with_recordings(tmp_path: Path):
    with pytest.raises(DataError, match="neither a folder"):
        read_noises(str(tmp_path / "absent"))
    with pytest.raises(DataError, match="holds no"):
        read_noises(str(tmp_path))
