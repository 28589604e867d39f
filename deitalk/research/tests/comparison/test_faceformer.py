"""FaceFormer's decoder: its own frames come back as its input, and nothing comes from later."""

import pytest
import torch
from torch.nn import functional as F

from deitalk.config.frontends import MelConfig
from deitalk.errors import CheckpointError, ConfigError
from deitalk.models.checkpoint import save_model
from deitalk.research.comparison import FaceFormer
from deitalk.research.comparison.biased_attention import periodic_positions
from deitalk.research.comparison.faceformer import FaceFormerDecoder
from deitalk.research.config import ComparedConfig, ComparedModelConfig
from deitalk.training.tuning.task import FinetuneTask
from tests.dataset import write_dataset
from tests.deitalk.models.test_curve_model import MEL
from tests.deitalk.training.conftest import recipe
from tests.errors import one_line

OWN = {
    "decoder": "faceformer",
    "decoder_channels": 8,
    "decoder_heads": 2,
    "decoder_period": 5,
    "positions": False,
    "intensity": False,
}


def decoder(**settings):
    torch.manual_seed(2)
    net = FaceFormerDecoder(
        ComparedModelConfig(**(OWN | settings)), 6, torch.tensor([0.0, 1.0, 0.5])
    )
    torch.nn.init.normal_(net.output.weight)
    return net.eval()


def emotion(i):
    return F.one_hot(torch.tensor([i]), 5).float()


@torch.no_grad()
def test_frame_is_made_from_the_curves_of_the_frame_before():
    net, speech = decoder(), torch.randn(1, 9, 6)
    style, positions = net.style.weight[:, 3], periodic_positions(9, 8, 5)
    inputs, curves = [], []
    for t in range(9):
        back = net.motion(curves[-1] - net.rest) if curves else 0
        inputs.append(back + style + positions[t])
        rows = net.layer(torch.stack(inputs).unsqueeze(0), net.speech(speech[:, : t + 1]))
        curves.append(net.output(rows[0, -1]))
    torch.testing.assert_close(net(speech, emotion(3), None)[0], torch.stack(curves))


@torch.no_grad()
def test_later_speech_changes_no_earlier_frame():
    net, speech = decoder(), torch.randn(1, 12, 6)
    other = speech.clone()
    other[:, 7:] = 0
    before, after = net(speech, emotion(1), None), net(other, emotion(1), None)
    torch.testing.assert_close(before[:, :7], after[:, :7])
    assert (before[:, 7:] - after[:, 7:]).abs().amin(dim=-1).min() > 1e-6


@torch.no_grad()
def test_emotion_and_actor_change_the_curves():
    net, speech = decoder(actors=("anna",)), torch.randn(1, 4, 6)
    plain = net(speech, emotion(0), None)
    assert (plain - net(speech, emotion(2), None)).abs().max() > 0.01
    anna = torch.cat((emotion(0), torch.ones(1, 1)), dim=1)
    torch.testing.assert_close(net(speech, anna, None), plain)  # a new actor is nobody
    torch.nn.init.normal_(net.actors.weight)
    assert (net(speech, anna, None) - plain).abs().max() > 0.01


def test_gradient_reaches_the_first_frame_through_the_later_ones():
    net, speech = decoder(), torch.randn(1, 6, 6, requires_grad=True)
    net(speech, emotion(0), None)[0, -1].sum().backward()
    assert (speech.grad[0].abs().sum(dim=-1) > 0).all()


@torch.no_grad()
def test_network_reads_a_clip():
    torch.manual_seed(1)
    model = FaceFormer(ComparedModelConfig(frontend=MelConfig(**MEL), **OWN)).eval()
    analysis = model.analyse(0.1 * torch.randn(16_000), 30)
    assert analysis.strength is None
    curves = model.decode(analysis, emotion(1).expand(30, -1))
    expected = model.decoder(analysis.speech.unsqueeze(0), emotion(1), None)
    torch.testing.assert_close(curves, expected[0])


def test_network_is_not_fine_tuned(tmp_path):
    config = ComparedConfig(
        name="other", model=ComparedModelConfig(frontend=MelConfig(**MEL), **OWN)
    )
    model = FaceFormer(config.model)
    with pytest.raises(CheckpointError, match="for comparison"):
        _ = model.rig_decoder
    save_model(tmp_path / "m", model, config, {})
    data = write_dataset(tmp_path / "data", 1, 1)
    with one_line(ConfigError, match="has a decoder for comparison"):
        FinetuneTask(recipe(str(tmp_path / "m")), data)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"positions": True}, "takes positions: false"),
        ({"intensity": True}, "takes positions: false"),
        ({"decoder_channels": 9}, "a multiple of decoder_heads"),
        ({"kept_controls": ("CTRL_C_jaw.ty",)}, "takes no .*kept_controls"),
        ({"decoder_labelled": False}, "for decoder: emotalk"),
    ],
)
def test_configuration_rejects_what_the_decoder_has_not(settings, message):
    with pytest.raises(ValueError, match=message):
        ComparedModelConfig(**(OWN | settings))
