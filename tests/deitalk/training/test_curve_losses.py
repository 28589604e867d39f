"""Closed forms of the four-part loss (Eq. 8-13) and of the parts we add."""

import math

import pytest
import torch

from deitalk.config.curves import LossConfig
from deitalk.data.windows import Window
from deitalk.models.curve_model import Output
from deitalk.models.intensity import Intensity
from deitalk.training.curve_losses import (
    CurveLoss,
    classification_loss,
    contrast_loss,
    intensity_loss,
    position_loss,
    velocity_loss,
)


def test_contrast_of_a_batch_of_two_by_hand():
    # cosines [[1, 0.6], [0, 0.8]]; over tau = 1/2: [[2, 1.2], [0, 1.6]]. Rows lose log(1 + e^-0.8)
    # and log(1 + e^-1.6), columns log(1 + e^-2) and log(1 + e^-0.4); Eq. 10 halves and averages.
    speech = torch.tensor([[2.0, 0.0], [0.0, 1.0]])
    motion = torch.tensor([[5.0, 0.0], [0.6, 0.8]])
    expected = sum(math.log1p(math.exp(-x)) for x in (0.8, 1.6, 2.0, 0.4)) / 4
    assert float(contrast_loss(speech, motion, 0.5)) == pytest.approx(expected, abs=1e-6)


def test_classification_by_hand():
    # softmax of (0, 0, 0, 0, log 4) is 1/8 four times and 1/2
    logits = torch.tensor([[0, 0, 0, 0, math.log(4)]] * 2)
    labels = torch.eye(5)[[4, 0]]
    expected = (math.log(2) + math.log(8)) / 2
    assert float(classification_loss(logits, labels)) == pytest.approx(expected, abs=1e-6)


TARGET = torch.tensor([[[1.0, 2.0], [3.0, 4.0]]])
PREDICTED = torch.tensor([[[1.0, 0.0], [0.0, 4.0]]])


def test_position_by_hand():
    assert float(position_loss(TARGET, PREDICTED)) == (4 + 9) / 2
    weights = torch.tensor([10.0, 0.5])
    assert float(position_loss(TARGET, PREDICTED, weights)) == (0.5 * 4 + 10 * 9) / 2


def test_velocity_by_hand():
    # steps (2, 2) against (-1, 4); one difference for two frames
    assert float(velocity_loss(TARGET, PREDICTED)) == 9 + 4
    assert float(velocity_loss(TARGET, PREDICTED, torch.tensor([1.0, 0.5]))) == 9 + 2
    assert float(velocity_loss(TARGET, TARGET + 0.3)) == pytest.approx(0, abs=1e-12)


def test_intensity_counts_labelled_frames_only():
    target = torch.tensor([[0.5, math.nan, 1.0]])
    strength = torch.tensor([[0.1, 0.9, 0.7]], requires_grad=True)
    loss = intensity_loss(target, strength)
    loss.backward()
    assert loss.item() == pytest.approx((0.4**2 + 0.3**2) / 2)
    assert strength.grad[0, 1] == 0
    assert torch.isfinite(strength.grad).all()


def example(labels=(0.2, math.nan)):
    torch.manual_seed(3)
    strength = torch.tensor([[0.6, 0.5]])
    intensity = Intensity(
        torch.randn(1, 2, 3), torch.randn(1, 3), torch.rand(1, 2), torch.randn(1, 2, 3), strength
    )
    output = Output(PREDICTED, intensity, torch.randn(1, 5), torch.randn(1, 3))
    return output, TARGET, torch.eye(5)[[1]], torch.tensor([labels])


def window(curves, emotion, intensity, known=(1.0, 1.0)):
    unused = torch.zeros(0)
    return Window(
        unused, curves, emotion, emotion, intensity, unused, unused, torch.tensor([known])
    )


def total(config, output, curves, emotion, intensity, known=(1.0, 1.0)):
    batch = window(curves, emotion, intensity, known)
    return CurveLoss(config).parts(output, batch, batch.known)


def test_unknown_controls_have_no_part_in_the_loss():
    """Of TARGET less PREDICTED, (0, 2) and (3, 0), only the first column is known."""
    output, curves, emotion, intensity = example()
    config = LossConfig()
    parts = total(config, output, curves, emotion, intensity, known=(1.0, 0.0))
    assert float(parts["position"]) == 9 / 2
    assert float(parts["velocity"]) == 9  # steps 2 and -1
    nothing = total(config, output, curves, emotion, intensity, known=(0.0, 0.0))
    assert float(nothing["position"]) == float(nothing["velocity"]) == 0


def test_default_weights_are_those_of_equation_eight():
    output, curves, emotion, intensity = example()
    parts = total(LossConfig(), output, curves, emotion, intensity)
    con = contrast_loss(output.intensity.embedding, output.motion_embedding, 0.07)
    cla = classification_loss(output.emotion_logits, emotion)
    expected = 0.1 * con + 0.1 * cla + 1.0 * 6.5 + 4.0 * 13
    assert float(parts["total"]) == pytest.approx(float(expected), rel=1e-6)


@pytest.mark.parametrize(
    ("name", "value"), [("position", 6.5), ("velocity", 13.0), ("intensity", 0.16)]
)
def test_every_weight_multiplies_its_part(name, value):
    nothing = dict.fromkeys(("contrast", "classification", "position", "velocity"), 0.0)
    parts = total(LossConfig(**(nothing | {name: 3.0})), *example())
    assert float(parts["total"]) == pytest.approx(3 * value)
