"""The Whisper frontend against transformers itself, on tiny random weights; no download."""

import json

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from transformers import WhisperConfig as TheirConfig
from transformers import WhisperFeatureExtractor, WhisperForConditionalGeneration, WhisperModel
from transformers.models.whisper.modeling_whisper import WhisperEncoder as TheirEncoder

from deitalk.audio.frames import frame_count
from deitalk.audio.log_mel import loudest
from deitalk.config.curves import Config
from deitalk.config.frontends import WhisperConfig
from deitalk.errors import CheckpointError
from deitalk.frontends import build_frontend
from deitalk.frontends.whisper import LogMel, WhisperFrontend
from deitalk.models.checkpoint import load_model, save_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.folder import describe_model, weights_hash
from tests.deitalk.models.test_curve_model import SMALL
from tests.errors import one_line

TINY = {"n_mels": 16, "width": 32, "heads": 4, "intermediate": 48}
THEIRS = {
    "num_mel_bins": 16, "d_model": 32, "encoder_layers": 3, "encoder_attention_heads": 4,
    "encoder_ffn_dim": 48, "max_source_positions": 600, "decoder_layers": 1,
    "decoder_attention_heads": 2, "decoder_ffn_dim": 16, "vocab_size": 60, "pad_token_id": 0,
    "bos_token_id": 0, "eos_token_id": 0, "decoder_start_token_id": 0,
}  # fmt: skip


def saved(kind, folder):
    """A random checkpoint of transformers, large enough that layers matter."""
    torch.manual_seed(0)
    model = kind(TheirConfig(**THEIRS)).eval()
    with torch.no_grad():
        for name, weight in model.named_parameters():
            if "embed_positions" not in name:  # sines, in every checkpoint
                weight.normal_(std=0.2)
    model.save_pretrained(folder)
    return model


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whisper")
    return folder, saved(TheirEncoder, folder)


def tiny(**changes):
    """A frontend of random weights."""
    torch.manual_seed(1)
    frontend = WhisperFrontend(WhisperConfig(**TINY | {"checkpoint": None, **changes})).eval()
    with torch.no_grad():
        for weight in frontend.encoder.parameters():
            weight.normal_(std=0.1)
    return frontend


def speech(seconds, seed=0):
    """Bursts of a vowel in faint noise [shape=(S,)]."""
    rng, t = np.random.default_rng(seed), np.arange(round(seconds * 16_000)) / 16_000
    tone = sum(np.sin(2 * np.pi * 130 * k * t) / k for k in range(1, 20))
    samples = 0.1 * tone * np.sin(2 * np.pi * 2.3 * t) ** 2 + rng.normal(0, 1e-4, t.shape)
    return torch.tensor(samples, dtype=torch.float32)


def test_states_are_those_of_transformers(checkpoint):
    folder, theirs = checkpoint
    frontend = WhisperFrontend.build(
        WhisperConfig(**TINY, checkpoint=str(folder), layers=(0, 2), rate=50)
    ).eval()
    mel = torch.randn(2, 16, 1200, generator=torch.manual_seed(2))
    with torch.no_grad():
        expected = theirs(mel, output_hidden_states=True).hidden_states
        found = frontend.encoder(mel)
    assert len(found) == 3, "the third layer is not needed"
    for ours, other in zip(found, expected[:3], strict=True):  # the last of theirs is normalised
        torch.testing.assert_close(ours, other, atol=1e-5, rtol=1e-5)
    assert float((found[2] - found[1]).std()) > 0.1, "layers matter"


@pytest.mark.parametrize("kind", [TheirEncoder, WhisperModel, WhisperForConditionalGeneration])
def test_weights_are_read_from_any_whisper_model(kind, tmp_path):
    model = saved(kind, tmp_path)
    (prefix,) = {
        n.removesuffix("conv1.bias") for n in model.state_dict() if n.endswith("conv1.bias")
    }
    frontend = build_frontend(WhisperConfig(**TINY, checkpoint=str(tmp_path), layers=(1,)))
    for name, weight in frontend.encoder.state_dict().items():
        assert torch.equal(weight, model.state_dict()[prefix + name]), name


