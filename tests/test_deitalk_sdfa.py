"""SDFA from waveform to vertices: sizes, window by window, training to the end, its folder."""

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
import yaml
from dataset import write_dataset
from typer.testing import CliRunner

from deitalk import train_sdfa as train_module
from deitalk.activity import normalise_level
from deitalk.augment_mel import MelWarp
from deitalk.checkpoint import describe_model, load_model
from deitalk.cli import app
from deitalk.config import MelConfig, SDFAConfig, SDFAModelConfig, load_config, parse_config
from deitalk.data.mesh_folder import MeshSequence, read_mesh_folder, write_mesh_folder
from deitalk.data.mesh_windows import MelWindows
from deitalk.deformation_decoder import InversePCA
from deitalk.errors import CheckpointError, ConfigError, DataError
from deitalk.mesh_checkpoint import load_sdfa, save_sdfa
from deitalk.sdfa import SDFA
from deitalk.train_sdfa import mesh_scores, train_sdfa
from rig.face.identity import IDENTITIES
from rig.mesh import TriMesh

CONFIG = Path(__file__).resolve().parents[1] / "configs/sdfa.yaml"
RATE = 16_000
STYLES = {"ann": 1.0, "bob": -0.8}
FRONTEND = {
    "kind": "mel",
    "window_seconds": 0.032,
    "frame_rate": 60,
    "n_mels": 16,
    "conv_channels": [4, 4, 4],
    "spec_hidden": 8,
    "spectral_size": 24,
    "time_hidden": 24,
    "time_layers": 1,
    "window_frames": 16,
    "query_frames": 3,
    "attention_size": 8,
}


def tiny(**train):
    return parse_config(
        {
            "kind": "sdfa",
            "name": "tiny",
            "model": {"frontend": FRONTEND, "shared_size": 48, "branch_sizes": [48, 32]},
            "data": {
                "fps": 30,
                "identities": [0, 3],
                "basis_frames": 24,
                "basis_error_mm": 0.2,
                "augment": False,
            },
            "train": {"batch_size": 16, "steps": 4, "evaluate_every": 2, **train},
        }
    )


def sheet(n=7, size=10.0):
    """A bent sheet of n x n vertices, `size` cm wide."""
    x, y = np.meshgrid(np.linspace(0, size, n), np.linspace(0, size, n))
    vertices = np.stack([x.ravel(), y.ravel(), -0.05 * (x.ravel() - size / 2) ** 2], axis=1)
    corner = np.arange(n * n).reshape(n, n)
    a, b, c, d = (corner[i : n - 1 + i, j : n - 1 + j].ravel() for i in (0, 1) for j in (0, 1))
    return TriMesh(vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)]))


def spoken(template, style=1.0, seconds=1.0, fps=30):
    """A sweep of tones; the sheet's middle rises and falls by up to 2 cm, or as `style` has it."""
    t = np.arange(int(seconds * RATE)) / RATE
    waveform = (0.2 * np.sin(2 * np.pi * (200 * t + 1000 * t**2))).astype(np.float32)
    frame = np.arange(round(seconds * fps)) / fps
    opening = np.sin(2 * np.pi * 1.5 * frame) ** 2 + 0.3 * np.cos(2 * np.pi * frame)
    x, y, _ = template.vertices.T
    middle = np.exp(-((x - 5) ** 2 + (y - 5) ** 2) / 6)
    shift = np.stack([0.3 * middle * (y - 5), -0.5 * middle, 1.5 * middle], axis=1)
    return waveform, (template.vertices + style * opening[:, None, None] * shift).astype(np.float32)


@pytest.fixture(scope="module")
def sequences(tmp_path_factory):
    """A mesh folder of two speakers who say the same, one inwards what the other does outwards."""
    out = tmp_path_factory.mktemp("meshes") / "folder"
    template = sheet()
    both = [
        MeshSequence(speaker, speaker, "train", *spoken(template, style))
        for speaker, style in STYLES.items()
    ]
    write_mesh_folder(out, dict.fromkeys(STYLES, template), both, fps=30, unit_mm=10)
    return out


def model(fps=60, **frontend):
    torch.manual_seed(0)
    template = sheet(4)
    layers = InversePCA(3, 6 * len(template.faces)), InversePCA(4, 3 * len(template.faces))
    for layer in layers:
        layer.components.normal_(std=0.02)
    config = SDFAModelConfig(frontend=FRONTEND | frontend, shared_size=48, branch_sizes=(48, 32))
    speakers = {"ann": template, "bob": sheet(4, 12.0)}
    return SDFA(config, layers, ("ann", "bob"), speakers, fps=fps, unit_mm=10).eval()


def noise(seconds, seed=0):
    rng = np.random.default_rng(seed)
    return (0.1 * rng.standard_normal(int(seconds * RATE))).astype(np.float32)


