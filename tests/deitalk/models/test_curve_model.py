"""The network: sizes by hand, chunks against the whole, batches against single runs."""

from pathlib import Path

import numpy as np
import pytest
import torch
from torch.nn import functional as F
from torch.utils._python_dispatch import TorchDispatchMode

import deitalk.models.curve_model
from deitalk.audio.frames import frame_count
from deitalk.config.curves import ModelConfig
from deitalk.config.frontends import MelConfig
from deitalk.models.checkpoint import load_model
from deitalk.models.curve_model import DECODE_FRAMES, DEITalk
from deitalk.models.intensity import temporal_maximum
from deitalk.models.positions import dynamic_positions
from deitalk.research.config import read_training
from tests.closeness import assert_same

CONFIGS = Path(__file__).resolve().parents[3] / "configs"
MEL = {
    "n_mels": 16,
    "conv_channels": (4, 4, 4),
    "spec_hidden": 4,
    "spectral_size": 12,
    "time_hidden": 8,
    "attention_size": 6,
    "window_seconds": 0.032,
    "frame_rate": 60,
    "window_frames": 16,
    "query_frames": 3,
    "recurrence": "segment",
    "weight_norm": False,
    "centre": True,
}
SMALL = {
    "emotion_size": 8,
    "motion_channels": (8, 8),
    "classifier_size": 4,
    "decoder_channels": 24,
    "decoder_residual": True,
}


def build(**settings):
    torch.manual_seed(6)
    model = DEITalk(ModelConfig(frontend=MelConfig(**MEL), **(SMALL | settings))).eval()
    with torch.no_grad():
        model.decoder.output.weight.normal_(std=0.2)
    return model


def place(frames, total, first=0):
    return torch.arange(first, first + frames).unsqueeze(0), torch.tensor([total])


def styles(*indices):
    return F.one_hot(torch.tensor(indices), 5).float()


def count(module):
    return sum(p.numel() for p in module.parameters())


def test_default_sizes_are_those_of_section_four():
    """configs/deitalk.yaml without the download, on the meta device."""
    with torch.device("meta"):
        model = DEITalk(read_training(CONFIGS / "deitalk.yaml").model, pretrained=False).eval()
        frames, total = place(15, 100, first=40)
        inputs = torch.randn(1, 8000), styles(3), frames, total, torch.zeros(1, 15, 185)
    assert count(model.frontend) == 94_371_712  # wav2vec 2.0 base
    stem = count(model.frontend.encoder.feature_extractor)
    trainable = sum(p.numel() for p in model.frontend.parameters() if p.requires_grad)
    assert trainable == 94_371_712 - stem - 768  # fixed: the stem and the unused mask embedding
    joined = 16 + 128
    decoder = 5 * 16 + ((768 + joined) * 3 * 512 + 512) + 7 * ((512 + joined) * 3 * 512 + 512)
    assert count(model.decoder) == decoder + 512 * 185 + 185
    motion = 3 * (185 * 384 + 384 * 384 + 384 * 768 + 768 * 768) + 2 * (384 + 768)
    assert count(model.motion) == motion + 768 * 128 + 128
    classifier = (128 * 64 + 64) + (64 * 5 + 5)
    assert count(model.intensity) == 768 * 128 + 128 + classifier + 2  # slope and offset are ours
    with torch.no_grad(), torch.device("meta"):
        out = model(*inputs)
    assert out.curves.shape == (1, 15, 185)
    assert out.intensity.guidance.shape == (1, 15, 128)
    assert out.intensity.saliency.shape == (1, 15)
    assert out.emotion_logits.shape == (1, 5)
    assert out.motion_embedding.shape == (1, 128)


@torch.no_grad()
def test_forward_equals_its_stages_in_order():
    model = build()
    waveform, curves = 0.1 * torch.randn(2, 16_000), torch.rand(2, 30, 185)
    frames = torch.stack((torch.arange(30), torch.arange(50, 80)))
    total, emotion = torch.tensor([30, 200]), styles(1, 3)
    out = model(waveform, emotion, frames, total, curves)
    speech = model.frontend(waveform, 30)
    output = model.intensity(speech)  # S_emo depends on the speech, not on its place (Fig. 2)
    placed = speech + dynamic_positions(frames, total, 16)
    torch.testing.assert_close(out.curves, model.decoder(placed, emotion, output.guidance))
    torch.testing.assert_close(out.emotion_logits, model.intensity.classify(output.features))
    torch.testing.assert_close(out.motion_embedding, temporal_maximum(model.motion(curves)))
    without = model(waveform, emotion, frames, total)
    assert without.motion_embedding is None
    assert torch.equal(without.curves, out.curves)  # captured curves only teach


@torch.no_grad()
def test_clips_of_a_batch_are_independent():
    model = build()
    waveform = 0.1 * torch.randn(2, 16_000)
    frames, total = torch.stack((torch.arange(30), torch.arange(9, 39))), torch.tensor([30, 60])
    both = model(waveform, styles(1, 4), frames, total)
    for i, emotion in enumerate((1, 4)):
        one = model(waveform[i : i + 1], styles(emotion), frames[i : i + 1], total[i : i + 1])
        assert_same(both.curves[i], one.curves[0])
        assert_same(both.intensity.strength[i], one.intensity.strength[0])