@pytest.mark.parametrize("n_mels", [80, 16])
def test_spectrogram_inside_a_clip_is_that_of_transformers(n_mels):
    sound = speech(3.0)
    extractor = WhisperFeatureExtractor(feature_size=n_mels)
    expected = extractor(
        sound.numpy(), sampling_rate=16_000, return_tensors="pt", padding="do_not_pad"
    ).input_features
    found = LogMel(n_mels)(sound[None], 300)
    assert found.shape == (1, n_mels, 300)
    inside = slice(2, 298)  # at the ends they mirror the sound
    torch.testing.assert_close(found[..., inside], expected[..., inside], atol=2e-4, rtol=0)
    assert float(expected.std()) > 0.3


def test_the_spectrogram_is_float32_where_the_network_is_not():
    """Its logarithms have more digits than bfloat16, and clips are surveyed by the same."""
    frontend, sound = tiny(), speech(12.0)
    expected = frontend.mel(sound[None], 100), frontend.surveys([sound.numpy()])
    with torch.autocast("cpu", torch.bfloat16):
        found = frontend.mel(sound[None], 100), frontend.surveys([sound.numpy()])
    for a, b in zip(found, expected, strict=True):
        assert torch.equal(a, b)


def test_frames_of_the_spectrogram_lie_on_their_samples():
    """A click at sample 8000 = 160 · 50 is in frames 49, 50 and 51 alone, most in 50."""
    click = torch.zeros(1, 16_000)
    click[0, 8000] = 1
    mel = LogMel(16)
    power = mel.decades(mel.windows(click, 100))[0].amax(dim=1)
    assert power.argmax() == 50
    assert (power > -9).nonzero().flatten().tolist() == [49, 50, 51]


def test_every_piece_has_the_floor_of_the_whole_clip():
    """The silence after a shout is the same however far away the shout is."""
    frontend, shout = tiny(layers=(0,)), 3 * speech(1.0)
    clip = torch.cat((shout, torch.zeros(24 * 16_000)))
    rows = frontend.encode(clip, 750)
    # The second piece begins with row 270: the same positions.
    torch.testing.assert_close(rows[60:250], rows[330:520], atol=1e-3, rtol=0)
    peak = frontend.survey(clip, 1.0)
    silent = frontend.mel(clip[None, 20 * 16_000 :], 450, peak)
    assert float((silent - (peak - 8 + 4) / 4).abs().max()) < 1e-6


def test_a_click_moves_the_rows_around_its_time():
    """Without attention (layer 0): features see ± 2 mel frames, rows the features around."""
    frontend, quiet = tiny(layers=(0,)), 1e-3 * speech(3.0)
    click = quiet.clone()
    click[32_000] += 0.01  # 2 s, row 60
    peak = frontend.survey(click, 1.0)
    with torch.no_grad():
        change = frontend.features(click[None], peak) - frontend.features(quiet[None], peak)
    rows = frontend.rows(change, 0, 90, first_sample=0)[0].abs().amax(dim=1)
    moved = (rows > 1e-6).nonzero().flatten()
    assert rows.argmax() == 60
    assert 58 <= moved.min() and moved.max() <= 62


@pytest.mark.parametrize("n_frames", [301, 330, 571, 700])
def test_pieces_stay_close_to_the_whole(n_frames):
    """Positions and attention span a piece. Away from where pieces begin, rows of the first are
    those of a clip that ends there; a later piece is as close as its own positions allow."""
    frontend, sound = tiny(), speech(n_frames / 30)
    rows = frontend.encode(sound, n_frames)
    assert rows.shape == (n_frames, 32)
    peak = frontend.survey(sound, 1.0)
    with torch.no_grad():
        first = frontend.rows(
            frontend.features(sound[None, :160_000], peak), 0, 300, first_sample=0
        )[0]
    torch.testing.assert_close(rows[:270], first[:270], atol=1e-5, rtol=0)


