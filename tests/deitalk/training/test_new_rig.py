"""First weights for a new rig: laws that a regression must find, and ranges worked by hand."""

import numpy as np
import pytest
import torch

from deitalk.data.lips.regression import in_context
from deitalk.models.rig_decoder import CONTEXT_FRAMES, RigDecoder
from deitalk.training.tuning.new_rig import RANGE_ROWS, CapturedRows, actor_range, fit_decoder


def decoder(**options):
    return RigDecoder(
        in_size=3,
        style_size=2,
        guidance_size=0,
        channels=4,
        dilations=(1,),
        kernel_size=3,
        n_emotions=5,
        rest=torch.zeros(2),
        n_actors=2,
        **options,
    ).eval()


def captured(rng, law, scale, actor):
    """A clip whose curves are a linear law of its features, as far as the actor moves."""
    speech = rng.normal(size=(600, 3)).astype(np.float32)
    curves = scale * (in_context(speech) @ law + 0.3)
    return CapturedRows(actor, speech, rng.normal(size=(600, 4)), curves.astype(np.float32))


def test_direct_path_finds_a_linear_law_and_how_far_each_actor_moves(rng, monkeypatch):
    monkeypatch.setattr("deitalk.training.tuning.new_rig.DIRECT_RIDGE", 1e-3)
    monkeypatch.setattr("deitalk.training.tuning.new_rig.RANGE_ROWS", 0.0)
    ann = captured(rng, rng.normal(size=(3 * len(CONTEXT_FRAMES), 2)), 1.0, "ann")
    rows = [ann, ann._replace(actor="bob", curves=3 * ann.curves)]
    net = decoder(direct=True)
    fit_decoder(net, rows, ("ann", "bob"))
    assert not net.output.weight.any() and not net.output.bias.any()
    for place, row in enumerate(rows):
        style = torch.eye(7)[0] + torch.eye(7)[5 + place]
        given = net(torch.from_numpy(row.speech)[None], style[None], None)[0].detach().numpy()
        np.testing.assert_allclose(given, row.curves, atol=1e-3)
    stranger = net(torch.from_numpy(rows[0].speech)[None], torch.eye(5)[:1], None)[0]
    mean = (rows[0].curves + 3 * rows[0].curves) / 2
    np.testing.assert_allclose(stranger.detach().numpy(), mean, atol=1e-3)


def test_last_layer_without_a_direct_path_is_a_regression_on_its_input(rng, monkeypatch):
    monkeypatch.setattr("deitalk.training.tuning.new_rig.LAST_LAYER_RIDGE", 1e-3)
    row = captured(rng, rng.normal(size=(21, 2)), 1.0, "ann")
    row = row._replace(hidden=row.hidden.astype(np.float32))
    curves = row.hidden @ rng.normal(size=(4, 2)) + 0.2
    net = decoder()
    fit_decoder(net, [row._replace(curves=curves.astype(np.float32))], ("ann", "bob"))
    given = net.output(torch.from_numpy(row.hidden)).detach().numpy()
    np.testing.assert_allclose(given, curves, atol=1e-3)


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