@torch.no_grad()
def test_whole_clip_equals_one_forward():
    model = build()
    waveform, n = 0.1 * torch.randn(16_000 * 3), 90
    frames, total = place(n, n)
    one = model(waveform.unsqueeze(0), styles(2), frames, total)
    analysis = model.analyse(waveform, n)
    assert_same(analysis.saliency, one.intensity.saliency[0])
    curves = model.decode(analysis, styles(2).expand(n, -1))
    assert_same(curves, one.curves[0])


@pytest.mark.parametrize("saliency_frames", [None, 31, 121])
@torch.no_grad()
def test_pieces_equal_one_piece(monkeypatch, saliency_frames):
    model = build(saliency_frames=saliency_frames, effort=True, lips=True)
    n = 2 * DECODE_FRAMES + 300
    speech = torch.randn(n, 16)
    monkeypatch.setattr(model.frontend, "encode", lambda waveform, frames, **_: speech[:frames])
    emotion = torch.rand(n, 5).softmax(dim=-1)

    def read():
        analysis = model.analyse(torch.zeros(1), n)
        return analysis, model.decode(analysis, emotion)

    pieces, curves = read()
    monkeypatch.setattr(deitalk.models.curve_model, "DECODE_FRAMES", n)
    whole, expected = read()
    for piece, one in zip(pieces, whole, strict=True):
        assert_same(piece, one)
    assert_same(curves, expected)
    direct = model.intensity(speech.unsqueeze(0))
    torch.testing.assert_close(whole.saliency, direct.saliency[0])
    assert curves.std(dim=0).min() > 1e-2


@torch.no_grad()
def test_place_in_the_clip_changes_curves_only_with_positions():
    waveform = 0.1 * torch.randn(1, 16_000)
    for positions in (True, False):
        model = build(positions=positions)
        start = model(waveform, styles(1), *place(30, 300, 0)).curves
        later = model(waveform, styles(1), *place(30, 300, 200)).curves
        assert torch.equal(start, later) is not positions


SAMPLES = (24_000, 23_700, 16_000, 23_480)


def test_recordings_are_read_together_as_each_alone(rng):
    """Three of one number of frames; emotions and actors by recording."""
    frontend = MelConfig(**MEL, rig_layers=1)
    config = ModelConfig(
        frontend=frontend, motion_channels=(8,), decoder_channels=16, actors=("anna", "bo")
    )
    model = DEITalk(config).eval()
    with torch.no_grad():
        model.decoder.output.weight.normal_(std=0.15)
        model.decoder.actors.weight.normal_()
        model.frontend.rig[0].project.weight.normal_(std=0.3)
    sounds = [0.1 * rng.standard_normal(n).astype(np.float32) for n in SAMPLES]
    weights = [np.zeros((n, 5), np.float32) for n in (45, 45, 30, 45)]
    weights[0][:, 0] = weights[1][:, 2] = weights[2][:, 1] = 1
    weights[3][:20, 1] = weights[3][20:, 0] = 1
    names = ["anna", "", "", "bo"]
    together = model.read_together(sounds, weights, names)
    for found, alone in zip(together, map(model.read, sounds, weights, names), strict=True):
        np.testing.assert_allclose(found.neutral, alone.neutral, atol=1e-5)
        np.testing.assert_allclose(found.emotional, alone.emotional, atol=1e-5)
        np.testing.assert_allclose(found.tracks.saliency, alone.tracks.saliency, atol=1e-5)
        np.testing.assert_allclose(found.tracks.strength, alone.tracks.strength, atol=1e-5)
    assert together[0].emotional is together[0].neutral
    assert abs(together[1].emotional - together[1].neutral).max() > 0.01


class Calls(TorchDispatchMode):
    """Counts calls of torch's functions, each a start of a kernel on a GPU."""

    count = 0

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        self.count += 1
        return function(*args, **(kwargs or {}))


def _lines(count, rng, longest):
    """Recordings of different lengths up to so many samples, and happy, neutral or mixed weights of each."""
    sizes = rng.integers(200, longest, count)
    sounds = [0.1 * rng.standard_normal(size).astype(np.float32) for size in sizes]
    rows = [np.eye(5, dtype=np.float32), np.full((1, 5), 0.2, np.float32)]
    kinds = np.concatenate(rows)
    weights = [kinds[[k % 6] * frame_count(len(x))] for k, x in enumerate(sounds)]
    return sounds, weights, [""] * count


@pytest.mark.parametrize("name", ["default", "live"])
def test_recordings_of_any_lengths_read_together_are_as_each_alone(name, rng, monkeypatch):
    model = load_model(name)
    monkeypatch.setattr("deitalk.models.curve_model.FRAMES_TOGETHER", 250)
    sounds, weights, actors = _lines(7, rng, 80_000)
    together = model.read_together(sounds, weights, actors)
    span = model.controls.maximum - model.controls.minimum
    for found, alone in zip(together, map(model.read, sounds, weights, actors), strict=True):
        for one, other in ((found.neutral, alone.neutral), (found.emotional, alone.emotional)):
            assert one.shape == other.shape and (abs(one - other) / span).max() <= 1e-4
        for one, other in zip(found.tracks, alone.tracks, strict=True):
            np.testing.assert_allclose(one, other, atol=1e-4)


def test_calls_do_not_grow_with_the_recordings_that_are_read_together(rng):
    model, counts = load_model("default"), []
    for count in (4, 32):
        given = _lines(count, rng, 16_000)
        with Calls() as calls:
            model.read_together(*given)
        counts.append(calls.count)
    assert counts[1] <= 1.3 * counts[0]
