"""Fitting of the readout of the lips: from regressions to the weights of the module."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from deitalk.models.lip_readout import TAPS, LipReadout
from deitalk.research.evaluation.ridge import REACH, Readout
from deitalk.research.lips.head_lips import MEASURES, HeadLips
from deitalk.research.training.lip_readout import (
    GAINS,
    SHARE,
    SMOOTHING,
    Teacher,
    calibration,
    contact_rows,
    fill,
    moving_controls,
    shown_measures,
)
from rig import default_controls
from rig.face.head import build_head

CONTROLS = default_controls()
WIDTH, CORNER = MEASURES.index("width"), MEASURES.index("corner")
MEAN = np.array([-0.2, 0.1])


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


@pytest.mark.parametrize("causal", [False, True])
@torch.no_grad()
def test_the_module_reads_what_the_regressions_read(rng, causal):
    """A causal one reads it late: its last tap is the frame itself."""
    contacts, measures = readout_of(rng), readout_of(rng)
    shown = rng.normal(size=(2, len(CONTROLS.names))), rng.normal(size=2)
    moves = rng.normal(size=(len(CONTROLS.names), 2))
    slopes = [np.array([2.0, -1.0]), np.array([0.5, 0.3])]
    module = LipReadout(5, CONTROLS.names, causal=causal)
    fill(module, contacts, slopes, measures, shown, moves, MEAN)
    features = rng.normal(size=(40, 5)).astype(np.float32)
    found = module(torch.from_numpy(features)[None])[0].numpy()
    inner = slice(TAPS, -TAPS)
    late = np.roll(features, REACH, axis=0) if causal else features
    logits = contacts(late) * [2.0, 0.5] + [-1.0, 0.3]
    np.testing.assert_allclose(found[inner, :2], (1 / (1 + np.exp(-logits)))[inner], atol=1e-4)
    later = np.roll(features, TAPS // 2, axis=0) if causal else features
    gain = np.array(GAINS)
    wanted = gain * SHARE * smoothed(measures(later)) + (1 - gain) * MEAN
    np.testing.assert_allclose(found[inner, 2:], wanted[inner], atol=1e-4)


@torch.no_grad()
def test_corrected_curves_show_the_mixed_measures(rng):
    """On a face whose measures are linear in its controls."""
    names, size = CONTROLS.names, len(CONTROLS.names)
    shown = rng.normal(size=(2, size)), rng.normal(size=2)
    moves = np.linalg.pinv(shown[0])
    module = LipReadout(5, names)
    measures = readout_of(rng)
    fill(module, readout_of(rng), [np.array([1.0, 0.0])] * 2, measures, shown, moves, MEAN)
    features = rng.normal(size=(30, 5)).astype(np.float32)
    curves = torch.from_numpy(rng.uniform(0, 0.3, (1, 30, size)).astype(np.float32))
    module.places.zero_()  # contacts stay
    found = module.correct(curves, module(torch.from_numpy(features)[None])[0])[0].numpy()
    own, after = (values @ shown[0].T + shown[1] for values in (curves[0].numpy(), found))
    mixed = SHARE * smoothed(measures(features)) + (1 - SHARE) * own
    inner = slice(TAPS, -TAPS)
    np.testing.assert_allclose(
        after[inner], (MEAN + np.array(GAINS) * (mixed - MEAN))[inner], atol=1e-3
    )


def test_calibrated_scores_are_probabilities(rng):
    scores = rng.normal(size=20_000)
    closed = (rng.random(20_000) < 1 / (1 + np.exp(-(3 * scores - 1)))).astype(float)
    np.testing.assert_allclose(calibration(scores, closed), [3, -1], atol=0.15)


def test_contact_rows_are_of_bilabials_and_of_labiodentals():
    rows = contact_rows([(0.0, 0.1, "M"), (0.1, 0.2, "F"), (0.2, 0.3, "AA")], 9)
    assert rows.T.tolist() == [[1, 1, 1, 0, 0, 0, 0, 0, 0], [0, 0, 0, 1, 1, 1, 0, 0, 0]]


def test_the_map_from_curves_to_measures_is_found(rng):
    law, curves = rng.normal(size=(2, 6)), rng.normal(size=(500, 6))
    weights, constant = shown_measures(curves, curves @ law.T + 3)
    np.testing.assert_allclose(weights, law, atol=1e-3)
    np.testing.assert_allclose(constant, [3, 3], atol=1e-2)


@torch.no_grad()
def test_controls_that_widen_the_mouth_change_little_else():
    lips = HeadLips(build_head())
    teacher = Teacher.__new__(Teacher)
    teacher.lips, teacher.chosen = lips, [WIDTH, CORNER]
    teacher.model = SimpleNamespace(controls=CONTROLS)
    pose = CONTROLS.rest.astype(np.float32) + np.float32(0.1)
    moves = moving_controls(teacher, pose)
    moved = torch.from_numpy((pose + 0.1 * moves[:, 0]).astype(np.float32))
    change = (lips(moved) - lips(torch.from_numpy(pose))).numpy()
    assert change[WIDTH] == pytest.approx(0.1, rel=0.1)
    assert np.abs(np.delete(change, WIDTH)).max() < 0.01
