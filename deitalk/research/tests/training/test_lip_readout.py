"""Fitting of the readout of the lips: from regressions to the weights of the module."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from deitalk.models.lip_readout import CHANNELS, HIDDEN, MEASURES, TAPS, LipReadout
from deitalk.research.evaluation.ridge import REACH, Readout
from deitalk.research.lips.head_lips import MEASURES as HEAD_MEASURES
from deitalk.research.lips.head_lips import HeadLips
from deitalk.research.training import lip_readout
from deitalk.research.training.lip_readout import (
    GAINS,
    SHARES,
    SMOOTHING,
    VOICE_FRAMES,
    Teacher,
    channel_rows,
    fill_channels,
    fill_measures,
    learn_channels,
    moving_controls,
    shown_measures,
)
from rig import default_controls
from rig.face.head import build_head

CONTROLS = default_controls()
WIDTH = HEAD_MEASURES.index("width")
M = len(MEASURES)
MEAN = np.array([0.5, -0.2, 0.3, 0.1])


@pytest.fixture
def rng():
    return np.random.default_rng(4)


def readout_of(rng, size=5, targets=2):
    weights = rng.normal(size=((2 * REACH + 1) * size, targets)) * 0.1
    spread = rng.uniform(0.5, 2, size)
    return Readout(rng.normal(size=size), spread, weights, rng.normal(size=targets))


def smoothed(rows):
    padded = np.pad(rows, ((1, 1), (0, 0)), mode="edge")
    return sum(w * padded[i : i + len(rows)] for i, w in enumerate(SMOOTHING))


def filled(module, rng, shown, moves):
    """The module of a random regression, which is returned too."""
    measures = readout_of(rng, targets=M)
    module.silence.copy_(torch.from_numpy(rng.normal(size=module.silence.shape)))
    fill_measures(module, measures, shown, moves, MEAN)
    return measures


@pytest.mark.parametrize("causal", [False, True])
@torch.no_grad()
def test_the_module_reads_what_the_regression_reads(rng, causal):
    """A causal one reads it late: its last tap is the frame itself."""
    shown = rng.normal(size=(M, len(CONTROLS.names))), rng.normal(size=M)
    module = LipReadout(5, CONTROLS.names, causal=causal)
    measures = filled(module, rng, shown, shown[0].T)
    features = rng.normal(size=(40, 5)).astype(np.float32)
    found = module(torch.from_numpy(features)[None])[0].numpy()
    inner = slice(TAPS, -TAPS)
    later = np.roll(features, TAPS // 2, axis=0) if causal else features
    gain, share = np.array(GAINS), np.array(SHARES)
    wanted = gain * share * smoothed(measures(later)) + (1 - gain) * MEAN
    np.testing.assert_allclose(found[inner, len(CHANNELS) :], wanted[inner], atol=1e-4)


@pytest.mark.parametrize("causal", [False, True])
def test_channels_are_learnt_and_silence_is_around_every_recording(rng, monkeypatch, causal):
    """Each channel is on where its own feature is; frames of the edges are as sure as others."""
    for name, value in {"EPOCHS": 1600, "RATE": 5e-3, "DROPOUT": 0.0, "DECAY": 0.0}.items():
        monkeypatch.setattr(lip_readout, name, value)
    silence = rng.normal(size=len(CHANNELS)).astype(np.float32)
    recordings = []
    for length in (190, 40, 3):
        on = (rng.random((length, len(CHANNELS))) < 0.3).astype(np.float32)
        recordings.append((silence + 4 * on, on))
    module = LipReadout(len(CHANNELS), CONTROLS.names, causal=causal).eval()
    network = learn_channels(recordings, silence, is_causal=causal)
    fill_channels(module, network, silence)
    assert network.kernel.shape == (HIDDEN, len(CHANNELS), TAPS)
    for features, on in recordings:
        with torch.no_grad():
            read = module(torch.from_numpy(features)[None])[0, :, : len(CHANNELS)].numpy()
        assert ((read > 0.5) == on).mean() > 0.95


@torch.no_grad()
def test_corrected_curves_show_the_mixed_measures(rng):
    """On a face whose measures are linear in its controls, where no phone is heard."""
    names, size = CONTROLS.names, len(CONTROLS.names)
    shown = rng.normal(size=(M, size)), rng.normal(size=M)
    module = LipReadout(5, names)
    measures = filled(module, rng, shown, np.linalg.pinv(shown[0]))
    for table in (module.places, module.values, module.speaks):
        table.zero_()
    module.own.fill_(1)
    module.fade.copy_(torch.tensor([[-2.0], [-1.0]]).expand(2, M))
    module.most.fill_(torch.inf)
    features = rng.normal(size=(30, 5)).astype(np.float32)
    curves = torch.from_numpy(rng.uniform(0, 0.3, (1, 30, size)).astype(np.float32))
    found = module.correct(curves, module(torch.from_numpy(features)[None])[0])[0].numpy()
    own, after = (values @ shown[0].T + shown[1] for values in (curves[0].numpy(), found))
    mixed = SHARES * smoothed(measures(features)) + (1 - np.array(SHARES)) * own
    inner = slice(TAPS, -TAPS)
    np.testing.assert_allclose(
        after[inner], (MEAN + np.array(GAINS) * (mixed - MEAN))[inner], atol=1e-3
    )


def test_channel_rows_are_those_of_the_articulation_table():
    phones = [(0.0, 0.1, "M"), (0.1, 0.2, "F"), (0.2, 0.3, "TH"), (0.3, 0.4, "W"), (0.4, 0.5, "?")]
    rows = dict(zip(CHANNELS, channel_rows(phones, 15).T, strict=True))
    rows.pop("voice")
    places = {"together": "M", "bite": "F", "out": "TH", "purse": "W"}
    for name, phone in places.items():
        first = 3 * [p for _, _, p in phones].index(phone)
        assert rows[name].argmax() == first and rows[name][first : first + 3].min() == 1
    assert rows["tip"][6:9].max() < 0.2 and all(row[12:].max() == 0 for row in rows.values())


def test_the_voice_is_speech_and_a_few_frames_around_it():
    phones = [(0.0, 1.0, "SIL"), (1.0, 1.5, "M"), (1.5, 2.5, "SIL"), (2.5, 3.0, "?")]
    voice = channel_rows(phones, 90)[:, CHANNELS.index("voice")]
    assert np.flatnonzero(voice).tolist() == list(range(30 - VOICE_FRAMES, 45 + VOICE_FRAMES))


def test_the_map_from_curves_to_measures_is_found(rng):
    law, curves = rng.normal(size=(2, 6)), rng.normal(size=(500, 6))
    weights, constant = shown_measures(curves, curves @ law.T + 3)
    np.testing.assert_allclose(weights, law, atol=1e-3)
    np.testing.assert_allclose(constant, [3, 3], atol=1e-2)


@torch.no_grad()
def test_controls_that_widen_the_mouth_change_little_else():
    lips = HeadLips(build_head())
    teacher = Teacher.__new__(Teacher)
    teacher.lips, teacher.chosen = lips, [HEAD_MEASURES.index(name) for name in MEASURES]
    teacher.model = SimpleNamespace(controls=CONTROLS)
    pose = CONTROLS.rest.astype(np.float32) + np.float32(0.1)
    moves = moving_controls(teacher, pose)[:, MEASURES.index("width")]
    moved = torch.from_numpy((pose + 0.1 * moves).astype(np.float32))
    change = (lips(moved) - lips(torch.from_numpy(pose))).numpy()
    assert change[WIDTH] == pytest.approx(0.1, rel=0.1)
    assert np.abs(np.delete(change, WIDTH)).max() < 0.01
    rounding = [k for k, name in enumerate(CONTROLS.names) if "funnel" in name or "purse" in name]
    assert not moves[rounding].any()
