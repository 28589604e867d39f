"""Conformer frontend: rows in time, segments against the whole, impossible sizes."""

from pathlib import Path

import pytest
import torch

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.config import ConformerConfig, load_config, parse_config
from deitalk.errors import ConfigError
from deitalk.frontends import build_frontend
from deitalk.frontends.conformer import CONTEXT_FRAMES, SEGMENT_FRAMES, ConformerFrontend
from tests.closeness import assert_same

CONFORMER = Path(__file__).resolve().parents[3] / "configs" / "conformer.yaml"
SMALL = {"n_mels": 16, "stem_channels": 12, "hidden_size": 16, "heads": 2, "intermediate_size": 24}


def frontend(**settings):
    torch.manual_seed(5)
    built = ConformerFrontend(
        ConformerConfig(**(SMALL | {"layers": 2, "kernel_size": 5} | settings))
    )
    for module in built.modules():  # as after training: a norm that is not the identity
        if isinstance(module, torch.nn.BatchNorm1d):
            module.running_mean.normal_(std=0.3)
            module.running_var.uniform_(0.5, 2)
    return built.eval()


def local(**settings):
    """Blocks without attention, whose reach is that of their convolutions."""
    built = frontend(**settings)
    for layer in built.encoder.layers:
        torch.nn.init.zeros_(layer.self_attn.linear_out.weight)
    return built


def noise(seconds):
    generator = torch.Generator().manual_seed(0)
    return 0.1 * torch.randn(1, round(seconds * SAMPLE_RATE), generator=generator)


@torch.no_grad()
def test_row_i_describes_time_i():
    """A click at frame 40 changes rows as far before it as after it, and only near it."""
    model = local()
    quiet = noise(3)
    loud = quiet.clone()
    loud[0, 40 * SAMPLE_RATE // 30] += 3.0
    change = (model(loud, 90) - model(quiet, 90))[0].norm(dim=1)
    # One convolution of 5 frames a block; stem, derivatives and window reach 100 ms: 2 * 2 + 3.
    touched = change.nonzero().flatten()
    assert touched.min() >= 40 - 7
    assert touched.max() <= 40 + 7
    frames = torch.arange(90)
    assert (change * frames).sum() / change.sum() == pytest.approx(40, abs=0.6)


@torch.no_grad()
@pytest.mark.parametrize("n_frames", [1, 63, 64, 65, 130, 200])
def test_segments_of_local_blocks_are_the_whole(n_frames):
    """30 frames of reach fit the context, so segments must equal the whole."""
    model = local(layers=3, kernel_size=17)
    speech = noise(n_frames / 30)
    assert_same(model.encode(speech[0], n_frames), model(speech, n_frames)[0])


@torch.no_grad()
def test_attention_spans_the_whole_window_and_no_piece_is_longer(monkeypatch):
    model = frontend()
    quiet = noise(128 / 30)
    loud = quiet.clone()
    loud[0, :1600] += 0.5
    assert (model(loud, 128) - model(quiet, 128))[0, -1].norm() > 1e-6
    lengths = []
    monkeypatch.setattr(
        model.encoder, "forward", _spy(model.encoder.forward, lengths), raising=True
    )
    shares = []
    model.encode(noise(10)[0], 300, progress=shares.append)
    assert max(lengths) == SEGMENT_FRAMES + 2 * CONTEXT_FRAMES == 128  # training's windows
    assert len(lengths) == 5
    assert shares[-1] == 1
    assert shares == sorted(shares)


def _spy(forward, lengths):
    def spied(hidden, *args, **kwargs):
        lengths.append(hidden.shape[1])
        return forward(hidden, *args, **kwargs)

    return spied


@torch.no_grad()
@pytest.mark.parametrize("n_samples", [0, 1, 500, 16000])
def test_beyond_the_sound_there_is_silence(n_samples):
    model = frontend()
    speech = noise(1)[:, :n_samples]
    padded = torch.nn.functional.pad(speech, (0, 40000 - n_samples))
    torch.testing.assert_close(model(speech, 40), model(padded, 40))


def test_every_weight_gets_a_gradient():
    model = frontend().train()
    model(noise(2), 60).square().sum().backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in model.parameters())


def test_compact_is_built_from_its_file():
    config = load_config(CONFORMER)
    built = build_frontend(config.model.frontend)
    assert isinstance(built, ConformerFrontend)
    assert built.output_size == config.model.frontend.hidden_size


def test_configuration_rejects_heads_that_do_not_divide_the_width():
    with pytest.raises(ConfigError, match="hidden_size=18") as error:
        frontend(hidden_size=18, heads=4)
    assert "\n" not in str(error.value)


def test_configuration_rejects_even_kernels():
    with pytest.raises(ConfigError, match="kernel_size"):
        parse_config({"model": {"frontend": {"kind": "conformer", "kernel_size": 4}}})
