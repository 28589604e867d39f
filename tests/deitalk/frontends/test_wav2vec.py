"""The wav2vec frontend against transformers itself, on a tiny random checkpoint; no download."""

import json

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from deitalk.config.frontends import Wav2VecConfig
from deitalk.errors import CheckpointError, ConfigError
from deitalk.frontends.wav2vec import PUBLISHED, SPEECH_SCALE, Wav2VecFrontend
from tests.closeness import SHARE, assert_same
from tests.errors import one_line

TINY = {
    "conv_dim": (32,) * 7,
    "hidden_size": 32,
    "num_hidden_layers": 2,
    "num_attention_heads": 2,
    "intermediate_size": 64,
    "num_conv_pos_embeddings": 16,
    "num_conv_pos_embedding_groups": 2,
}


@pytest.fixture
def checkpoint(tmp_path):
    torch.manual_seed(0)
    folder = tmp_path / "tiny"
    import transformers

    config = transformers.Wav2Vec2Config(**TINY, layerdrop=0.99)
    transformers.Wav2Vec2Model(config).save_pretrained(folder)
    transformers.Wav2Vec2FeatureExtractor(do_normalize=True).save_pretrained(folder)
    return folder


@pytest.fixture
def speech(rng):
    t = np.arange(2 * 16000) / 16000
    samples = np.sin(2 * np.pi * 150 * t) * np.sin(2 * np.pi * 3 * t) ** 2 * 0.1
    return torch.tensor(samples + rng.normal(0, 0.01, t.shape), dtype=torch.float32)


