"""Closed forms of the parts of the loss that trainings from the start add."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from deitalk.data.clips import read_clips
from deitalk.errors import ConfigError
from deitalk.research.config import TrainingDataConfig, TrainingLossConfig
from deitalk.research.lips.losses import LIP_SPREAD_CM, LIP_WEIGHTS, lip_loss, range_loss
from deitalk.research.training.curve_losses import contact_loss, control_weights
from deitalk.research.training.curves import TrainingLoss, TrainingWindows
from rig import default_controls
from rig.controls import Control, ControlSet
from tests.deitalk.data.test_windows import folder
from tests.deitalk.training.test_curve_losses import example, window

__all__ = ["folder"]

CONTROLS = default_controls()
TWO = ControlSet("two", (Control("jaw"), Control("lipsTogether")))


def test_contact_by_hand():
    shut, half = torch.ones(1, 1, 1), torch.full((1, 1, 1), 0.5)
    assert float(contact_loss(shut, half)) == pytest.approx(0.45**2 + 0.1 * math.log(2))
    assert float(contact_loss(half, half)) == pytest.approx(0.1 * math.log(2))
    # beyond 0.95 only the cross entropy of 8 (1 - 0.5) = 4 is left
    assert float(contact_loss(shut, shut)) == pytest.approx(0.1 * math.log1p(math.exp(-4)))


def test_contact_depends_on_its_controls_only():
    output, curves, emotion, intensity = example()

    def parts(weight: float, known: tuple[float, float] = (1.0, 1.0)):
        loss = TrainingLoss(TrainingLossConfig(contact=weight), TWO, torch.device("cpu"))
        return loss(lambda *given: output, window(curves, emotion, intensity, known))

    found, without = parts(2.0), parts(0.0)
    expected = contact_loss(curves[..., 1:], output.curves[..., 1:])
    assert float(found["contact"]) == pytest.approx(float(expected))
    assert "contact" not in without
    assert float(found["total"] - without["total"]) == pytest.approx(2 * float(expected), rel=1e-4)
    assert float(parts(2.0, known=(1.0, 0.0))["contact"]) == 0


def test_control_weights_are_set_by_control_part_or_subset():
    out = control_weights({"lip": 2.0, "lipsTogether": 3.0, "CTRL_C_jaw.ty": 4.0}, CONTROLS)
    assert out[CONTROLS.index("CTRL_C_jaw.ty")] == 4
    assert out[CONTROLS.index("CTRL_L_mouth_lipsTogetherU.ty")] == 3, "later entries win"
    assert out[CONTROLS.index("CTRL_L_mouth_cornerPull.ty")] == 2
    assert out[CONTROLS.index("CTRL_L_brow_down.ty")] == 1
    with pytest.raises(ConfigError, match="'moustache' is no control"):
        control_weights({"moustache": 1.0}, CONTROLS)


def test_measured_clips_have_the_configured_share_and_equal_speakers(folder):
    clips = read_clips(folder, "train")
    some = [replace(c, source="measured", speaker="few") for c in clips[:1]]
    many = [replace(c, source="measured", speaker="many", name=f"{c.name}+") for c in clips * 5]
    share = TrainingDataConfig(window_frames=32, measured_fraction=0.6)
    drawn = TrainingWindows([*some, *many, *clips], CONTROLS, share, 3, 4)
    found = [drawn._draw(np.random.default_rng(i)) for i in range(600)]
    measured = [clip.speaker for clip in found if clip.source == "measured"]
    assert len(measured) / 600 == pytest.approx(0.6, abs=0.06)
    assert np.mean([who == "few" for who in measured]) == pytest.approx(0.5, abs=0.08)
    only = TrainingWindows(many, CONTROLS, share, 3, 4)
    assert only._draw(np.random.default_rng(0)).speaker == "many"


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
