"""Offset and drift of takes: planted ones are found, by hand-made and by predicted curves."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from deitalk.audio.load import load_audio
from deitalk.data.offset import (
    FAR_RATE,
    LAGS,
    NTSC_DRIFT,
    ClipLags,
    ClipSignals,
    clip_lags,
    far_lag,
    fit_rate,
    sharpest_peak,
    take_sync,
)
from deitalk.models.checkpoint import load_model
from deitalk.pipeline.curves import animate
from rig import RigCurves
from tests.deitalk.cli.test_cli import ROOT

FRAME = 1 / 30
SHIFTS = (-15, -8, -3, -1, 1, 4, 10, 15)


@cache
def recording(name="amiable"):
    return load_audio(ROOT / f"docs/samples/{name}.flac")


@cache
def curves_of(model, emotion="neutral", name="amiable"):
    """Curves of a sample; those of another model and emotion, with noise, stand for captures."""
    return animate(recording(name), emotion, model=load_model(model)).curves


def bump(at: float, seconds: float = 10.0, centre: float = 5.0, height: float = 1.0) -> ClipLags:
    return ClipLags(height * np.exp(-(((LAGS - at) / 0.05) ** 2)), 1, centre, seconds)


def test_peak_is_found_between_frames_and_near_a_lag():
    assert sharpest_peak(bump(0.1234).scores) == pytest.approx(0.1234, abs=5e-4)
    two = bump(-0.3).scores + 0.5 * bump(0.2).scores
    assert sharpest_peak(two) == pytest.approx(-0.3, abs=5e-4)
    assert sharpest_peak(two, near=0.19) == pytest.approx(0.2, abs=5e-4)


def test_clips_of_a_take_agree_on_one_lag():
    clips = [bump(0.05, centre=c) for c in (5, 20, 40, 90)]
    clips[2] = replace(clips[2], scores=bump(-0.4).scores + 0.9 * bump(0.05).scores)
    take = take_sync(clips)
    assert take is not None and take.lag == pytest.approx(0.05, abs=1e-3)
    assert take.drift == 0 and take.is_shifted


@pytest.mark.parametrize("drift", [NTSC_DRIFT, -NTSC_DRIFT])
def test_drift_of_ntsc_rates_is_found_exactly(drift):
    clips = [bump(0.1 + drift * c, centre=c) for c in np.arange(8, 300, 15)]
    take = take_sync(clips)
    assert take is not None and take.drift == pytest.approx(drift, rel=1e-9)
    for clip in clips:
        assert take.lag_at(clip.centre) == pytest.approx(0.1 + drift * clip.centre, abs=2e-3)


def test_planted_offsets_are_found_to_a_third_of_a_frame():
    rng = np.random.default_rng(0)
    found = []
    for name in ("amiable", "promise"):
        sound = recording(name).waveform
        predicted, face = curves_of("default", name=name), curves_of("live", "happy", name)
        noisy = face.values + 0.03 * rng.standard_normal(face.values.shape)
        captured = RigCurves(noisy.astype(np.float32), face.names, fps=face.fps)
        still = clip_lags(captured, sound, predicted=predicted)
        assert still is not None
        take = take_sync([still])
        assert take is not None and not take.is_shifted, take
        for frames in SHIFTS:
            moved = clip_lags(captured, sound, predicted=predicted, offset=frames * FRAME)
            assert moved is not None
            found.append(abs(sharpest_peak(moved.scores) - frames * FRAME) < FRAME / 3)
    assert np.mean(found) >= 0.95, found


def test_loudness_replaces_the_model():
    lags = clip_lags(curves_of("default"), recording().waveform, predicted=None, offset=0.2)
    assert lags is not None and lags.n_groups == 1
    assert sharpest_peak(lags.scores) == pytest.approx(0.2, abs=0.06)


def test_offset_of_another_rig_is_found_by_its_components(rng):
    """Mixtures of another model's curves under other names stand for another rig."""
    predicted, face, sound = curves_of("default"), curves_of("live"), recording().waveform
    mixed = face.values @ rng.normal(size=(len(face.names), 12)).astype(np.float32)
    names = tuple(f"puppet_{i}" for i in range(12))
    puppet = RigCurves(mixed, names, fps=face.fps, control_set="puppet@1")
    still = clip_lags(puppet, sound, predicted=predicted)
    assert still is not None and abs(sharpest_peak(still.scores)) < FRAME
    for frames in SHIFTS:
        moved = clip_lags(puppet, sound, predicted=predicted, offset=frames * FRAME)
        assert moved is not None
        found = sharpest_peak(moved.scores) - sharpest_peak(still.scores)
        assert found == pytest.approx(frames * FRAME, abs=FRAME / 3)


@pytest.mark.parametrize(
    ("own", "read"),
    [(30, 30), (24, 30), (25, 30), (30, 25), (48, 60), (60, 30), (30, 60), (24, 25)],
)
def test_takes_at_another_rate_than_their_sound_are_found(own, read):
    rng = np.random.default_rng(0)
    curves = curves_of("live", "happy").resample(own)
    noise = 0.02 * rng.standard_normal(curves.values.shape).astype(np.float32)
    misread = replace(curves, values=curves.values + noise, fps=read)
    found = fit_rate(misread, recording().waveform, predicted=curves_of("default"))
    assert found is None if own == read else found == pytest.approx(own)


def _signals(rng, seconds: float) -> np.ndarray:
    """Groups that move like speech, and one that stands still [shape=(9, T)]."""
    noise = rng.standard_normal((9, round(seconds * FAR_RATE)))
    rows = gaussian_filter1d(noise, 2, axis=1)
    rows[4] = 0.0
    return rows.astype(np.float32)


@pytest.mark.parametrize("lag", [-30.0, -5.0, -1.5, 2.0, 5.0, 30.0, None])
def test_a_take_that_is_seconds_apart_from_its_sound_is_found(rng, lag):
    """Clips with pauses between them, on noise; None is the sound of something else."""
    whole = _signals(rng, 170.0)
    wanted = whole[:, 40 * FAR_RATE : 130 * FAR_RATE]
    other = _signals(rng, 90.0)
    first = (40 * FAR_RATE) if lag is None else round((40 - lag) * FAR_RATE)
    captured = other if lag is None else whole[:, first : first + wanted.shape[1]]
    captured = captured + _signals(rng, 90.0)
    parts = [(0, 14), (16, 30), (30, 45), (50, 64), (64, 78), (79, 90)]
    slices = [slice(a * FAR_RATE, b * FAR_RATE) for a, b in parts]
    clips = [
        ClipSignals(a, captured[:, part], wanted[:, part])
        for (a, _), part in zip(parts, slices, strict=True)
    ]
    found = far_lag(clips)
    assert found is None if lag is None else found == pytest.approx(lag, abs=0.05)


def test_nothing_is_said_of_a_take_of_seconds(rng):
    short = _signals(rng, 8.0)
    assert far_lag([ClipSignals(0.0, short, short)]) is None
    assert far_lag([]) is None