def test_features_are_those_of_transformers(checkpoint, speech):
    frontend = Wav2VecFrontend.from_pretrained(str(checkpoint)).eval()
    import transformers

    model = transformers.Wav2Vec2Model.from_pretrained(checkpoint).eval()
    extractor = transformers.Wav2Vec2FeatureExtractor.from_pretrained(checkpoint)
    level = 10 ** (-23 / 20)
    speech = level * (speech - speech.mean()) / speech.std(correction=0)
    values = extractor(speech.numpy(), sampling_rate=16000, return_tensors="pt").input_values
    with torch.no_grad():
        expected = model(values).last_hidden_state
        features = frontend.features(speech[None])
    assert features.shape == (1, (32000 - 400) // 320 + 1, 32)
    assert_same(features, expected)


def test_window_of_a_training_is_scaled_as_the_whole_clip(checkpoint, speech):
    """Silence before speech, or its end, changes no scale: the stem's rows stay (§4.1 windows)."""
    frontend = Wav2VecFrontend.from_pretrained(str(checkpoint)).eval()
    given = []
    frontend.encoder.register_forward_pre_hook(lambda module, inputs: given.append(inputs[0][0]))
    clip = torch.cat((torch.zeros(16_000), speech))
    with torch.no_grad():
        frontend(speech[None, :8000], 15)  # a window
        frontend.encode(clip, 90)  # the clip that it is of
    torch.testing.assert_close(given[0], given[1][16_000:24_000])


def test_one_feature_depends_on_exactly_its_margin():
    frontend = Wav2VecFrontend.from_config(TINY).eval()
    stem = frontend.encoder.feature_extractor
    with torch.no_grad():
        quiet = torch.randn(1, 4000, generator=torch.manual_seed(0)) * 0.01
        for sample, is_used in ((639, False), (640, True), (1039, True), (1040, False)):
            click = quiet.clone()
            click[0, sample] += 1
            change = (stem(click) - stem(quiet))[0, :, 2]
            assert bool(change.abs().max() > 1e-6) is is_used, sample


def test_rows_are_exact_in_time():
    """Features that hold their own time in seconds give rows that hold theirs."""
    frontend = Wav2VecFrontend.from_config(TINY)
    seconds = (torch.arange(99, dtype=torch.float64) * 320 + 199.5) / 16000
    rows = frontend.rows(seconds.view(1, -1, 1), 0, 60, first_sample=0)[0, :, 0]
    inside = torch.arange(1, 59)  # frame 0 is before the first feature, 59 before the last
    torch.testing.assert_close(rows[inside], inside.double() / 30, atol=1e-9, rtol=0)
    assert rows[0] == seconds[0]


class NoDouble(TorchDispatchMode):
    """Refuses double precision on any device but the CPU, as MPS does."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        out = func(*args, **(kwargs or {}))
        for tensor in out if isinstance(out, tuple) else (out,):
            if isinstance(tensor, torch.Tensor):
                assert tensor.dtype != torch.float64 or tensor.device.type == "cpu", func
        return out


def test_rows_need_no_double_precision_of_the_device():
    frontend = Wav2VecFrontend.from_config(TINY)
    with NoDouble():
        rows = frontend.rows(torch.zeros(2, 6, 4, device="meta"), 0, 5, first_sample=0)
    assert rows.device.type == "meta" and rows.shape == (2, 5, 4)


def test_frozen_stem_gets_no_gradient_and_the_rest_does(checkpoint, speech):
    frontend = Wav2VecFrontend.from_pretrained(str(checkpoint)).train()
    frontend(speech[None], 60).square().sum().backward()
    stem = frontend.encoder.feature_extractor
    assert all(p.grad is None and not p.requires_grad for p in stem.parameters())
    rest = {n: p for n, p in frontend.named_parameters() if p.requires_grad}
    assert rest and not any("feature_extractor" in name for name in rest)
    assert all(p.grad is not None for p in rest.values())  # nothing unused: fit for DDP


def test_a_clip_of_one_chunk_is_encoded_at_once(checkpoint, speech):
    frontend = Wav2VecFrontend.from_pretrained(str(checkpoint)).eval()
    with torch.no_grad():
        whole = frontend(speech[None], 60)[0]
    assert torch.equal(frontend.encode(speech, 60), whole)


def local_frontend():
    """A compact encoder whose layers depend on nearby features only, so that chunks are exact."""
    torch.manual_seed(0)
    frontend = Wav2VecFrontend.from_config(TINY | {"num_hidden_layers": 1}).eval()
    for layer in frontend.encoder.encoder.layers:
        torch.nn.init.zeros_(layer.attention.out_proj.weight)
    return frontend


@pytest.mark.parametrize("n_frames", [61, 90, 119, 121, 200, 301])
def test_chunks_of_a_local_encoder_equal_the_whole(rng, n_frames):
    """Without attention, chunks must equal the whole."""
    frontend = local_frontend()
    waveform = torch.tensor(rng.normal(0, 0.07, n_frames * 1600 // 3), dtype=torch.float32)
    with torch.no_grad():
        whole = frontend(waveform[None], n_frames)[0]
    chunked = frontend.encode(waveform, n_frames, chunk_seconds=2, overlap_seconds=1)
    assert chunked.shape == whole.shape
    # the position convolution (8 features on either side) is cut at a chunk's edge, where the
    # cross-fade gives it little weight; elsewhere the two agree to rounding
    difference = (chunked - whole).abs().amax(1)
    assert difference.median() < SHARE * whole.abs().max()
    assert difference.max() < 0.15 * whole.std()


@pytest.mark.parametrize("kind", ["group", "layer"])
def test_chunks_with_attention_stay_close_to_the_whole(rng, kind):
    """Random attention spans the whole chunk, the worst case; tolerance 5 % of the spread."""
    torch.manual_seed(0)
    frontend = Wav2VecFrontend.from_config(TINY | {"feat_extract_norm": kind}).eval()
    waveform = torch.tensor(rng.normal(0, 0.07, 30 * 16000), dtype=torch.float32)
    with torch.no_grad():
        whole = frontend(waveform[None], 900)[0]
    chunked = frontend.encode(waveform, 900, chunk_seconds=10, overlap_seconds=2)
    assert (chunked - whole).square().mean().sqrt() < 0.05 * whole.std()


@pytest.mark.slow
def test_the_papers_encoder_is_built_without_the_hub():
    frontend = Wav2VecFrontend.build(Wav2VecConfig(), pretrained=False)
    assert frontend.output_size == 768
    n_parameters = sum(p.numel() for p in frontend.parameters())
    assert n_parameters == pytest.approx(94.4e6, rel=1e-3)  # wav2vec 2.0 base, published as 95M


def test_missing_checkpoint_offline_names_the_way_out():
    with one_line(CheckpointError, PUBLISHED, "hf download", "mel frontend", match="cannot find"):
        Wav2VecFrontend.from_pretrained(PUBLISHED)


def test_from_pretrained_rejects_pickles(checkpoint):
    import transformers

    weights = transformers.Wav2Vec2Model.from_pretrained(checkpoint).state_dict()
    (checkpoint / "model.safetensors").unlink()
    torch.save(weights, checkpoint / "pytorch_model.bin")
    with one_line(CheckpointError, match=r"model\.safetensors"):
        Wav2VecFrontend.from_pretrained(str(checkpoint))


def test_from_pretrained_rejects_weights_of_another_shape(checkpoint):
    config = json.loads((checkpoint / "config.json").read_text())
    (checkpoint / "config.json").write_text(json.dumps(config | {"num_hidden_layers": 3}))
    with one_line(CheckpointError, match="lacks 16 weights"):
        Wav2VecFrontend.from_pretrained(str(checkpoint))
    (checkpoint / "config.json").write_text(json.dumps(config | {"hidden_size": 64}))
    with one_line(CheckpointError):
        Wav2VecFrontend.from_pretrained(str(checkpoint))


KINDS = {
    "wav2vec2": "Wav2Vec2",
    "hubert": "Hubert",
    "wavlm": "WavLM",
    "data2vec-audio": "Data2VecAudio",
}
"""Encoders by the names of their folders: beginnings of names in transformers."""


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_encoder_reads_as_in_transformers(kind, tmp_path, speech):
    """By the name of its folder; a saved configuration builds it again."""
    torch.manual_seed(2)
    import transformers

    config, model = (getattr(transformers, KINDS[kind] + part) for part in ("Config", "Model"))
    model(config(**TINY)).save_pretrained(tmp_path)
    theirs = model.from_pretrained(tmp_path).eval()
    settings = Wav2VecConfig(checkpoint=str(tmp_path))
    frontend = Wav2VecFrontend.build(settings).eval()
    with torch.no_grad():
        expected = theirs(speech[None] * SPEECH_SCALE).last_hidden_state
        assert_same(frontend.features(speech[None]), expected)
    again = Wav2VecFrontend.build(frontend.described(settings), pretrained=False).eval()
    again.load_state_dict(frontend.state_dict())
    assert type(again.encoder) is model
    with torch.no_grad():
        assert_same(again.features(speech[None]), frontend.features(speech[None]))
    frontend.train()(speech[None], 60).square().sum().backward()
    stem = frontend.encoder.feature_extractor.parameters()
    assert all(weight.grad is None for weight in stem), "fixed"


def test_chosen_layers_are_standardised_and_mixed(checkpoint, speech):
    settings = Wav2VecConfig(checkpoint=str(checkpoint), layers=(0, 2))
    frontend = Wav2VecFrontend.build(settings).eval()
    frontend.measure([speech.numpy()])
    with torch.no_grad():
        frontend.mix.copy_(torch.tensor([1.0, 3.0]).log())
        states = frontend.encoder(speech[None] * SPEECH_SCALE, output_hidden_states=True)
        scaled = [
            (state - state.mean(dim=1, keepdim=True)) / state.std(dim=1, keepdim=True)
            for state in (states.hidden_states[0], states.hidden_states[2])
        ]
        expected = 0.25 * scaled[0].clamp(-6, 6) + 0.75 * scaled[1].clamp(-6, 6)
        torch.testing.assert_close(frontend.features(speech[None]), expected, atol=0.02, rtol=0)
    frontend.train()(speech[None], 60).square().sum().backward()
    assert frontend.mix.grad is not None


def test_an_encoder_that_learns_nothing_stays_as_it_is(checkpoint, speech):
    """Without gradients, and without its dropout."""
    settings = Wav2VecConfig(checkpoint=str(checkpoint), learns="nothing")
    frontend = Wav2VecFrontend.build(settings).train()
    assert not any(weight.requires_grad for weight in frontend.encoder.parameters())
    assert torch.equal(frontend.features(speech[None]), frontend.features(speech[None]))
    assert frontend.training and not frontend.encoder.training


def test_layers_that_the_encoder_lacks_are_refused_in_one_line(checkpoint):
    with one_line(ConfigError, match=r"layers=\[1, 3\]: the encoder has 2"):
        Wav2VecFrontend.build(Wav2VecConfig(checkpoint=str(checkpoint), layers=(1, 3)))


@pytest.mark.parametrize(
    ("encoder", "words"),
    [
        ({"hiden_size": 32}, "hiden_size"),
        ({"model_type": "bert"}, "must be wav2vec2, hubert"),
        ({"hidden_size": 30, "num_attention_heads": 4}, "impossible"),
        ({"conv_dim": (32, 32)}, "impossible"),
    ],
)
def test_from_config_rejects_impossible_shapes(encoder, words):
    with one_line(ConfigError, match=words):
        Wav2VecFrontend.build(Wav2VecConfig(checkpoint=None, encoder=encoder))