def test_the_paper_word_for_word():
    config = load_config(CONFIG)
    assert isinstance(config, SDFAConfig)
    assert config.model.frontend == MelConfig()  # Tables 1-2 are tested with the frontend
    assert (config.model.shared_size, config.model.branch_sizes) == (512, (512, 256))
    assert config.model.weight_norm
    train = config.train
    assert (train.learning_rate, train.batch_size, train.epochs) == (1e-4, 100, 50)
    assert config.data.augment
    assert config.data.fps == 60
    assert len(config.data.identities) == 8


@pytest.mark.parametrize(
    ("tree", "said"),
    [
        ({"model": {"frontend": {"recurrence": "segment"}}}, "recurrence: window"),
        ({"train": {"batch_size": 7}}, "train.batch_size=7"),
        ({"train": {"ema": 0.9}}, "unknown key"),
        ({"data": {"identities": []}}, "data.identities=[]"),
    ],
)
def test_bad_configuration(tree, said):
    with pytest.raises(ConfigError) as caught:
        parse_config({"kind": "sdfa", **tree})
    assert said in str(caught.value)


def test_forward_is_fig_1():
    sdfa = model()
    out = sdfa(torch.randn(5, 3, 16, 16), torch.eye(2)[[0, 1, 0, 1, 1]])
    assert out.s.shape == (5, 6 * 18)
    assert out.r.shape == (5, 3 * 18)


