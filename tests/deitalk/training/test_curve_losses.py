"""Closed forms of the four-part loss (Eq. 8-13) and of the parts we add."""

import math

import pytest
import torch

from deitalk.config.curves import LossConfig
from deitalk.models.curve_model import Output
from deitalk.models.intensity import Intensity
from deitalk.research.lips.losses import LIP_SPREAD_CM, LIP_WEIGHTS, lip_loss, range_loss
from deitalk.training.curve_losses import (
    classification_loss,
    contact_loss,
    contrast_loss,
    intensity_loss,
    position_loss,
    total_loss,
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


def test_contact_by_hand():
    shut, half = torch.ones(1, 1, 1), torch.full((1, 1, 1), 0.5)
    assert float(contact_loss(shut, half)) == pytest.approx(0.45**2 + 0.1 * math.log(2))
    assert float(contact_loss(half, half)) == pytest.approx(0.1 * math.log(2))
    # beyond 0.95 only the cross entropy of 8 (1 - 0.5) = 4 is left
    assert float(contact_loss(shut, shut)) == pytest.approx(0.1 * math.log1p(math.exp(-4)))


def example(labels=(0.2, math.nan)):
    torch.manual_seed(3)
    strength = torch.tensor([[0.6, 0.5]])
    intensity = Intensity(
        torch.randn(1, 2, 3), torch.randn(1, 3), torch.rand(1, 2), torch.randn(1, 2, 3), strength
    )
    output = Output(PREDICTED, intensity, torch.randn(1, 5), torch.randn(1, 3))
    return output, TARGET, torch.eye(5)[[1]], torch.tensor([labels])


def total(config, output, curves, emotion, intensity, known=(1.0, 1.0)):
    return total_loss(
        output,
        curves,
        emotion,
        intensity,
        config=config,
        known=torch.tensor([known]),
        weights=torch.ones(2),
        contact_controls=torch.tensor([1]),
    )


def test_unknown_controls_have_no_part_in_the_loss():
    """Of TARGET less PREDICTED, (0, 2) and (3, 0), only the first column is known."""
    output, curves, emotion, intensity = example()
    config = LossConfig(contact=2.0)
    parts = total(config, output, curves, emotion, intensity, known=(1.0, 0.0))
    assert float(parts["position"]) == 9 / 2
    assert float(parts["velocity"]) == 9  # steps 2 and -1
    assert float(parts["contact"]) == 0
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


def test_contact_depends_on_its_controls_only():
    config = LossConfig(contact=2.0)
    output, curves, emotion, intensity = example()
    parts = total(config, output, curves, emotion, intensity)
    expected = contact_loss(curves[..., 1:], output.curves[..., 1:])
    assert float(parts["contact"]) == pytest.approx(float(expected))
    without = total(LossConfig(), output, curves, emotion, intensity)
    assert "contact" not in without
    assert float(parts["total"] - without["total"]) == pytest.approx(2 * float(expected), rel=1e-4)


def test_lip_loss_by_hand():
    """Opening alternates by one spread; a prediction twice as wide errs by half a spread."""
    target = torch.zeros(1, 4, 6)
    target[0, :, 0] = torch.tensor([0.0, 1.0, 0.0, 1.0]) * LIP_SPREAD_CM[0]
    assert float(lip_loss(target, target)) == pytest.approx(sum(LIP_WEIGHTS[1:]), abs=0.01)
    # squares 0 1 0 1 over 4, velocities 1 1 1 over 3 twice, correlation 1
    expected = LIP_WEIGHTS[0] * (0.5 + 2 * 1.0) + sum(LIP_WEIGHTS[1:])
    assert float(lip_loss(target, 2 * target)) == pytest.approx(expected, abs=0.01)
    # measures that do not move correlate with nothing: each lacks 1 by its weight


def test_range_loss_by_hand():
    """All measures move twice as far: ranges and speeds both lack log 2."""
    torch.manual_seed(4)
    target = 100 * torch.randn(2, 50, 6)
    assert float(range_loss(target, target)) == 0
    assert float(range_loss(target, target + 3)) == pytest.approx(0, abs=1e-6)
    for twice in (2 * target, target / 2):
        expected = 2 * math.log(2) ** 2
        assert float(range_loss(target, twice)) == pytest.approx(expected, rel=1e-3)
