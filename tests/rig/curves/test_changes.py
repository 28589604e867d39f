"""Changes of a take by hand, found as a layer."""

from dataclasses import replace

import numpy as np
import pytest

from rig import RigCurves
from rig.curves.apply_layers import apply_layers
from rig.curves.layer_diff import layer_of_changes
from rig.curves.layer_files import parse_layers
from rig.errors import CurveError
from tests.errors import one_line
from tests.rig.curves.test_layers import (
    BOARD,
    BROW,
    CLOSURES,
    TOGETHER,
    applied,
    closed_face,
    curves,
)


def edited(given, seed):
    """The curves with twenty edits and noise."""
    rng, values = np.random.default_rng(seed), given.values.copy()
    for k in range(20):
        column, length = rng.integers(len(BOARD)), int(rng.integers(1, 30))
        start = int(rng.integers(0, len(given) - length + 1))
        part = values[start : start + length, column]
        part += (0.3 * np.hanning(length + 2)[1:-1], 0.4 - part, -0.2)[k % 3]
    values += rng.uniform(-0.002, 0.002, values.shape)
    return replace(given, values=np.clip(values, BOARD.minimum, BOARD.maximum))


def moving(frames=300):
    rng = np.random.default_rng(5)
    wave = np.sin(np.arange(frames)[:, None] / 9 + rng.uniform(0, 6, len(BOARD)))
    values = BOARD.rest + (BOARD.maximum - BOARD.rest) * (0.3 + 0.3 * wave)
    values[:, list(TOGETHER)] = (np.sin(np.arange(frames) / 8) > 0.7)[:, None]
    return RigCurves(np.clip(values, BOARD.minimum, BOARD.maximum), BOARD.names, 30)


@pytest.mark.parametrize("seed", range(8))
def test_the_layer_of_changes_gives_the_edited_curves(seed):
    base = moving()
    wanted = edited(base, seed)
    layer = layer_of_changes(base, wanted, closures=CLOSURES)
    (read,) = parse_layers(layer.text)
    found, notes = apply_layers(base, [read], closures=CLOSURES)
    assert np.abs(found.values - wanted.values).max() < 0.01 and notes == ()
    assert layer.n_keys <= 0.01 * base.values.size and len(layer.text) <= 20_000
    assert len(layer.edits) <= 26  # noise is no edit; an edit may be clamped apart


def test_noise_is_no_change_and_one_frame_is_one():
    base = curves()
    values = base.values + np.float32(0.004)
    assert layer_of_changes(base, replace(base, values=values)).edits == ()
    values[17, BOARD.index(BROW)] += 0.5
    (edit,) = layer_of_changes(base, replace(base, values=values)).edits
    assert edit.span == (16 / 30, 18 / 30) and len(edit.keys) <= 3


def test_a_closure_that_was_opened_by_hand_stays_open():
    base = closed_face()
    values = base.values.copy()
    values[12:18, list(TOGETHER)] = 0
    wanted = replace(base, values=values)
    layer = layer_of_changes(base, wanted, closures=CLOSURES)
    assert all(edit.owns for edit in layer.edits)
    found, _ = apply_layers(base, [layer], closures=CLOSURES)
    assert np.abs(found.values - values).max() < 0.01


def test_edits_of_the_head_are_found():
    base = curves(head=np.zeros((31, 6), np.float32))
    head = base.head.copy()
    head[5:20, 0] = 4.0
    (edit,) = layer_of_changes(base, replace(base, head=head)).edits
    assert edit.target == "head.yaw"
    np.testing.assert_allclose(applied(base, edit).head, head, atol=0.1)


def test_other_rates_are_refused():
    with one_line(CurveError, "another rate"):
        layer_of_changes(curves(), curves(fps=60))