def test_measured_states_have_mean_0_and_deviation_1():
    """Of the recordings they were measured from; each counts alike."""
    frontend = tiny(layers=(2,))
    sounds = [speech(2.0, seed=k).numpy() for k in range(3)]
    frontend.measure(sounds)
    with torch.no_grad():
        rows = torch.cat([frontend.features(torch.from_numpy(sound)[None])[0] for sound in sounds])
        outer = frontend.features(torch.from_numpy(100 * sounds[0])[None])
    assert float(rows.mean(dim=0).abs().max()) < 1e-3
    spread = rows.std(dim=0)
    assert 0.9 < float(spread.median()) < 1.1
    assert float(outer.abs().max()) <= 6, "limited"
    assert not frontend.norms.training and frontend.norms[0].momentum is not None


def test_layers_are_mixed_by_learnt_weights():
    frontend = tiny(layers=(1, 2))
    sound = speech(1.0)[None]
    single = []
    for k in range(2):
        with torch.no_grad():
            frontend.mix.zero_()[k] = 50
            single.append(frontend.features(sound))
    with torch.no_grad():
        frontend.mix.copy_(torch.tensor([1.0, 3.0]).log())
        mixed = frontend.features(sound)
    torch.testing.assert_close(mixed, 0.25 * single[0] + 0.75 * single[1], atol=1e-5, rtol=0)


@pytest.mark.parametrize("name", ["no/such/folder/at/all", "not a name", "someone/whisper-none"])
def test_missing_checkpoints_are_named_in_one_line(name):
    with one_line(
        CheckpointError, name, "name a folder or a model of the hub", match="no Whisper checkpoint"
    ):
        WhisperFrontend.build(WhisperConfig(**TINY, checkpoint=name))


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"width": 64}, "conv1.weight"),
        ({"n_mels": 80}, "conv1.weight"),
        ({"layers": (4,)}, "layers.3"),
    ],
)
def test_checkpoints_of_another_shape_are_refused_in_one_line(checkpoint, changes, word):
    config = WhisperConfig(**TINY | changes, checkpoint=str(checkpoint[0]))
    with one_line(CheckpointError, "config.json", match=word):
        WhisperFrontend.build(config)


def network(folder, learns="nothing"):
    """A curve model, saved and read again."""
    frontend = {"kind": "whisper", **TINY, "checkpoint": None, "learns": learns}
    config = Config.model_validate({"model": SMALL | {"frontend": frontend}, "name": "tiny"})
    torch.manual_seed(3)
    model = DEITalk(config.model).eval()
    model.frontend.measure([speech(2.0).numpy()])
    with torch.no_grad():  # as shipped encoders are: float16 holds them
        for weight in model.frontend.encoder.parameters():
            weight.copy_(weight.half())
    save_model(folder, model, config, {})
    return model, load_model(folder)


def test_a_saved_model_reads_the_same_and_keeps_a_fixed_encoder_apart(tmp_path):
    before, after = network(tmp_path / "m")
    encoder, rest = (
        load_file(tmp_path / "m" / f"{name}.safetensors") for name in ("encoder", "model")
    )
    assert all(name.startswith("frontend.encoder.") for name in encoder)
    assert not any(name.startswith("frontend.encoder.") for name in rest)
    assert {weight.dtype for weight in encoder.values()} == {torch.float16}
    weights = np.eye(5, dtype=np.float32)[[2] * 60]
    sound = speech(2.0).numpy()
    assert np.array_equal(before.read(sound, weights)[1], after.read(sound, weights)[1])
    assert after.config.frontend.checkpoint is None


