"""Measures of the evaluation on curves made by hand."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from deitalk.audio.load import Recording
from deitalk.audio.noise import mix, pink_noise, read_noises
from deitalk.audio.voice_activity import active_level_db
from deitalk.corpus.performance import _prosody_label
from deitalk.corpus.prosody_contours import apply_contour, random_contour
from deitalk.corpus.rig_targets import style_poses
from deitalk.emotions import EMOTIONS
from deitalk.emotions.rules import face_distance, lip_range, recognise
from deitalk.errors import DataError
from deitalk.evaluation.curve_statistics import captured_smoothness, smoothness
from deitalk.evaluation.experiments import lively_report
from deitalk.evaluation.phone_gestures import (
    BITE,
    CLOSURE,
    ROUNDING,
    gesture_curve,
    gesture_peaks,
    global_lag_ms,
    jaw_in_contact,
    lag_scores,
    phone_table,
)
from deitalk.evaluation.prosody_response import (
    STEP_Z,
    constant,
    halves,
    level_curve,
    modified,
    spearman,
    wandering,
)
from deitalk.pipeline.curves import Performance
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


def test_vowels_beside_a_closure_are_no_counter_examples():
    curve = np.zeros(90, np.float32)
    curve[33] = 0.7  # 1.1 s: IY, beside M
    curve[42] = 0.3  # 1.4 s: AA, clear
    assert gesture_peaks(curve, PHONES, CLOSURE)["-"] == pytest.approx([0.3])


def test_phone_table_counts_hits_over_the_alarm_level():
    collected = [{"P": [0.9, 0.1], "-": [0.2] * 10}, {"M": [0.5], "-": [0.2] * 10}]
    table = phone_table(collected, CLOSURE)
    assert table["P"] == {"n": 2, "hits": 0.5, "auc": 0.5}
    assert table["M"]["hits"] == 1
    assert table["B"]["n"] == 0
    assert np.isnan(table["B"]["hits"])


@pytest.mark.parametrize(
    ("gesture", "name", "n"),
    [(CLOSURE, "lipsTogetherU", 4), (BITE, "lipBiteD", 2), (ROUNDING, "purseU", 8)],
)
def test_gestures_average_their_controls(gesture, name, n):
    curves = np.zeros((3, len(CONTROLS.names)), np.float32)
    curves[1, CONTROLS.index(f"CTRL_L_mouth_{name}.ty")] = 1
    np.testing.assert_allclose(gesture_curve(curves, CONTROLS, gesture), [0, 1 / n, 0])


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


@pytest.mark.parametrize("emotion", EMOTIONS)
def test_rule_recognises_prototypes_at_full_and_half_strength(emotion):
    pose = style_poses(CONTROLS)[EMOTIONS.index(emotion)].astype(np.float32)
    speaking = np.array([True, True, False])
    for strength in (0.5, 1.0):
        curves = np.tile(CONTROLS.rest + strength * pose, (3, 1))
        curves[2] = CONTROLS.rest
        assert recognise(curves, speaking, CONTROLS) == emotion


def test_weak_smile_is_neutral_and_strong_smile_is_not():
    curves = np.tile(CONTROLS.rest, (2, 1))
    for size, name in ((0.09, "neutral"), (0.5, "happy")):
        for side in "LR":
            curves[:, CONTROLS.index(f"CTRL_{side}_mouth_cornerPull.ty")] = size
            curves[:, CONTROLS.index(f"CTRL_{side}_eye_cheekRaise.ty")] = size
        assert recognise(curves, np.zeros(2, bool), CONTROLS) == name


def test_distance_and_range_by_hand():
    a, b = np.zeros((2, 4), np.float32), np.zeros((2, 4), np.float32)
    b[0, :2] = 3, 4
    assert face_distance(a, b) == 2.5
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


def test_level_curve_follows_a_step_of_20_db_and_ignores_pauses():
    tone = np.sin(2 * np.pi * 200 * np.arange(64_000) / 16_000).astype(np.float32) * 0.3
    tone[32_000:] *= 0.1
    level = level_curve(tone, 120)
    assert level[20] - level[100] == pytest.approx(20, abs=0.5)
    paused = np.concatenate((tone[:32_000], np.zeros(16_000, np.float32), tone[:32_000]))
    level = level_curve(paused, 150)
    assert level[55] == pytest.approx(level[20], abs=0.5)  # beside the pause


def test_modified_halves_give_their_frames():
    take, z, frames = modified(recording(), halves(1.0, 3.0))
    assert len(z) == len(frames) == take.n_frames
    assert z[5] == pytest.approx(1)
    assert z[-5] == pytest.approx(-1)
    assert frames[0] == 0 and frames[-1] == pytest.approx(recording().n_frames - 1, abs=1)
    assert frames[len(z) // 4] > len(z) // 4  # the half of raised prosody is faster
    livelier = modified(recording(), constant(1.0, 3.0)).take
    duller = modified(recording(), constant(-1.0, 3.0)).take
    louder = 20 * np.log10(livelier.waveform.std() / duller.waveform.std())
    assert 8 < louder < 15  # 4.5 dB per unit, and more in the treble
    assert livelier.duration < duller.duration


def test_wandering_is_the_same_for_one_seed():
    first, z, lively = wandering(recording(), 3)
    again = wandering(recording(), 3)
    np.testing.assert_array_equal(first.waveform, again[0].waveform)
    assert len(z) == len(lively) == first.n_frames
    assert np.ptp(z) > 0.1


def syllables(seconds: float, until: float) -> Recording:
    """Syllables of 0.2 s every 0.3 s, up to a moment."""
    t = np.arange(int(seconds * 16_000)) / 16_000
    tone = np.sin(2 * np.pi * 200 * t) + 0.5 * np.sin(2 * np.pi * 700 * t)
    tone *= (np.mod(t, 0.3) > 0.1) & (t > 0.2) & (t < until)
    noise = 1e-4 * np.random.default_rng(0).standard_normal(len(t))
    return Recording((0.05 * tone + noise).astype(np.float32), "test", 16_000, 1, 0.0)


@pytest.mark.parametrize(("sign", "share"), [(1, 1.0), (-1, 0.0)])
def test_takes_are_compared_over_common_speech(monkeypatch, sign, share):
    """A face that opens with the level, or against it; the second voice is silent in its half."""

    def follows_level(take, emotion, **_):
        level = 0.5 + sign * level_curve(take.waveform, take.n_frames) / 100
        values = np.repeat(level[:, None], len(CONTROLS.names), axis=1).astype(np.float32)
        curves = RigCurves(values, CONTROLS.names, fps=30)
        still = RigCurves(0 * values, CONTROLS.names, fps=30)
        zeros = np.zeros(take.n_frames, np.float32)
        return Performance(curves, still, zeros, zeros, take, 0)

    monkeypatch.setattr("deitalk.evaluation.experiments.animate", follows_level)
    model = SimpleNamespace(controls=CONTROLS)
    report = lively_report(model, [syllables(5, 5), syllables(6, 2.6)])  # type: ignore[arg-type]
    assert report["pairs_whole"] == 2 and report["pairs_within"] == 2 + 1
    for name in ("whole_opens", "whole_expresses", "within_opens", "within_expresses"):
        assert report[name] == share, name


def test_whole_takes_are_compared_over_the_same_words(monkeypatch):
    """Every second syllable is 30 dB fainter, and undetected in the take of lowered prosody.

    The mouth opens by .01 per decibel, so the raised take opens more over the same words; over the
    detected speech of each take, the lowered one would open more.
    """

    def decibels(waveform):
        n = -(-len(waveform) * 30 // 16_000)
        padded = np.pad(waveform, (0, n * 534)).astype(np.float64)
        pieces = np.stack([padded[i * 16_000 // 30 :][:533] for i in range(n)])
        return 10 * np.log10(np.square(pieces).mean(axis=1) + 1e-10)

    def opens_by_level(take, emotion, **_):
        opening = 1 + decibels(take.waveform)[: take.n_frames] / 100
        values = np.repeat(opening[:, None], len(CONTROLS.names), axis=1).astype(np.float32)
        curves = RigCurves(values, CONTROLS.names, fps=30)
        still = RigCurves(0 * values, CONTROLS.names, fps=30)
        zeros = np.zeros(take.n_frames, np.float32)
        return Performance(curves, still, zeros, zeros, take, 0)

    def detect(waveform):
        return (decibels(waveform) > faint_db - 2).astype(np.float32)

    sound = syllables(6, 6)
    faint = np.mod(np.arange(len(sound.waveform)) / 16_000, 0.6) < 0.3
    sound = replace(sound, waveform=np.where(faint, sound.waveform / 31.6, sound.waveform))
    loud_db = np.percentile(decibels(sound.waveform), 95)
    faint_db = loud_db - 30
    dull = modified(sound, constant(-STEP_Z, sound.duration)).take
    assert detect(sound.waveform).mean() > 1.4 * detect(dull.waveform).mean()
    monkeypatch.setattr("deitalk.evaluation.experiments.animate", opens_by_level)
    monkeypatch.setattr("deitalk.evaluation.experiments.speech_activity", detect)
    report = lively_report(SimpleNamespace(controls=CONTROLS), [sound])  # type: ignore[arg-type]
    assert report["pairs_whole"] == 1 and report["pairs_within"] == 2
    assert report["whole_opens"] == 1 and report["within_opens"] == 1


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

    monkeypatch.setattr("deitalk.evaluation.experiments.animate", follows_the_level)
    model = SimpleNamespace(controls=CONTROLS)
    alone = lively_report(model, [flipped])  # type: ignore[arg-type]
    both = lively_report(model, [syllables(5, 5), flipped])  # type: ignore[arg-type]
    assert alone["above_level"] == pytest.approx(-2 * alone["level_rho"])
    assert np.isnan(alone["above_level_error"])
    for end in ("", "_contour"):
        assert both[f"above_level{end}"] < 0
        assert both[f"above_level{end}_error"] == pytest.approx(-both[f"above_level{end}"])


def test_label_equals_that_of_the_corpus():
    take, z, lively = wandering(recording(), 3)
    contour = random_contour(recording().duration, np.random.default_rng(3))
    moved = apply_contour(recording().waveform, contour)[1]
    times = np.interp(np.arange(take.n_frames) / 30, moved[1], moved[0])
    expected = _prosody_label(recording().waveform, contour, times)
    np.testing.assert_allclose(lively, expected, atol=1e-4)
    assert np.abs(z - lively).max() > 0.02


def test_smoothness_of_a_ramp_and_of_a_sine():
    times = np.arange(90) / 30
    sine = np.sin(2 * np.pi * times)[:, None].astype(np.float32)
    still = np.zeros((90, 1), np.float32)
    measured = smoothness(np.hstack((sine, still)))
    # third over first derivative of sin(w t) is w squared, a little less on a grid
    assert measured["jerk_per_speed"] == pytest.approx((2 * np.pi) ** 2, rel=0.05)
    step = sine.copy()
    step[45:] += 1
    assert smoothness(step)["largest_step"] == pytest.approx(1, abs=0.25)
    assert smoothness(step)["jerk_per_speed"] > 5 * measured["jerk_per_speed"]
    assert smoothness(still) == {}


def test_captured_curves_are_measured_or_refused(tmp_path: Path):
    values = np.zeros((90, len(CONTROLS.names)), np.float32)
    values[:, CONTROLS.index("CTRL_C_jaw.ty")] = 0.5 + 0.5 * np.sin(np.arange(90) / 5)
    write_curves(tmp_path / "a.csv", RigCurves(values, CONTROLS.names, fps=30))
    assert captured_smoothness(tmp_path / "a.csv", CONTROLS)["largest_step"] < 0.11
    write_curves(tmp_path / "b.csv", RigCurves(values * 0, CONTROLS.names, fps=30))
    with pytest.raises(DataError, match="moves; give a take"):
        captured_smoothness(tmp_path / "b.csv", CONTROLS)


@pytest.mark.parametrize("snr_db", [20.0, 0.0])
def test_noise_has_the_given_ratio(snr_db):
    speech = waveform(0)
    noise = mix(speech, pink_noise(16_000), snr_db) - speech
    level = 10 * np.log10(np.square(noise, dtype=np.float64).mean())
    assert active_level_db(speech) - level == pytest.approx(snr_db, abs=0.2)


def test_pink_noise_falls_3_db_an_octave():
    power = np.abs(np.fft.rfft(pink_noise(160_000))) ** 2
    octaves = [10 * np.log10(power[1000 * 2**k : 2000 * 2**k].mean()) for k in range(4)]
    np.testing.assert_allclose(np.diff(octaves), -3, atol=0.4)


def test_noise_comes_from_a_folder_with_recordings(tmp_path: Path):
    with pytest.raises(DataError, match="neither a folder"):
        read_noises(str(tmp_path / "absent"))
    with pytest.raises(DataError, match="holds no"):
        read_noises(str(tmp_path))