def test_a_clip_is_its_windows_one_by_one():
    """Spectra are computed once; every frame must come out as from a window of its own."""
    sdfa, (sound, _) = model(fps=25, frame_rate=125), spoken(sheet(), seconds=0.8)
    with torch.no_grad():  # fresh weights hardly tell one window from another
        for weight in sdfa.parameters():
            weight.mul_(3)
    whole = sdfa.predict(sound, "bob")
    times = np.arange(20) / 25  # every fifth spectrum, none between samples
    mel = MelWindows(sdfa.config.frontend)(normalise_level(sound), times, MelWarp())
    with torch.no_grad():
        single = sdfa(mel, sdfa.label("bob").expand(20, -1))
    torch.testing.assert_close(whole.s, single.s, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(whole.r, single.r, atol=1e-5, rtol=1e-4)
    assert whole.s.std(dim=0).max() > 1e-2
    assert (whole.s[:-1] - single.s[1:]).abs().max() > 1e-3  # a frame too late would be seen


@pytest.mark.parametrize(
    ("samples", "frames"), [(1, 1), (RATE // 60, 1), (RATE, 60), (RATE + 1, 61)]
)
def test_number_of_frames(samples, frames):
    vertices = model().predict_mesh(noise(2)[:samples])
    assert vertices.shape == (frames, 16, 3)
    assert vertices.dtype == np.float32


def test_rest_in_gradients_is_the_template():
    sdfa = model()
    for layer in (sdfa.decoder.stretch.inverse_pca, sdfa.decoder.rotation.inverse_pca):
        layer.components.zero_()
    out = sdfa.predict_mesh(noise(0.1), "bob")
    np.testing.assert_allclose(out, np.tile(sdfa.template("bob").vertices, (6, 1, 1)), atol=1e-5)


def test_another_face_of_the_same_triangles_can_be_moved():
    sdfa, face = model(), sheet(4, 20.0)
    moved = sdfa.predict_mesh(noise(0.2), "ann", face)
    np.testing.assert_allclose(np.ptp(moved[..., 0], axis=1), 20, atol=4)


def test_level_does_not_matter():
    sdfa = model()
    one, two = (sdfa.predict_mesh(gain * noise(0.5)) for gain in (1.0, 0.2))
    np.testing.assert_allclose(one, two, atol=1e-3)


@pytest.mark.parametrize(
    "bad", [np.zeros(0), np.zeros((2, 100)), np.array([0.0, np.nan]), np.float32(1)]
)
def test_bad_waveform(bad):
    with pytest.raises(DataError, match="16 kHz"):
        model().predict_mesh(bad)


def test_unknown_speaker_is_told_the_known_ones():
    with pytest.raises(CheckpointError, match=r"'eve' is unknown.*ann, bob"):
        model().predict_mesh(noise(0.1), "eve")


def test_a_tiny_model_learns_two_speakers_by_heart(sequences, tmp_path):
    """The sound is the same: only the label can tell whose motion is asked for."""
    config = tiny(steps=280, learning_rate=1e-2, evaluate_every=280)
    best = train_sdfa(config, sequences, tmp_path / "run")
    sdfa, errors_mm = load_sdfa(tmp_path / "run/best"), []
    for speaker, style in STYLES.items():
        template = sdfa.template(speaker)
        waveform, truth = spoken(template, style)
        error_mm = 10 * np.linalg.norm(sdfa.predict_mesh(waveform, speaker) - truth, axis=-1)
        motion_mm = 10 * np.linalg.norm(truth - template.vertices, axis=-1)
        assert error_mm.mean() < 0.5
        assert error_mm.mean() < 0.25 * motion_mm.mean()  # standing still would cost all of it
        errors_mm.append(error_mm.mean())
    assert best["development"]["mean_mm"] == pytest.approx(np.mean(errors_mm), rel=0.1)
    losses = pd.read_csv(tmp_path / "run/metrics.csv")
    assert losses["stretch_value"].iloc[-1] < 0.3 * losses["stretch_value"].iloc[0]


def test_resumed_is_as_uninterrupted(sequences, tmp_path):
    whole, halved = tmp_path / "whole", tmp_path / "halved"
    train_sdfa(tiny(), sequences, whole)
    step = train_module._step

    def killed(run, *rest):
        if run.step == 3:  # after the evaluation and save of step 2, and one step more
            raise KeyboardInterrupt
        return step(run, *rest)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(train_module, "_step", killed)
        with pytest.raises(KeyboardInterrupt):
            train_sdfa(tiny(), sequences, halved)
    train_sdfa(tiny(), sequences, halved, resume=True)
    one, two = (load_sdfa(run / "last").state_dict() for run in (whole, halved))
    assert all(torch.equal(one[name], two[name]) for name in one)


def test_folder_brings_back_the_model(tmp_path):
    sdfa = model()
    save_sdfa(tmp_path / "m", sdfa, tiny(), {"step": 3}, half=False)
    back = load_sdfa(tmp_path / "m")
    assert back.speakers == ("ann", "bob")
    assert (back.fps, back.unit_mm) == (60, 10)
    sound = noise(0.3)
    np.testing.assert_array_equal(back.predict_mesh(sound, 1), sdfa.predict_mesh(sound, 1))
    about = describe_model(tmp_path / "m")
    assert about["training"] == {"step": 3}
    assert about["parameters"] == sum(p.numel() for p in sdfa.parameters())
    save_sdfa(tmp_path / "h", sdfa, tiny(), {})
    small = (tmp_path / "h/model.safetensors").stat().st_size
    whole = (tmp_path / "m/model.safetensors").stat().st_size
    basis = sum(b.numel() for n, b in sdfa.named_buffers() if "inverse_pca" in n)
    assert whole - small == pytest.approx(2 * basis, abs=64)


def test_folders_of_the_two_kinds_are_told_apart(tmp_path):
    save_sdfa(tmp_path / "m", model(), tiny(), {})
    with pytest.raises(CheckpointError, match="none \\(meshes\\)"):
        load_model(tmp_path / "m")
    (tmp_path / "m/templates.npz").write_bytes(b"no")
    with pytest.raises(CheckpointError, match="do not fit one another"):
        load_sdfa(tmp_path / "m")
    (tmp_path / "m/config.yaml").write_text("name: other\n")
    with pytest.raises(CheckpointError, match="no SDFA model"):
        load_sdfa(tmp_path / "m")
    with pytest.raises(CheckpointError, match="no model there"):
        load_sdfa(tmp_path / "nothing")


def test_attention_rows_sum_to_one():
    weights = model().attention_weights(noise(0.5))
    assert weights.shape == (30, 16)
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-5)
    assert (weights >= 0).all()


def test_command_trains_on_our_heads(tmp_path):
    data = write_dataset(tmp_path / "data", 2, 1)
    settings = tmp_path / "tiny.yaml"
    settings.write_text(yaml.safe_dump(tiny(steps=2).model_dump(mode="json")))
    run = tmp_path / "run"
    result = CliRunner().invoke(
        app, ["train", str(settings), "--data", str(data), "-o", str(run), "--set", "train.seed=1"]
    )
    assert result.exit_code == 0, result.output
    sdfa = load_sdfa(run / "best")
    assert sdfa.speakers == tuple(sorted(IDENTITIES[i].name for i in (0, 3)))
    scores = mesh_scores(sdfa, read_mesh_folder(run / "meshes"))
    assert math.isfinite(scores["lively_mm"]) and scores["lively_mm"] > scores["mean_mm"] > 0
    assert load_config(run / "config.yaml").train.seed == 1


def test_command_refuses_weights_to_start_from(tmp_path):
    arguments = ["train", str(CONFIG), "--data", str(tmp_path), "-o", str(tmp_path / "run")]
    result = CliRunner().invoke(app, [*arguments, "--from", "default"])
    assert isinstance(result.exception, ConfigError | CheckpointError)
    result = CliRunner().invoke(app, arguments)
    assert isinstance(result.exception, DataError)
    assert "neither" in str(result.exception)
    assert not (tmp_path / "run/metrics.csv").exists()
