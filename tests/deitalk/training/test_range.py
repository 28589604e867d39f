"""The spread of a tuned model's controls, raised about the mean of every style."""

import numpy as np
import pytest
import torch

from deitalk.training.tuning.regression import Raised
from tests.deitalk.training.conftest import small_decoder


@pytest.mark.parametrize("layers", [True, "offsets"])
def test_every_style_moves_further_about_its_own_mean(rng, layers):
    """Nobody's curves, then those of two actors: factor times the way from the mean."""
    net = small_decoder(actor_layers=layers)
    for parameter in net.parameters():
        torch.nn.init.normal_(parameter)
    hidden = torch.from_numpy(rng.normal(size=(1, 6, 4)).astype(np.float32))
    styles = torch.eye(7)[[0, 0, 0]]
    styles[1, 5] = styles[2, 6] = 1
    before = [net.curves(hidden, style[None]).detach().numpy()[0] for style in styles]
    factor = np.array([[1.0, 2.0], [3.0, 1.5], [1.0, 1.2]])
    factor[1:] = factor[:1] if layers == "offsets" else factor[1:]
    means = np.array([[0.1, 0.2], [0.5, -0.3], [-0.4, 0.0]])
    with torch.no_grad():
        Raised(factor, means).scale(net)
    for style, curves, of, mean in zip(styles, before, factor, means, strict=True):
        found = net.curves(hidden, style[None]).detach().numpy()[0]
        np.testing.assert_allclose(found, mean + of * (curves - mean), atol=1e-4)
