"""Mel frontend: SDFA's tables, windows against a naive loop, segments against the whole."""

import pytest
import torch
from torch.nn import functional as F

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.config.frontends import MelConfig
from deitalk.frontends.mel_bilstm import SEGMENT_FRAMES, MelFrontend, TemporalAttention
from tests.closeness import assert_same

SMALL = {
    "n_mels": 16,
    "conv_channels": (4, 4, 4),
    "spec_hidden": 4,
    "spectral_size": 12,
    "time_hidden": 8,
    "attention_size": 6,
}
SEGMENT = SMALL | {
    "window_seconds": 0.032,
    "frame_rate": 60,
    "window_frames": 32,
    "query_frames": 5,
    "recurrence": "segment",
    "weight_norm": False,
    "centre": True,
}


def frontend(gain=8.0, **settings):
    """Random weights; torch's own lose the signal, so the first layers are made larger."""
    torch.manual_seed(4)
    built = MelFrontend(MelConfig(**settings))
    brings = ("weight_ih", "convolve", "project.weight", "project.parametrizations", "score")
    with torch.no_grad():
        for name, parameter in built.named_parameters():
            if any(part in name for part in brings) and not name.endswith(("original1", "bias")):
                parameter *= gain if "weight_ih" in name else gain**0.5
    for module in built.modules():  # as after training: a norm that is not the identity
        if isinstance(module, torch.nn.BatchNorm2d):
            module.running_mean.normal_(std=0.3)
            module.running_var.uniform_(0.5, 2)
    return built.eval()


