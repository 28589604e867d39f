"""Windows and loss of a training with a teacher and lips."""

import numpy as np
import pytest
import torch

from deitalk.data import windows
from deitalk.data.clips import read_clips
from deitalk.data.windows import cut, load_clip
from deitalk.models.curve_model import Output
from deitalk.research.config import TrainingDataConfig, TrainingLossConfig
from deitalk.research.training.curves import TaughtWindow, TrainingLoss, TrainingWindows
from rig import default_controls
from tests.deitalk.data.test_windows import CONTROLS, folder

__all__ = ["folder"]


def config(**changes: object) -> TrainingDataConfig:
    return TrainingDataConfig(window_frames=32, **changes)  # type: ignore[arg-type]


def test_windows_for_a_teacher_hold_the_sound_before_augmentation(folder, monkeypatch):
    monkeypatch.setattr(windows, "speed_factor", lambda rng: 1.25)
    drawn = TrainingWindows(
        read_clips(folder, "train"), CONTROLS, config(augment=True), 3, 4, clean=True
    )
    for number in range(4):
        window = drawn.item(number)
        first, name = int(window.frames[0]), drawn._draw(np.random.default_rng((3, number))).name
        clip = next(clip for clip in drawn.clips if clip.name == name)
        sound = cut(load_clip(clip, CONTROLS), first, 32, 1.25)[0]
        np.testing.assert_array_equal(window.clean.numpy(), sound)
        assert not torch.equal(window.waveform, window.clean)
    plain = TrainingWindows(read_clips(folder, "train"), CONTROLS, config(), 3, 4)
    assert len(plain.item(0).clean) == 0, "without a teacher"


def test_lip_loss_is_part_of_the_total_if_it_has_a_weight():
    config = TrainingLossConfig(lips=0.5, range=2, contrast=0, position=0, velocity=0)
    controls = default_controls()
    loss = TrainingLoss(config, controls, torch.device("cpu"))
    rest = torch.tensor(controls.rest).float()
    curves = rest.repeat(2, 16, 1)
    curves[..., controls.index("CTRL_C_jaw.ty")] = torch.linspace(0, 0.5, 16)
    still = rest.repeat(2, 16, 1)
    batch = TaughtWindow(
        torch.zeros(0), curves, torch.zeros(2, 5), torch.zeros(2, 5), torch.zeros(2, 16),
        torch.zeros(0), torch.zeros(0), torch.ones(2, 185), torch.zeros(0),
    )  # fmt: skip
    parts = loss(lambda *given: Output(still, None, None, None), batch)
    assert float(parts["lips"]) > 3
    expected = 0.5 * float(parts["lips"]) + 2 * float(parts["range"])
    assert float(parts["range"]) > 1
    assert float(parts["total"]) == pytest.approx(expected)
    assert TrainingLoss(TrainingLossConfig(), controls, torch.device("cpu")).lips is None