def test_the_hash_of_a_model_covers_both_files(tmp_path):
    network(tmp_path / "m")
    both = weights_hash(tmp_path / "m")
    files = [tmp_path / "m" / f"{name}.safetensors" for name in ("encoder", "model")]
    assert describe_model(tmp_path / "m")["bytes"] == sum(path.stat().st_size for path in files)
    for path in files:
        content = path.read_bytes()
        path.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
        assert weights_hash(tmp_path / "m") != both, path.name
        path.write_bytes(content)
    assert weights_hash(tmp_path / "m") == both


def test_a_model_without_its_encoder_is_refused_in_one_line(tmp_path):
    network(tmp_path / "m")
    (tmp_path / "m" / "encoder.safetensors").unlink()
    with one_line(CheckpointError):
        load_model(tmp_path / "m")
    assert json.loads((tmp_path / "m" / "model.json").read_text())["control_set"]


@pytest.mark.parametrize(
    "seconds", [(2.0, 1.99, 1.98, 1.97), (2.0, 1.5, 1.4, 0.3), (23.4, 10.0, 9.1, 12.0, 0.05)]
)
def test_recordings_read_together_are_as_read_one_by_one(tmp_path, seconds):
    """Also where some are padded for others, and where some are read in pieces, one of them soft."""
    model, _ = network(tmp_path / "m")
    sounds = [speech(length, seed=k).numpy() for k, length in enumerate(seconds)]
    for sound in sounds:
        sound[10 * 16_000 :] *= 1e-3
    counts = [frame_count(len(sound)) for sound in sounds]
    weights = [np.eye(5, dtype=np.float32)[[k] * count] for k, count in enumerate(counts)]
    together = model.read_together(sounds, weights, [""] * len(sounds))
    for sound, rows, found in zip(sounds, weights, together, strict=True):
        expected = model.read(sound, rows)
        np.testing.assert_allclose(found.emotional, expected.emotional, atol=1e-5)
        np.testing.assert_allclose(found.tracks.strength, expected.tracks.strength, atol=1e-5)


def test_all_that_recordings_read_together_need_is_on_the_network_s_device(tmp_path):
    """The device of tensors without values stands for a GPU: it takes no others, too."""
    model = network(tmp_path / "m")[0].to("meta")
    clips = [speech(seconds) for seconds in (1.5, 2.0, 12.0)]
    counts = [frame_count(len(clip)) for clip in clips]
    weights = np.stack([np.eye(5, dtype=np.float32)[[k] * counts[2]] for k in (0, 2)])
    rows = model.frontend.encode_together(clips, counts)
    assert [tuple(part.shape) for part in rows] == [(count, TINY["width"]) for count in counts]
    analysis = model.analyse(rows[2], counts[2])
    curves = model.decode(analysis, model.styles(torch.from_numpy(weights), "").to(model.device))
    assert curves.shape[:2] == (2, counts[2])
    assert {part.device.type for part in (*rows, analysis.strength, curves)} == {"meta"}


@pytest.mark.parametrize("seconds", [(0.01,), (0.3, 2.0), (59.9, 60.0, 60.1), (130.0, 8.0, 0.5)])
def test_clips_are_surveyed_together_as_each_by_numpy(seconds):
    """The loudest spectrum may lie in any piece of a minute, also at a clip's very end."""
    frontend, rng = tiny(), np.random.default_rng(5)
    sounds = [0.01 * rng.standard_normal(int(16_000 * s)).astype(np.float32) for s in seconds]
    for place, sound in enumerate(sounds):
        sound[[0, len(sound) // 2, -1][place % 3]] = 3.0
    mel = frontend.mel
    expected = [
        loudest(sound, TINY["n_mels"], frontend.count(len(sound)) * frontend.spectra, mel.rate)
        for sound in sounds
    ]
    np.testing.assert_allclose(frontend.surveys(sounds), expected, atol=1e-5)