def noise(seconds, seed=0):
    generator = torch.Generator().manual_seed(seed)
    n = int(seconds * SAMPLE_RATE)
    swell = 0.05 + torch.rand(n // 800 + 1, generator=generator).repeat_interleave(800)[:n]
    return (0.3 * swell * torch.randn(n, generator=generator)).unsqueeze(0)


@pytest.fixture(scope="module")
def paper():
    return frontend(gain=1.0)


def test_shapes_of_table_one(paper):
    seen = {}
    handles = [
        layer.register_forward_hook(lambda m, i, o, name=name: seen.update({name: o}))
        for name, layer in paper.spectral.convolve.named_children()
    ]
    mel = paper.mel(noise(0.6), 64)
    spectral = paper.spectral(mel)
    for handle in handles:
        handle.remove()
    assert mel.shape == (1, 3, 128, 64)
    # 64 spectra side by side, (channels, bins) in each: 32 x 128, pooled, 64 x 64, pooled, 64 x 32
    shapes = [tuple(seen[name].shape) for name in ("1", "2", "5", "6", "10")]
    sizes = [(32, 128), (32, 64), (64, 64), (64, 32), (64, 32)]
    assert shapes == [(1, *size, 64) for size in sizes]
    assert seen["2"].min() < 0  # leaky
    assert paper.spectral.project.in_features == 2048
    assert spectral.shape == (1, 64, 256)


def test_shapes_of_table_two(paper):
    memory, _ = paper.recurrent(torch.randn(1, 64, 256))
    assert memory.shape == (1, 64, 512)
    attended, weights = paper.attention.windows(memory, memory[:, 29:36])
    assert attended.shape == (1, 512)
    assert weights.shape == (1, 64)
    torch.testing.assert_close(weights.sum(), torch.tensor(1.0))
    assert paper(noise(0.2), 6).shape == (1, 6, 512)
    assert paper.output_size == 512


def naive(model, waveform, n_frames):
    """SDFA as printed: for every frame its own window through every stage, one at a time."""
    config, attention, rows = model.config, model.attention, []
    window, taps, hop = config.window_frames, config.query_frames, SAMPLE_RATE / config.frame_rate
    extra = window + 4
    padded = F.pad(waveform, (round(extra * hop), round(extra * hop)))
    for i in range(n_frames):
        centre = int(torch.round(torch.tensor(i * config.frame_rate / 30, dtype=torch.float64)))
        first = extra + centre - window // 2
        mel = model.mel(padded, window + 4, first - 2)[..., 2:-2]  # derivatives of the clip
        memory, _ = model.recurrent(model.spectral(mel))
        memory = memory[0]
        middle = memory[window // 2 - taps // 2 :][:taps]
        kernel = attention.query.weight  # (out, in, tap)
        query = sum(kernel[:, :, k] @ middle[k] for k in range(taps)) + attention.query.bias
        query = attention.query_project(query)
        scores = [
            (attention.score.weight @ torch.tanh(attention.key_project(m) + query)).squeeze()
            for m in memory
        ]
        weights = torch.stack(scores).exp()
        attended = (weights.unsqueeze(1) * memory).sum(dim=0) / weights.sum()
        if model.normalise is not None:
            attended = model.normalise(attended + memory[window // 2])
        rows.append(attended)
    return torch.stack(rows)


@pytest.mark.parametrize(
    "settings",
    [
        SMALL,
        SMALL | {"window_frames": 9, "query_frames": 3},  # an odd window
        SMALL | {"centre": True, "weight_norm": False},
    ],
)
@torch.no_grad()
def test_windows_equal_a_loop_over_windows(settings):
    model = frontend(**settings).double()
    speech = noise(0.5).double()
    quiet = torch.zeros_like(speech)  # outside the requested rows there is no derivative
    waveform = torch.cat((quiet, speech, quiet), dim=1)
    rows = model(waveform, 45)[0]
    torch.testing.assert_close(rows, naive(model, waveform, 45), atol=1e-8, rtol=0)
    assert rows[15:30].std(dim=0).mean() > 1e-2  # they differ, so equality says something


@torch.no_grad()
def test_attention_along_a_clip_equals_attention_in_windows():
    torch.manual_seed(5)
    attention = TemporalAttention(8, 6, 3)
    memory, centres = torch.randn(2, 50, 8), torch.tensor([10, 17, 30])
    along = attention.along(memory, centres, window=12)
    for i, centre in enumerate(centres.tolist()):
        window = memory[:, centre - 6 : centre + 6]
        expected, _ = attention.windows(window, memory[:, centre - 1 : centre + 2])
        torch.testing.assert_close(along[:, i], expected)


@torch.no_grad()
def test_windows_by_segments_equal_the_whole_clip():
    model = frontend(**SMALL | {"window_frames": 16})
    n_frames = SEGMENT_FRAMES + 50
    waveform = noise(n_frames / 30)
    whole = model(waveform, n_frames)[0]
    assert_same(model.encode(waveform[0], n_frames), whole)


@pytest.mark.parametrize("settings", [SMALL, SEGMENT])
@torch.no_grad()
def test_clips_of_a_batch_are_independent(settings):
    model = frontend(**settings)
    clips = [noise(1.0, seed) for seed in (1, 2)]
    both = model(torch.cat(clips), 30)
    for row, clip in zip(both, clips, strict=True):
        assert_same(row, model(clip, 30)[0])


def test_rig_layers_start_as_identity_and_reach_beyond_the_window():
    short = SMALL | {"frame_rate": 60, "window_frames": 16, "query_frames": 5}
    plain, deep = frontend(**short), frontend(**short, rig_layers=2)
    deep.load_state_dict(plain.state_dict(), strict=False)
    early, late = noise(2.0), noise(2.0)
    late[:, SAMPLE_RATE:] *= 3  # louder a second after the beginning
    with torch.no_grad():
        rows = plain(early, 60)
        torch.testing.assert_close(deep(early, 60), rows, rtol=0, atol=0)
        torch.testing.assert_close(plain(late, 60)[:, :15], rows[:, :15])
        for layer in deep.rig:
            torch.nn.init.normal_(layer.project.weight)
        assert (deep(late, 60) - deep(early, 60))[:, :15].abs().amax() > 1e-3
        alone = deep.rig[0](rows)  # x + W BiLSTM(x) + b
        context = deep.rig[0].recurrent(rows)[0]
        torch.testing.assert_close(alone, rows + context @ deep.rig[0].project.weight.T)
