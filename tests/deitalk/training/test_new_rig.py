"""First weights for a new rig: laws that a regression must find, and ranges worked by hand."""

import numpy as np
import pytest
import torch

from deitalk.models.rig_decoder import RigDecoder
from deitalk.training.tuning.task import RANGE_ROWS, CapturedRows, actor_range, fit_decoder


def test_last_layer_is_a_regression_and_each_actor_has_a_range(rng, monkeypatch):
    """Two actors of whom one moves three times as far: all get the mean, each of them the own."""
    monkeypatch.setattr("deitalk.training.tuning.task.RIDGE", 1e-3)
    monkeypatch.setattr("deitalk.training.tuning.task.RANGE_ROWS", 0.0)
    hidden = rng.normal(size=(600, 4)).astype(np.float32)
    curves = (hidden @ rng.normal(size=(4, 2)) + 0.3).astype(np.float32)
    rows = [CapturedRows("ann", hidden, curves), CapturedRows("bob", hidden, 3 * curves)]
    net = RigDecoder(
        in_size=3,
        style_size=2,
        guidance_size=0,
        channels=4,
        dilations=(1,),
        kernel_size=3,
        n_emotions=5,
        rest=torch.zeros(2),
        n_actors=2,
        ranges=True,
    )
    fit_decoder(net, rows, ("ann", "bob"))
    mean = net.output(torch.from_numpy(hidden))
    np.testing.assert_allclose(mean.detach(), 2 * curves, atol=1e-3)
    for place, row in enumerate(rows):
        style = torch.eye(7)[0] + torch.eye(7)[5 + place]
        given = net.ranges(mean[None], style[None])[0].detach()
        np.testing.assert_allclose(given, row.curves, atol=1e-3)


def test_range_of_an_actor_worked_by_hand():
    """Squares about the mean are 2; held by 0.02 x 3 frames x variance 2/3 = 0.04 at a gain of 1."""
    assert RANGE_ROWS == 0.02
    given = np.array([[0.0], [1.0], [2.0]])
    gain, offset = actor_range(given, 2 * given + 1)
    assert gain == pytest.approx([4.04 / 2.04])
    assert offset == pytest.approx([3 - 4.04 / 2.04])


def test_control_that_an_actor_never_moves_hardly_moves():
    given = np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]])
    gain, offset = actor_range(given, np.column_stack([given[:, 0], np.zeros(3)]))
    assert gain[0] == pytest.approx(1) and abs(gain[1]) < 0.05
    assert offset[1] == pytest.approx(-gain[1])
